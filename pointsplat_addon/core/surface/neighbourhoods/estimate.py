"""Surfaces of scans: for each point a normal, an ellipse that closes the sampling, and how reliable both are.

Normals are those of planes through the nearest neighbours (Hoppe et al. 1992), reweighted so that outliers and the far
side of an edge do not turn them; ellipses follow from the neighbourhoods (Pajarola 2003), here from the cells that the
neighbours bound. Where neighbours lie on no plane, as in foliage, on wires and around outliers, points stay balls.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...numeric.record import record
from ...numeric.vectors import each_block, take_rows
from .ellipses import FITTING, closing_ellipses
from .nearest import WINDOW, Orders, make_orders, nearest
from .planes import fit_planes

NEIGHBOURS = 20  # with 16, noise of a third of the spacing turns normals by 6.5 degrees instead of 5
BLOCK = 1 << 12  # points at once: their candidates stay in the processor's cache
LEAST_FITTING = 5  # neighbours on the plane, below which it is not reliable
# Roughness, the mean of `Planes.thickness` near a point and half of how far normals near it differ from its own: of
# surfaces with noise of a third of the spacing it is 0.16 and at most 0.4, at their edges 0.4, of points at random in
# space 0.9. Up to SURFACE an ellipse closes the surface, from SPACE on a point is a ball; between them ellipses shrink.
SURFACE, SPACE = 0.4, 0.6
INCOHERENCE = 0.5
LINE = 0.01  # of `Planes.breadth`: below that the neighbours lie on a line
STRAY = 2.5  # half-axis of ellipses above which points are strays, in the geometric mean of those near them
BALL_NEIGHBOURS = 3  # to which the mean distance tells the size of balls
MOST_BALL = 2.0  # radius of the largest balls in those of the median: outliers are no larger
WIDE = 2.25  # half-axis of ellipses in the radii of balls beyond which they must be the smoother the wider they are
BALL_SHIFT = 1.0  # of the balls' radii: how far they move at most
HALF = 0.5  # of a ball's radius in the distance of its neighbours


@record
class Ellipses:
    """Surface elements of N points, float32."""

    normal: np.ndarray  # (N, 3), unit; zero where the point is a ball
    axis: np.ndarray  # (N, 3), unit, along the major half-axis; zero where the point is a ball
    radii: np.ndarray  # (N, 2): half-axes (major, minor); of balls the radius twice; 0 where it is not known
    reliability: np.ndarray  # (N,): 1 on a plane; 0 where the point is a ball
    offset: np.ndarray  # (N, 3): of the centre from the point: along the normal, noise is left out


def estimate_ellipses(position: np.ndarray) -> Ellipses:
    """Returns the surface elements of points (N, 3) float32 from their neighbours.

    Coincident points have the same element and count once. Points that are not finite have none: all zeros. Normals are
    turned upwards; see `turn_towards`.
    """
    orders = make_orders(position)
    place, unit, further = orders.place, orders.unit, orders.order
    fits = _fitted(orders)
    del orders  # so that positions and ranks are not held beside what follows
    arrays = _ellipses(further, *fits)
    del further, fits
    for name in list(arrays):
        arrays[name] = _spread(arrays.pop(name), place)
    for name in ("radii", "offset"):
        arrays[name] *= np.float32(unit)
    return Ellipses(**arrays)


def _fitted(orders: Orders) -> tuple[np.ndarray, ...]:
    """Planes and closing ellipses of distinct positions: normals (M, 3), major axes (M, 3), half-axes (M, 2), centres
    (M, 3) of the cells, radii (M,) of balls, and thickness (M,): 1 where there is no plane. Lengths in units."""
    count = len(orders)
    normal, axis, radii, centre = (np.zeros((count, width), np.float32) for width in (3, 3, 2, 3))
    ball, thickness = np.zeros(count, np.float32), np.ones(count, np.float32)

    def fit(block: slice) -> None:
        offset, squared = neighbours_of(orders, block)
        planes = fit_planes(offset, squared)
        major, half_axes, middle = closing_ellipses(offset, squared, planes.normal, planes.weight)
        normal[block], axis[block], radii[block] = planes.normal.T, major.T, half_axes.T
        few = (planes.weight > FITTING).sum(axis=0) < LEAST_FITTING
        thickness[block] = np.where(few | (planes.breadth < LINE), 1, planes.thickness)
        ball[block] = _ball_radius(squared)
        centre[block] = (middle + planes.height * planes.normal).T

    if count > 1:
        each_block(count, fit, BLOCK)
    return normal, axis, radii, centre, ball, thickness


def _ellipses(
    orders: tuple[np.ndarray, ...],
    normal: np.ndarray,
    axis: np.ndarray,
    radii: np.ndarray,
    centre: np.ndarray,
    ball: np.ndarray,
    thickness: np.ndarray,
) -> dict[str, np.ndarray]:
    """The fields of Ellipses, by name, from what `_fitted` returns, which is changed, and the further orders."""
    roughness = _mean_of_neighbours(orders, thickness)
    roughness += INCOHERENCE * (1 - _coherence(orders, normal))
    roughness *= np.maximum(1, radii[:, 0] / np.maximum(WIDE * ball, np.float32(1e-30)))
    lone = ~((thickness < 1) & (roughness < SPACE) & (radii[:, 1] > 0))
    # Disks of stray points would be far larger than those near them.
    size = np.log(np.maximum(radii[:, 0], np.float32(1e-30)))
    lone |= size > _mean_of_neighbours(orders, size) + np.log(STRAY)
    # Outliers have far neighbours.
    typical = float(np.median(ball[ball > 0])) if (ball > 0).any() else 0.0
    np.minimum(ball, MOST_BALL * typical, out=ball)
    np.negative(normal, out=normal, where=normal[:, 2:] < 0)
    normal[lone], axis[lone] = 0, 0
    # Balls of rough surfaces follow them; outliers, which are far from all, stay nearly where they are.
    moved = np.sqrt(np.einsum("nc,nc->n", centre, centre))
    centre *= np.where(lone, np.minimum(1, BALL_SHIFT * ball / np.maximum(moved, np.float32(1e-30))), 1)[:, None]
    closing = np.clip((SPACE - roughness) / (SPACE - SURFACE), 0, 1)
    for half_axis in radii.T:
        half_axis += (1 - closing) * (np.minimum(ball, half_axis) - half_axis)
        half_axis[lone] = ball[lone]
    reliability = np.where(lone, 0, np.clip(1 - roughness, 0, 1)).astype(np.float32)
    return {"normal": normal, "axis": axis, "radii": radii, "reliability": reliability, "offset": centre}


def turn_towards(normal: np.ndarray, position: np.ndarray, station: np.ndarray) -> None:
    """Turns normals (N, 3) in place to the side from which the scanner, at (3,) or (N, 3), saw the points (N, 3)."""

    def turn(block: slice) -> None:
        seen_from = station if station.ndim == 1 else station[block]
        back = np.einsum("nc,nc->n", normal[block], seen_from - position[block]) < 0
        normal[block][back] *= -1

    each_block(len(normal), turn)


def neighbours_of(
    orders: Orders, block: slice, count: int = NEIGHBOURS, window: int = WINDOW
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (3, k, n) of the nearest neighbours of points, and the squares of their lengths (k, n); see `nearest`."""
    index, squared = nearest(orders, block, count, window)
    index = np.ascontiguousarray(index.T)
    offset = np.empty((3, *index.shape), np.float32)
    for axis, column in enumerate(orders.position):
        np.subtract(column.take(index), column[block], out=offset[axis])
    return offset, np.ascontiguousarray(squared.T)


