"""Finds the point of a scan that a ray meets first, in the file: whatever is drawn, it is a measured point."""

from __future__ import annotations

import heapq
from collections.abc import Callable

import numpy as np

from ..core.numeric.record import record
from ..formats.hierarchies.source import PageSource
from ..formats.points.reader import Columns, PointFileError
from .tree import PageTree

BEHIND = 2.0  # reaches behind the first point, within which the one nearest to the ray is taken


@record
class Ray:
    """A ray in object space, and how far from it points may lie: `reach`, plus `slope` a unit of distance."""

    start: np.ndarray  # (3,) float64
    along: np.ndarray  # (3,) float64, unit
    reach: float
    slope: float


@record
class Picked:
    """A point of a scan."""

    position: np.ndarray  # (3,) float64, object space
    coordinate: np.ndarray  # (3,) float64: on the map
    attributes: dict[str, float | tuple[float, ...]]  # by the file's names
    distance: float  # along the ray


def pick(
    tree: PageTree, source: PageSource, ray: Ray, keep: Callable[[Columns], np.ndarray | None] = lambda columns: None
) -> Picked | None:
    """Returns the first point that a ray meets; None: it meets none. Pages are read from the nearest on, until none
    that is left lies before what was found.

    `keep`: rows of a page's points that count, None for all. Nodes over points count for nothing. Pages that cannot be
    read are passed over.
    """
    best: tuple[float, float, int, int, Columns] | None = None  # distance, aside, page, row
    waiting = [(enter, page) for page in [0] if (enter := _enters(tree, page, ray)) is not None]
    while waiting:
        enter, page = heapq.heappop(waiting)
        if best is not None and enter > best[0] + BEHIND * _reach(ray, best[0]):
            break
        for child in np.flatnonzero(tree.directory.parent == page).tolist() if not tree.is_leaf[page] else ():
            if (near := _enters(tree, child, ray)) is not None:
                heapq.heappush(waiting, (near, child))
        if not (tree.directory.additive or tree.is_leaf[page]):
            continue
        try:
            columns = source.read(page)
        except (PointFileError, OSError):
            continue
        found = _nearest(columns, keep(columns), ray)
        if found is not None and (best is None or _before(found, best[:2], ray)):
            best = (*found[:2], page, found[2], columns)
    if best is None:
        return None
    distance, _, _, row, columns = best
    position = columns["position"][row].astype(np.float64)
    attributes = {name: _value(values[row]) for name, values in columns.items() if name != "position"}
    return Picked(position, position + tree.directory.origin, attributes, distance)


def _reach(ray: Ray, distance: float) -> float:
    return ray.reach + ray.slope * max(distance, 0.0)


def _enters(tree: PageTree, page: int, ray: Ray) -> float | None:
    """Where a ray comes within its reach of a page's bounds; None: nowhere."""
    low, high = tree.directory.bounds[page]
    far = float(np.linalg.norm(np.maximum(np.abs(low - ray.start), np.abs(high - ray.start))))
    wide = _reach(ray, far)
    with np.errstate(divide="ignore", invalid="ignore"):
        near, away = (low - wide - ray.start) / ray.along, (high + wide - ray.start) / ray.along
    first, last = np.fmin(near, away), np.fmax(near, away)
    enter, leave = max(float(np.nanmax(first)), 0.0), float(np.nanmin(last))
    return enter if enter <= leave else None


def _nearest(columns: Columns, rows: np.ndarray | None, ray: Ray) -> tuple[float, float, int] | None:
    """Distance along a ray, from it, and row of the point that it meets first of a page's."""
    position = columns["position"] if rows is None else columns["position"][rows]
    away = position.astype(np.float64) - ray.start
    along = away @ ray.along
    aside = np.linalg.norm(away - along[:, None] * ray.along, axis=1)
    met = np.flatnonzero((along > 0) & (aside <= ray.reach + ray.slope * along))
    if len(met) == 0:
        return None
    first = float(along[met].min())
    front = met[along[met] <= first + BEHIND * _reach(ray, first)]
    row = int(front[np.argmin(aside[front])])
    return float(along[row]), float(aside[row]), row if rows is None else int(rows[row])


def _before(found: tuple[float, float, int], best: tuple[float, float], ray: Ray) -> bool:
    """Whether a point is met before another, or, where both are met together, nearer to the ray."""
    apart = BEHIND * _reach(ray, min(found[0], best[0]))
    return found[0] < best[0] - apart or (found[0] <= best[0] + apart and found[1] < best[1])


def _value(value: np.ndarray) -> float | tuple[float, ...]:
    return value.item() if value.ndim == 0 else tuple(value.tolist())
