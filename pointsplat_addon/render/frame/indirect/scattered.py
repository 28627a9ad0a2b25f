"""Cells in which things are turned all ways, as balls, hairs and leaves are: light is gathered once for all of them,
from all sides, where each would need a receiver of its own."""

from __future__ import annotations

import numpy as np

from ....core.indirect.sites import SHIFT, cells, hashed
from ....core.numeric.record import record
from .receivers import TURNS, Groups, Receivers

WIDER = 1  # levels above those of the finest receivers
FEWEST, WAYS = 6, 5  # receivers in a cell, and ways that these are turned, from which on it counts
# Receivers in each cell of these, on average, from which on it does: few lie in those of smooth surfaces, and even of
# thin pipes.
CROWDED = 2.5
STEPS = 4  # of places along the edge of a cell at which is gathered
# Balls in cells are relief of a plane, by how long the mean of their normals is and how far they lie off it, in edges.
ALIGNED, THIN = (0.5, 0.6), (0.2, 0.1)
LIFT = 0.25  # edges that these lie above the mean of what is seen: else what is next to it would hide half
CORNERS = np.stack(np.meshgrid((0, 1), (0, 1), (0, 1), indexing="ij"), axis=-1).reshape(-1, 3)


@record
class Scattered:
    """C such cells."""

    key: np.ndarray  # (C,) uint64, rising
    level: np.ndarray  # (C,) float64: binary logarithm of their edges
    site: np.ndarray  # (C,) uint64: keys of the places
    position: np.ndarray  # (C, 3) float64, where light is gathered
    # (C, 3) float64: normals of planes whose relief balls are that are seen there, as long as much of what is there is
    # such relief, 1 at most; None: of none
    plane: np.ndarray | None = None

    def hold(self, position: np.ndarray, level: np.ndarray) -> np.ndarray:
        """(N,) bool: whether places (N, 3) lie in some, of levels (N,)."""
        return self._rows(hashed(np.column_stack([level, cells(position, level)[0]]))) >= 0

    def between(self, position: np.ndarray, level: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Returns what was found in cells (C, k) at places within some, (N, k): as they lie between their middles."""
        at = position / np.exp2(level)[:, None] + SHIFT - 0.5
        low = np.floor(at)
        total, sums = np.zeros(len(at)), np.zeros((len(at), found.shape[1]))
        for corner in CORNERS:
            rows = self._rows(hashed(np.column_stack([level, low + corner])))
            weight = np.where(rows >= 0, np.where(corner, at - low, 1 - (at - low)).prod(axis=1), 0.0)
            total += weight
            sums += weight[:, None] * found[rows]
        return sums / np.maximum(total, 1e-30)[:, None]

    def _rows(self, key: np.ndarray) -> np.ndarray:
        """(N,) int64: of cells with keys (N,); -1: there is none."""
        if len(self.key) == 0:
            return np.full(len(key), -1)
        at = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        return np.where(self.key[at] == key, at, -1)


def scattered_cells(groups: Groups, chosen: Receivers, every: bool = False) -> Scattered:
    """Returns the cells in which the finest receivers are turned all ways; `every`: those in which some are."""
    position, normal = groups.position[chosen.rows], groups.normal[chosen.rows]
    level = chosen.level + WIDER
    keys = hashed(np.column_stack([level, cells(position, level)[0]]))
    unique, first, own, count = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    turned = np.clip(np.floor((normal * 0.999 + 1) * TURNS), 0, 2 * TURNS - 1) @ (2 * TURNS) ** np.arange(3)
    ways = np.unique(own * (2 * TURNS) ** 3 + turned.astype(np.int64)) // (2 * TURNS) ** 3
    finest = hashed(np.column_stack([chosen.level, cells(position, chosen.level)[0]]))
    fine = own[np.unique(finest, return_index=True)[1]]
    crowded = count >= np.maximum(CROWDED * np.bincount(fine, minlength=len(unique)), FEWEST)
    rows = np.flatnonzero(every | crowded & (np.bincount(ways, minlength=len(unique)) >= WAYS))
    mean, up = (
        np.stack([np.bincount(own, column, len(unique))[rows] / count[rows] for column in of.T], axis=1)
        for of in (position.astype(np.float64), normal)
    )
    plane = None
    if groups.balls is not None and groups.balls.any():
        plane = _planes(position, groups.balls[chosen.rows], own, mean, up, rows, np.exp2(level[first]))
    level = level[first[rows]]
    edge = np.exp2(level)[:, None]
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-3)
    place = np.rint((mean + LIFT * edge * up) / edge * STEPS)
    return Scattered(unique[rows], level, hashed(np.column_stack([level, place])), place * edge / STEPS, plane)


def _planes(
    position: np.ndarray,
    balls: np.ndarray,
    own: np.ndarray,
    mean: np.ndarray,
    up: np.ndarray,
    rows: np.ndarray,
    edge: np.ndarray,
) -> np.ndarray:
    """(n, 3): `plane` of Scattered for the cells `rows` (n,) of K, in which places and normals are `mean` and `up`,
    (n, 3) each. Of receivers, at `position` (R, 3): which are of balls, (R,) bool, and which cells are their own, (R,).
    `edge` (K,): of cells."""
    length = np.linalg.norm(up, axis=1)
    axis, middle = np.zeros((2, len(edge), 3))
    axis[rows], middle[rows] = up / np.maximum(length, 1e-9)[:, None], mean
    off = ((position - middle[own]) * axis[own]).sum(axis=1) / edge[own]
    count, of_balls, squared = (np.bincount(own, of, len(edge))[rows] for of in (None, balls, off * off))
    part = of_balls / count
    for value, (none, whole) in ((length, ALIGNED), (np.sqrt(squared / count), THIN)):
        part = part * np.clip((value - none) / (whole - none), 0.0, 1.0)
    return part[:, None] * axis[rows]
