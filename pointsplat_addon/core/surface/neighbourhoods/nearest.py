"""The nearest neighbours of scattered points, nearly all of them, by windows in several shifted Morton orders.

Points that follow one another in Morton order are near one another, but not all that are near follow one another:
faces of large cells cut the order. They cut each shifted grid elsewhere (Liao et al. 2001; Connor and Kumar 2010), so
what one order misses another finds. No cell size is chosen: the orders are as fine as the points are dense.
"""

from __future__ import annotations

import numpy as np

from ...numeric.morton import codes_in_cube, sorted_by_code
from ...numeric.record import record
from ...numeric.vectors import column_ranges, put_rows, take_rows

ORDERS = 3  # shifted by thirds of the grid: shifted by halves, the cells would be the same
WINDOW = 12  # points on either side in each order: together they hold 95 % of the 12 nearest points of a sphere
TAIL = 0.002  # of the points along each axis: outliers do not set the size of the grid
SAMPLE = 100_000  # points that tell the grid's size
FEW_BITS = 6  # of the number of one of few candidates
LARGEST = 2.0**100  # unit
FARTHEST = 1e16  # units from the middle, to which farther points are drawn near: squares of distances stay finite


@record
class Orders:
    """M distinct positions, numbered in the first Morton order, and where they stand in the others."""

    position: np.ndarray  # (3, M) float32, in `unit`s
    unit: float  # a power of two near the points' extent: float32 holds the squares of distances
    place: np.ndarray  # (N,) int32: number of each of the given points; -1: it is not finite
    order: tuple[np.ndarray, ...]  # of each further order: (M,) int32, numbers of the points in it
    rank: tuple[np.ndarray, ...]  # the inverse

    def __len__(self) -> int:
        return self.position.shape[1]


def make_orders(position: np.ndarray) -> Orders:
    """Returns the Morton orders of points (N, 3) float32, of which some may coincide and some not be finite."""
    finite = np.flatnonzero(np.isfinite(position).all(axis=1)) if not np.isfinite(position).all() else None
    points = position if finite is None else take_rows(position, finite)
    place = np.full(len(position), -1, np.int32)
    if len(points) == 0:
        return Orders(np.empty((3, 0), np.float32), 1.0, place, (), ())
    low, side = _cube(points)
    order, _ = sorted_by_code(codes_in_cube(points.T, low.tolist(), side))
    columns = np.empty((3, len(points)), np.float32)
    for axis in range(3):
        columns[axis] = points[:, axis][order]
    unit = float(np.clip(2.0 ** np.round(np.log2(side)), 2.0**-126, LARGEST)) if len(points) > 1 else 1.0
    first = np.ones(len(points), bool)
    first[1:] = (columns[:, 1:] != columns[:, :-1]).any(axis=0)
    number = np.cumsum(first, dtype=np.int32)
    number -= 1
    put_rows(place, order if finite is None else finite[order], number)
    del number
    if not first.all():
        columns = np.ascontiguousarray(columns[:, first])
    with np.errstate(over="ignore"):
        for column in columns:
            column[:] = np.clip(column / unit, -FARTHEST, FARTHEST)
    low, side = low / unit, side / unit
    orders, ranks = [], []
    for i in range(1, ORDERS):
        # Twice as large a cube holds all points, wherever they are shifted to.
        corner = low - side * i / ORDERS
        found = sorted_by_code(codes_in_cube(columns, corner.tolist(), 2 * side))[0].astype(np.int32, copy=False)
        rank = np.empty(len(found), np.int32)
        put_rows(rank, found, np.arange(len(found), dtype=np.int32))
        orders.append(found)
        ranks.append(rank)
    return Orders(columns, unit, place, tuple(orders), tuple(ranks))


def _cube(points: np.ndarray) -> tuple[np.ndarray, float]:
    """The low corner (3,) and the side of a cube that holds all points (N, 3), but for outliers far away."""
    low, high = (bound.astype(np.float64) for bound in column_ranges(points))
    least, most = np.quantile(points[:: len(points) // SAMPLE + 1].astype(np.float64), [TAIL, 1 - TAIL], axis=0)
    reach = 2 * float((most - least).max())
    if reach > 0:
        low, high = np.maximum(low, least - reach), np.minimum(high, most + reach)
    return low, max(float((high - low).max()), 1e-30) * (1 + 2.0**-20)


def nearest(orders: Orders, block: slice, count: int, window: int = WINDOW) -> tuple[np.ndarray, np.ndarray]:
    """Returns the `count` nearest neighbours of the points in a slice: their numbers and squared distances in units,
    (n, count) int32 and float32, in no order. Where there are fewer, the distance is infinite. `window`: points on
    either side in each order, among which they are looked for."""
    total = len(orders)
    own = np.arange(block.start, block.stop, dtype=np.int32)
    steps = np.array([*range(-window, 0), *range(1, window + 1)], np.int32)
    index = np.empty((len(own), (1 + len(orders.order)) * len(steps)), np.int32)
    squared = np.empty(index.shape, np.float32)
    x, y, z = orders.position
    ranks = [own, *(rank[block] for rank in orders.rank)]
    for i, rank in enumerate(ranks):
        columns = slice(i * len(steps), (i + 1) * len(steps))
        at = rank[:, None] + steps
        outside = (at < 0) | (at >= total)
        np.clip(at, 0, total - 1, out=at)
        found = at if i == 0 else orders.order[i - 1].take(at)
        distance = np.square(x.take(found) - x[block, None])
        distance += np.square(y.take(found) - y[block, None])
        distance += np.square(z.take(found) - z[block, None])
        outside |= distance == 0
        # What an earlier order has found is not counted twice.
        for j in range(i):
            before = found if j == 0 else orders.rank[j - 1].take(found)
            outside |= np.abs(before - ranks[j][:, None]) <= window
        distance[outside] = np.inf
        index[:, columns], squared[:, columns] = found, distance
    if index.shape[1] <= count:
        return index, squared
    chosen = _least(squared, count)
    return np.take_along_axis(index, chosen, axis=1), np.take_along_axis(squared, chosen, axis=1)


def _least(squared: np.ndarray, count: int) -> np.ndarray:
    """Columns (n, count) of the least values of rows (n, k) float32, none negative, in no order."""
    if squared.shape[1] > 1 << FEW_BITS:
        return np.argpartition(squared, count - 1, axis=1)[:, :count]
    # Bits of floats are in the order of the floats. Columns in the place of the last ones make values of indices, which
    # are sorted in a tenth of the time; distances that differ by less than 2^-17 of themselves may be confused.
    mask = np.uint32((1 << FEW_BITS) - 1)
    key = squared.view(np.uint32) & ~mask
    key |= np.arange(squared.shape[1], dtype=np.uint32)
    key.sort(axis=1)  # which NumPy does with vectors; it partitions rows so short one number at a time
    return (key[:, :count] & mask).astype(np.intp)
