"""Sites: places of a lattice in space, with quantised normals, at which receivers gather light.

Which site a receiver has depends on where it lies and how it is turned alone, and what it gathers there on the site
alone: pictures from other cameras find it again.
"""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from ..numeric.vectors import dot
from .closed import scrambled

FINE = 9  # steps of sites along the edge of a cell, where its middle is hidden; odd
UPRIGHT_STEPS = 64  # and across it
TURNS = 256  # steps of normals, each way of an octahedron
# Odd 64-bit numbers, by which cells along each axis become one.
PRIMES = tuple(map(np.uint64, (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)))
SHIFT = 0.381966  # of an edge: faces of cells do not lie where surfaces often do


@record
class Sites:
    """N sites."""

    key: np.ndarray  # (N,) uint64: equal where all is, else but with a probability of 2^-64
    position: np.ndarray  # (N, 3) float64
    normal: np.ndarray  # (N, 3) float64, unit

    def take(self, which: np.ndarray, others: Sites) -> Sites:
        """Returns these sites where `which` (N,), and `others` elsewhere."""
        return Sites(
            np.where(which, self.key, others.key),
            np.where(which[:, None], self.position, others.position),
            np.where(which[:, None], self.normal, others.normal),
        )


def cells(position: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the cells (N, 3) whole float64, with edges of 2^level, (N,), in which places (N, 3) float64 lie, and the
    squared distances, over those of the edges, from their middles, (N,)."""
    at = np.ascontiguousarray(position.T) / np.exp2(level) + SHIFT
    found = np.floor(at)
    off = at - found - 0.5
    return found.T, dot(off, off)


def sites(position: np.ndarray, normal: np.ndarray, level: np.ndarray, steps: int = 1) -> Sites:
    """Returns the sites of surfaces at places (N, 3) float64 with unit normals (N, 3), in the planes of these.

    `level` (N,): of their cells. `steps`: of sites along the edge of a cell; with one, they are in the middle.
    """
    rows = np.arange(len(position))
    axis = np.abs(normal).argmax(axis=1)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    edge = np.exp2(level)
    numbers, snapped = [], np.empty_like(position, np.float64)
    for along in (first, second):
        at = np.floor((position[rows, along] / edge + SHIFT) * steps)
        snapped[rows, along] = ((at + 0.5) / steps - SHIFT) * edge
        numbers.append(at)
    moved = snapped - position
    rise = -sum(normal[rows, along] * moved[rows, along] for along in (first, second)) / normal[rows, axis]
    height = np.rint((position[rows, axis] + rise) / edge * UPRIGHT_STEPS)
    snapped[rows, axis] = height * edge / UPRIGHT_STEPS
    code, turned = quantised_directions(normal, TURNS)
    same = np.full(len(rows), steps)
    return Sites(hashed(np.column_stack([level, same, axis, *numbers, height, code])), snapped, turned)


def quantised_directions(direction: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns codes (N,) of unit directions (N, 3) and the directions (N, 3) that these stand for: of an octahedron
    (Meyer et al. 2010), so many steps each way."""
    flat = direction[:, :2] / np.maximum(np.abs(direction).sum(axis=1, keepdims=True), 1e-30)
    down = direction[:, 2] < 0
    flat[down] = _folded(flat[down])
    code = np.rint((flat * 0.5 + 0.5) * steps)
    flat = code / steps * 2 - 1
    height = 1 - np.abs(flat).sum(axis=1)
    down = height < 0
    flat[down] = _folded(flat[down])
    found = np.column_stack([flat, height])
    return code[:, 0] * (steps + 1) + code[:, 1], found / np.linalg.norm(found, axis=1, keepdims=True)


def _folded(flat: np.ndarray) -> np.ndarray:
    """Coordinates (N, 2) of an octahedron's lower half, which is folded outwards, from those of the upper, or back."""
    return np.copysign(1 - np.abs(flat[:, ::-1]), flat)


def hashed(columns: np.ndarray) -> np.ndarray:
    """Returns hashes (N,) uint64 of rows of numbers (N, k): equal where these are, else but with a probability of
    2^-64."""
    with np.errstate(over="ignore"):
        found = np.zeros(len(columns), np.uint64)
        for column in columns.T:
            found = scrambled(found ^ (column.astype(np.float64) + 0.0).view(np.uint64))
    return found


def cell_keys(cell: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Keys (N,) uint64 of cells (3, N), whole numbers, of kinds (N,) uint64, scrambled numbers: of a step along an axis
    they differ by PRIMES."""
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = (axis.astype(np.int64).view(np.uint64) * prime for axis, prime in zip(cell, PRIMES, strict=True))
        return x + y + z + kind
