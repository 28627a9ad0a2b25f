"""Level-of-detail selection (Pajarola 2003, section 6; Křivánek 2003, sections 3.4 and 3.5).

A cut holds, for every instance, the coarsest nodes whose projected size is within the tolerance. A node is
replaced only by all of its children, or by all of its points, so no cut has holes. The frontier of all
instances goes down one level at a time, as arrays of (instance, node).

Splats are counted per geometry as `node_splats.points_and_nodes` lays them out: N points in tree order, then M nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numeric.linear import all_finite
from ..numeric.record import record, value_record
from ..numeric.segments import ranges
from ..scene.camera import Camera
from ..splat.blur import IN_FOCUS, OUT_OF_FOCUS, Blur
from .criteria import (
    Criteria,
    InstanceViews,
    against_cone,
    against_frustum,
    blur_extent,
    criteria_of,
    instance_views,
    within_tolerance,
)
from .node_table import NodeTable

CHUNK = 1 << 15  # nodes that are classified together, so that their working arrays stay in the cache


@record
class Cut:
    """Ranges of splats to draw, sorted by (instance, first); no two of them touch or overlap."""

    instance: np.ndarray  # (R,) int32, rows of the instances
    first: np.ndarray  # (R,) int64, in the splats of the instance's geometry
    count: np.ndarray  # (R,) int64
    nodes: int = 0  # nodes drawn
    points: int = 0  # points drawn
    culled: int = 0  # points below nodes that are out of view or face away

    def renumbered(self, rows: np.ndarray) -> Cut:
        """The cut with instance i called rows[i]; `rows` (I,) rises."""
        return replace(self, instance=rows[self.instance].astype(np.int32))

    @property
    def splats(self) -> int:
        """How many splats are drawn."""
        return self.nodes + self.points


def cut_of_all_points(points: np.ndarray, geometry: np.ndarray) -> Cut:
    """The cut that draws all points of all instances and needs no hierarchy.

    `points` (G,): how many each geometry has; `geometry` (I,): the geometry of each instance.
    """
    count = np.asarray(points, np.int64)[geometry] if len(geometry) else np.empty(0, np.int64)
    instance = np.flatnonzero(count)
    return Cut(instance.astype(np.int32), np.zeros(len(instance), np.int64), count[instance], points=int(count.sum()))


def select_cut(
    table: NodeTable,
    geometry: np.ndarray,
    view_from_object: np.ndarray,
    camera: Camera,
    tolerance: float = 1.0,
    cull: np.ndarray | None = None,
    margin: float = 1.0,
    band: float = 0.0,
    blur: Blur | None = None,
    wanted: str = "ALL",
) -> Cut:
    """Selects the cut of one view.

    `geometry` (I,) holds geometry indices (instances of those that the table lacks are skipped), `view_from_object`
    (I, 4, 4) float64. A node is drawn where its projected diameter is at most `tolerance` pixels, or up to `band`
    octaves less, by a share that each node keeps (`criteria.transition_band`). `cull` (I,) bool: where back faces may
    be left out. Everything that extends into the camera's window, widened by `margin` pixels, is kept. Instances whose
    transform is not finite, or zero, have no splats.

    With a `blur`, nodes may be as large as their circles of confusion allow (core/lens/kernel.py), and `wanted` is ALL,
    BLURRED (only what may be out of focus) or SHARP (only what may be in focus, in nodes of the usual size).
    """
    geometry = np.asarray(geometry, np.int64)
    known = (geometry >= 0) & (geometry < len(table.root))
    row = np.where(known, geometry, 0)
    drawable = known & (table.points[row] > 0) if len(table.root) else np.zeros(len(geometry), bool)
    drawable &= all_finite(view_from_object) & view_from_object[:, :3, :3].any(axis=(1, 2))
    instance = np.flatnonzero(drawable)
    root = table.root[row[instance]]
    views = instance_views(view_from_object, table.origin[row] if len(table.root) else np.zeros((0, 3)), cull, drawable)

    found = _Found(table, row)
    bare = instance[root < 0]
    found.add_points(bare, np.zeros(len(bare), np.int64), table.points[row[bare]])
    inner = root >= 0
    front = _Front(instance[inner], root[inner], np.zeros(np.count_nonzero(inner), bool))
    criteria = replace(criteria_of(camera, tolerance, margin), band=band, blur=blur, wanted=wanted)
    while len(front.node):
        chunks = [slice(i, i + CHUNK) for i in range(0, len(front.node), CHUNK)]
        front = _Front.joined([_descend(table, views, criteria, front.take(chunk), found) for chunk in chunks])
    return found.cut()


@value_record
class _Front:
    """Nodes of one level that are to be decided about."""

    instance: np.ndarray  # (n,) int64
    node: np.ndarray  # (n,) int64, rows of the table
    inside: np.ndarray  # (n,) bool: whether an ancestor lies in the frustum as a whole

    def take(self, which: slice) -> _Front:
        return _Front(self.instance[which], self.node[which], self.inside[which])

    @staticmethod
    def joined(fronts: list[_Front]) -> _Front:
        names = ("instance", "node", "inside")
        return _Front(*(np.concatenate([getattr(front, name) for front in fronts]) for name in names))


@value_record
class _Ranges:
    """Ranges of splats, sorted by (instance, first); int64 all, (R,)."""

    instance: np.ndarray
    first: np.ndarray
    count: np.ndarray

    def merged(self) -> _Ranges:
        """Each range joined with its predecessor where it continues it."""
        instance, first, count = self.instance, self.first.astype(np.int64), self.count
        new = np.ones(len(first), bool)
        new[1:] = (first[1:] != first[:-1] + count[:-1]) | (instance[1:] != instance[:-1])
        at = np.flatnonzero(new)
        return _Ranges(instance[at].astype(np.int64), first[at], np.add.reduceat(count, at, dtype=np.int64))


class _Found:
    """Collects what is drawn and makes the cut of it."""

    def __init__(self, table: NodeTable, geometry: np.ndarray) -> None:
        self.table, self.geometry = table, geometry
        self.ranges: list[_Ranges] = []
        self.nodes = self.points = self.culled = 0

    def add_points(self, instance: np.ndarray, first: np.ndarray, count: np.ndarray) -> None:
        self.points += int(count.sum())
        self._add(instance, first, count)

    def add_nodes(self, instance: np.ndarray, node: np.ndarray) -> None:
        self.nodes += len(node)
        geometry = self.geometry[instance]
        first = node - self.table.root[geometry] + self.table.points[geometry]
        self._add(instance, first, np.ones(len(node), np.int64))

    def _add(self, instance: np.ndarray, first: np.ndarray, count: np.ndarray) -> None:
        if len(instance):
            self.ranges.append(_Ranges(instance, first, count).merged())

    def cut(self) -> Cut:
        if not self.ranges:
            none = np.empty(0, np.int64)
            return Cut(none.astype(np.int32), none, none, culled=self.culled)
        names = ("instance", "first", "count")
        instance, first, count = (np.concatenate([getattr(r, name) for r in self.ranges]) for name in names)
        # Each level is sorted already: a stable sort only has to merge them.
        order = (instance << 32 | first).argsort(kind="stable")
        merged = _Ranges(instance[order], first[order], count[order]).merged()
        return Cut(merged.instance.astype(np.int32), merged.first, merged.count, self.nodes, self.points, self.culled)


def _descend(table: NodeTable, views: InstanceViews, criteria: Criteria, front: _Front, found: _Found) -> _Front:
    """Decides about some nodes of one level: what is drawn goes to `found`, the children of the rest are returned."""
    instance, node = front.instance, front.node
    view = views.take(instance)
    center = table.center.take(node, axis=1)
    sphere = table.sphere.take(node)
    position = np.stack([m[0] * center[0] + m[1] * center[1] + m[2] * center[2] + m[3] for m in view.matrix])
    radius = sphere * view.scale

    # What is out of view or faces away is left out; `safe` are nodes of which no part can be.
    blurred = blur_extent(criteria, position, radius)
    gone, inside = against_frustum(criteria, position, radius + blurred.beyond, front.inside)
    safe = inside
    if criteria.blur is not None:
        outside = {"BLURRED": blurred.most <= IN_FOCUS, "SHARP": blurred.least >= OUT_OF_FOCUS}.get(criteria.wanted)
        if outside is not None:
            gone, safe = gone | outside, inside & (blurred.most < OUT_OF_FOCUS)
    if view.culls.any():
        away, toward = against_cone(table, view, criteria, node, center, sphere)
        gone, safe = gone | away, inside & toward
    count = table.point_count.take(node)
    found.culled += int(count[gone].sum(dtype=np.int64))

    # A node small enough is drawn; one whose descendants are all too large shows all its points, as do leaves.
    size = table.size.take(node) * view.scale
    small, large = within_tolerance(table, criteria, node, position, size, radius, view.scale)
    drawn = ~gone & small & (count > 1)
    children = table.child_count.take(node)
    whole = ~gone & ~drawn & ((children == 0) | (safe & large))
    found.add_nodes(instance[drawn], node[drawn])
    found.add_points(instance[whole], table.first_point.take(node[whole]), count[whole])

    rest = np.flatnonzero(~(gone | drawn | whole))
    children = children[rest]
    return _Front(
        np.repeat(instance[rest], children),
        ranges(table.first_child.take(node[rest]), children),
        np.repeat(inside[rest], children),
    )
