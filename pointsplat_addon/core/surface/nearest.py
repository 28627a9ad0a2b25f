"""Measures how far apart scattered points lie: the median distance to the nearest neighbour, on a grid of cells."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import ranges
from ..numeric.vectors import column_ranges

QUERIES = 1 << 13  # points that are asked for their neighbour; the median of fewer is as good as that of all
MOST_IN_CELL = 1 << 7  # candidates of one cell: crowded ones are no less dense for those left out
TAIL = 0.005  # of the points along each axis: outliers do not set the size of the cells of the first order
STEPS = 4  # neighbours in Morton order on either side, for a first bound
ENOUGH = 1 << 18  # points whose spacing is that of all
GRID, GOLDEN = 128, 1296175  # cells to a side; a step that is near the golden section of their number and prime to it
FARTHEST_CELL = 2.0**40
_PRIMES = np.array([73856093, 19349663, 83492791], np.uint64)  # spatial hash (Teschner et al. 2003)


def median_spacing(position: np.ndarray) -> float:
    """Returns the median distance of points (N, 3) to their nearest neighbour, in the points' unit.

    Points at one position count once, and outliers do not matter. Exact for up to QUERIES points without crowded
    cells, else of evenly picked points. 0 where there are fewer than two positions.
    """
    points = position[np.isfinite(position).all(axis=1)].astype(np.float64)
    points = _distinct(points[np.argsort(_morton_key(points), kind="stable")]) if len(points) else points
    if len(points) < 2:
        return 0.0
    query = np.arange(0, len(points), max(1, len(points) // QUERIES))
    distance = _along_order(points, query)
    side = float(np.median(distance))
    if not 0 < side < np.inf:
        return 0.0
    # At least half of the neighbours are no farther than a cell is wide, so that the median is found in the 27 cells
    # around each point.
    return float(np.median(np.minimum(distance, _within_cells(points, query, side))))


def scan_spacing(position: np.ndarray) -> float:
    """Returns `median_spacing` of very many points (N, 3), of which whole cells of a grid stand for all."""
    count = len(position)
    if count <= ENOUGH:
        return median_spacing(position)
    low, high = column_ranges(position)
    if not np.isfinite([low, high]).all():
        return scan_spacing(position[np.isfinite(position).all(axis=1)])
    scale = np.float32((GRID - 0.01) / max(float((high - low).max()), 1e-30))
    cell = np.zeros(count, np.int32)
    for axis in range(3):
        cell *= GRID
        cell += ((position[:, axis] - low[axis]) * scale).astype(np.int32)
    occupied = np.flatnonzero(points_of_cells := np.bincount(cell))
    # Cells at even steps through the grid, until there are enough points.
    order = occupied[np.argsort(occupied * np.int64(GOLDEN) % GRID**3, kind="stable")]
    taken = order[: np.searchsorted(np.cumsum(points_of_cells[order]), ENOUGH) + 1]
    chosen = np.zeros(len(points_of_cells), bool)
    chosen[taken] = True
    found = position[chosen[cell]]
    return median_spacing(found[:: len(found) // (4 * ENOUGH) + 1])


def _morton_key(points: np.ndarray) -> np.ndarray:
    """(N,) uint64: cells of 2^-21 of a box around most points, in Morton order."""
    low, high = np.quantile(points[:: max(1, len(points) // 100_000)], [TAIL, 1 - TAIL], axis=0)
    if not (high > low).any():
        low, high = points.min(axis=0), points.max(axis=0)
    side = max(2 * float((high - low).max()), np.finfo(np.float64).tiny)
    cell = np.clip((points - (low + high) / 2) / side + 0.5, 0, 1 - 2.0**-22) * 2.0**21
    key = np.zeros(len(points), np.uint64)
    for axis, column in enumerate(cell.astype(np.uint64).T):
        for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
                            (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249)):  # fmt: skip
            column = (column | column << np.uint64(shift)) & np.uint64(mask)
        key |= column << np.uint64(axis)
    return key


def _distinct(points: np.ndarray) -> np.ndarray:
    """The points without those that follow their like."""
    first = np.ones(len(points), bool)
    first[1:] = (points[1:] != points[:-1]).any(axis=1)
    return points[first]


def _along_order(points: np.ndarray, query: np.ndarray) -> np.ndarray:
    """(Q,) the least distance to the points that come shortly before and after; inf where all are at one position."""
    least = np.full(len(query), np.inf)
    for step in (*range(-STEPS, 0), *range(1, STEPS + 1)):
        other = query + step
        there = (other >= 0) & (other < len(points))
        distance = np.linalg.norm(points[np.clip(other, 0, len(points) - 1)] - points[query], axis=1)
        least = np.where(there & (distance > 0), np.minimum(least, distance), least)
    return least


def _within_cells(points: np.ndarray, query: np.ndarray, side: float) -> np.ndarray:
    """(Q,) the least distance to points in the 27 cells of this side around each; inf where there is none."""
    cell = np.clip(np.floor(points / side), -FARTHEST_CELL, FARTHEST_CELL).astype(np.int64)
    key = _hash(cell)
    order = np.argsort(key, kind="stable")
    key = key[order]
    least = np.full(len(query), np.inf)
    for offset in np.ndindex(3, 3, 3):
        wanted = _hash(cell[query] + np.array(offset) - 1)
        first = np.searchsorted(key, wanted, side="left")
        count = np.minimum(np.searchsorted(key, wanted, side="right") - first, MOST_IN_CELL)
        for start in range(0, len(query), 1 << 12):
            block = slice(start, start + (1 << 12))
            number = count[block]
            own = np.repeat(query[block], number)
            difference = points[order[ranges(first[block], number)]] - points[own]
            squared = np.einsum("ij,ij->i", difference, difference)
            squared[squared == 0] = np.inf
            some = np.flatnonzero(number)
            if len(some):
                begin = (np.cumsum(number) - number)[some]
                found = np.sqrt(np.minimum.reduceat(squared, begin))
                least[start + some] = np.minimum(least[start + some], found)
    return least


def _hash(cell: np.ndarray) -> np.ndarray:
    """(N,) uint64 of cells (N, 3); a chance collision adds a candidate that is too far away to matter."""
    return np.bitwise_xor.reduce(cell.astype(np.uint64) * _PRIMES, axis=1)