def _ball_radius(squared: np.ndarray) -> np.ndarray:
    """Radii (n,) of balls that touch their nearest neighbours, of which (k, n) are the squared distances."""
    count = min(BALL_NEIGHBOURS, len(squared))
    near = np.sqrt(np.partition(squared, count - 1, axis=0)[:count])
    there = np.isfinite(near)
    total = np.where(there, near, 0).sum(axis=0)
    return HALF * total / np.maximum(there.sum(axis=0), 1)


def _coherence(orders: tuple[np.ndarray, ...], normal: np.ndarray) -> np.ndarray:
    """Means (M,) of the squared cosines between the normals (M, 3) of points and those near them."""
    result = np.zeros(len(normal), np.float32)
    for i in range(3):
        for j in range(i, 3):
            product = normal[:, i] * normal[:, j]
            product *= _mean_of_neighbours(orders, product)
            result += product if i == j else 2 * product
    return result


def _mean_of_neighbours(orders: tuple[np.ndarray, ...], values: np.ndarray) -> np.ndarray:
    """Means (M,) over windows of the first order and the further `orders`: over what lies near each point."""
    count = len(values)
    half = min(WINDOW // 2, count - 1)
    result = np.zeros(count, np.float32)

    def add(order: np.ndarray | None, block: slice) -> None:
        low, high = max(block.start - half, 0), min(block.stop + half, count)
        total = np.zeros(high - low + 1)
        np.cumsum(values[low:high] if order is None else values.take(order[low:high]), out=total[1:])
        own = np.arange(block.start, block.stop)
        first, last = np.maximum(own - half, 0) - low, np.minimum(own + half + 1, count) - low
        # Each point is in one block of an order.
        result[block if order is None else order[block]] += (total[last] - total[first]) / (last - first)

    for order in (None, *orders):
        each_block(count, partial(add, order))
    result /= 1 + len(orders)
    return result


def _spread(array: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Rows of distinct positions (M, ...) for all points (N,), zeros for those without."""
    if len(array) == 0:
        return np.zeros((len(place), *array.shape[1:]), array.dtype)
    found = take_rows(array, np.maximum(place, 0))
    missing = place < 0
    if missing.any():
        found[missing] = 0
    return found
