"""The distance to the nearest entry of a shadow table within a range of directions, from a pyramid of minima."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..numeric.record import record
from .grid import Frame
from .level import TableLevel

SQUARE_CELLS = 4  # cells of a level: sides of the squares that know its nearest entry


@record
class NearestEntries:
    """The distance from the light to the nearest entry, for squares of directions of all sizes.

    From finest to coarsest, squares double in size and halve in number; the last holds all directions. A square knows
    the cells that a look-up reads up to LOOSE of its side away from it: what surrounds a receiver takes one of them.
    """

    low: np.ndarray  # (2,) float64, least latitude and longitude
    side: float  # of the finest squares
    distance: tuple[np.ndarray, ...]  # (P, P) float32 each, rows of latitude; inf: nothing

    @property
    def least(self) -> float:
        """The least distance of all entries; 0 if there are none."""
        return float(np.nan_to_num(self.distance[-1][0, 0], posinf=0.0))

    @cached_property
    def flat(self) -> np.ndarray:
        """(S,) float32: all squares, row by row, finest first."""
        return np.concatenate([d.reshape(-1) for d in self.distance])


def nearest_entries(frame: Frame, levels: tuple[TableLevel, ...], wide: bool) -> NearestEntries:
    """The nearest entries of a table's levels. Lights without a size (`wide` is false) need only the coarsest
    square."""
    if not levels or not wide:
        least = min((float(level.distance.min()) for level in levels), default=np.inf)
        return NearestEntries(frame.low, 1.0, (np.full((1, 1), least, np.float32),))
    finest = SQUARE_CELLS * min(level.grid.step for level in levels)
    if frame.full:
        count = 1 << max(int(np.floor(np.log2(2 * np.pi / finest))), 0)
        low, side = np.array([-np.pi / 2, -np.pi]), 2 * np.pi / count
    else:
        low, side = frame.low - finest, finest
        count = 1 << int(np.ceil(np.log2(float((frame.high - frame.low).max()) / side + 2)))
    sizes = count.bit_length()
    # What each level adds to the squares of each size: where squares are SQUARE of its cells wide, and coarser ones.
    own = [[np.full((count >> k, count >> k), np.inf, np.float32)] * 2 for k in range(sizes)]
    for level in levels:
        start = int(np.clip(np.ceil(np.log2(SQUARE_CELLS * level.grid.step / side * (1 - 1e-6))), 0, sizes - 1))
        cell, grid, n = level.occupied(), level.grid, count >> start
        row = np.searchsorted(grid.first, cell, side="right") - 1
        place = grid.latitude[row], (cell - grid.first[row] + grid.column0[row]) / grid.density[row]
        if frame.full:
            place = place[0], (place[1] + np.pi) % (2 * np.pi) - np.pi
        at = [np.clip((v - o) / (side * 2**start), 0, n - 1).astype(np.int64) for v, o in zip(place, low, strict=True)]
        found = np.full(n * n, np.inf, np.float32)
        np.minimum.at(found, at[0] * n + at[1], level.distance[level.links[:-1]])
        found = found.reshape(n, n)
        own[start] = [np.minimum(own[start][0], found), own[start][1]]
        for k in range(start, sizes):
            own[k] = [own[k][0], np.minimum(own[k][1], found)]
            found = np.minimum(found[::2], found[1::2]) if k + 1 < sizes else found
            found = np.minimum(found[:, ::2], found[:, 1::2]) if k + 1 < sizes else found
    distance: list[np.ndarray] = []
    coarser = np.full((1, 1), np.inf, np.float32)  # what levels add that begin with larger squares
    for here, all_ in reversed(own):
        distance.insert(0, np.minimum(_minimum_of_neighbours(all_, frame.full), coarser))
        coarser = np.minimum(_minimum_of_neighbours(here, frame.full), coarser).repeat(2, axis=0).repeat(2, axis=1)
    return NearestEntries(low, side, tuple(distance))


def _minimum_of_neighbours(distance: np.ndarray, wraps: bool) -> np.ndarray:
    """(P, P) the minimum over each square and its eight neighbours."""
    padded = np.pad(distance, ((1, 1), (0, 0)), constant_values=np.inf)
    across = (0, 0), (1, 1)
    padded = np.pad(padded, across, "wrap") if wraps else np.pad(padded, across, constant_values=np.inf)
    rows = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    return np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
