"""The cut through nodes over balls that a view draws: for each part of each instance, one level.

A level is one run of nodes, and so is each cell's part of it. The cut therefore speaks of cells that hold some hundred
nodes of the level that they need, not of nodes: it takes milliseconds, whatever it draws.
"""

from __future__ import annotations

import numpy as np

from ...numeric.linear import all_finite
from ...numeric.record import record, value_record
from ...numeric.segments import ranges
from ...scene.camera import Camera
from ..criteria import Criteria, InstanceViews, against_frustum, criteria_of, instance_views
from ..cut import Cut
from .tree import BallTree

EDGE = 1.0  # of the tolerance: the projected edge of the largest cells that are drawn as nodes
PART = 128  # nodes of one level, or balls, that are drawn together though some may be out of view or finer than needed
EVEN = 1.2  # farthest over nearest depth of what is drawn by one level


@record
class BallCut:
    """What instances of one tree draw: nodes, counted over all levels, and balls in the tree's order."""

    nodes: Cut
    balls: Cut


@value_record
class _Front:
    """Cells of one level, (n,) each."""

    instance: np.ndarray
    cell: np.ndarray
    inside: np.ndarray  # bool: known to lie in view as a whole

    def take(self, which: np.ndarray) -> _Front:
        return _Front(self.instance[which], self.cell[which], self.inside[which])


def cut_balls(
    tree: BallTree, view_from_object: np.ndarray, camera: Camera, tolerance: float, margin: float = 1.0
) -> BallCut:
    """The cut of the instances (I, 4, 4) float64 of a tree, with rows of these as instances.

    Cells are drawn as nodes where their edges project to at most EDGE times `tolerance` pixels, by the depth of the
    nearest of those drawn together. What extends into the camera's window, widened by `margin` pixels, is kept.
    Instances whose transform is not finite, or zero, draw nothing.
    """
    usable = all_finite(view_from_object) & view_from_object[:, :3, :3].any(axis=(1, 2))
    origin = np.broadcast_to(tree.cloud.origin, (len(usable), 3))
    views = instance_views(view_from_object, origin, None, usable)
    criteria = criteria_of(camera, tolerance, margin)
    instance = np.flatnonzero(usable)
    front = _Front(instance, np.zeros(len(instance), np.int64), np.zeros(len(instance), bool))
    found = _Found(tree)
    for level in range(len(tree.first)):
        if len(front.cell) == 0:
            break
        front = _descend(tree, views, criteria, level, front, found)
    return BallCut(found.cut("nodes"), found.cut("balls"))


def _descend(
    tree: BallTree, views: InstanceViews, criteria: Criteria, level: int, front: _Front, found: _Found
) -> _Front:
    """Decides about some cells of one level: what is drawn goes to `found`, the children of the rest are returned."""
    last = level == len(tree.first) - 1
    view, node = views.take(front.instance), tree.start[level] + front.cell
    x, y, z = tree.nodes.position[node].T
    position = np.stack([row[0] * x + row[1] * y + row[2] * z + row[3] for row in view.matrix])
    scale = np.broadcast_to(view.scale, len(node))
    # No ball is farther from the mean than the cell's diagonal.
    radius = (np.sqrt(3.0) * tree.edge[level] + tree.radius) * scale
    gone, inside = against_frustum(criteria, position, radius, front.inside)
    nearest, farthest = criteria.depth_range(position, radius)
    with np.errstate(divide="ignore"):
        allowed = 2 * EDGE * criteria.limit * (nearest if criteria.perspective else np.ones(len(node)))
        wanted = np.log2(np.maximum(tree.edge[0] * scale / allowed, 1.0))
    wanted = np.clip(np.ceil(wanted - 1e-9), level, len(tree.first)).astype(np.int64)
    first, end = tree.first[level][front.cell], tree.first[level][front.cell + 1]
    low, high = _parts(tree, wanted, first, end)
    even = (farthest <= EVEN * nearest) if criteria.perspective else np.ones(len(node), bool)
    drawn = ~gone & (last | (high - low <= PART) | (inside & even))
    found.add(front.instance[drawn], wanted[drawn], low[drawn], (high - low)[drawn])
    rest = np.flatnonzero(~(gone | drawn))
    if last or len(rest) == 0:
        return front.take(rest[:0])
    low, high = _parts(tree, np.full(len(rest), level + 1), first[rest], end[rest])
    count = high - low
    return _Front(np.repeat(front.instance[rest], count), ranges(low, count), np.repeat(inside[rest], count))


def _parts(tree: BallTree, level: np.ndarray, first: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cells, from `low` to `high`, of `level` (n,) that hold the balls from `first` to `end`, (n,) each: balls
    themselves where the level is finer than all."""
    low, high = first.astype(np.int64), end.astype(np.int64)
    for one in np.unique(level).tolist():
        if one < len(tree.first):
            some = level == one
            low[some] = np.searchsorted(tree.first[one], first[some])
            high[some] = np.searchsorted(tree.first[one], end[some])
    return low, high


class _Found:
    """Collects what is drawn and makes the cuts of it."""

    def __init__(self, tree: BallTree) -> None:
        self._tree = tree
        self._parts: list[tuple[np.ndarray, ...]] = []

    def add(self, instance: np.ndarray, level: np.ndarray, low: np.ndarray, count: np.ndarray) -> None:
        node = level < len(self._tree.first)
        start = np.append(self._tree.start[:-1], 0)[level]
        self._parts.append((instance, start + low, count, node))

    def cut(self, kind: str) -> Cut:
        """The ranges of "nodes" or "balls", joined where one continues another."""
        if not self._parts:
            none = np.empty(0, np.int64)
            return Cut(none.astype(np.int32), none, none)
        instance, first, count, node = (np.concatenate(column) for column in zip(*self._parts, strict=True))
        mine = node if kind == "nodes" else ~node
        instance, first, count = instance[mine], first[mine], count[mine]
        order = np.lexsort((first, instance))
        instance, first, count = instance[order], first[order], count[order]
        new = np.ones(len(first), bool)
        new[1:] = (first[1:] != first[:-1] + count[:-1]) | (instance[1:] != instance[:-1])
        begin = np.flatnonzero(new)
        total = int(count.sum())
        count = np.add.reduceat(count, begin) if len(begin) else count
        drawn = {"nodes": total} if kind == "nodes" else {"points": total}
        return Cut(instance[begin].astype(np.int32), first[begin], count, **drawn)
