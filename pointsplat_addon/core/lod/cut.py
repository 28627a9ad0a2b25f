"""Level-of-detail selection (Pajarola 2003, section 6; Křivánek 2003, sections 3.4 and 3.5).

A cut holds, for every instance, the coarsest nodes whose projected size is within the tolerance. A node is
replaced only by all of its children, or by all of its points, so no cut has holes. The frontier of all
instances goes down one level at a time, as arrays of (instance, node).

Splats are counted per geometry as `hierarchy.splats` lays them out: N points in tree order, then M nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..numeric.linear import all_finite
from ..numeric.segments import ranges
from ..scene.camera import Camera
from ..splat.blur import IN_FOCUS, OUT_OF_FOCUS, Blur
from .criteria import (
    Criteria,
    InstanceViews,
    _pick,
    against_cone,
    against_frustum,
    blur_extent,
    criteria_of,
    instance_views,
    within_tolerance,
)
from .node_table import NodeTable

CHUNK = 1 << 15  # nodes that are classified together, so that their working arrays stay in the cache


@dataclass(frozen=True, eq=False)
class Cut:
    """Ranges of splats to draw, sorted by (instance, first); no two of them touch or overlap."""

    instance: np.ndarray  # (R,) int32, rows of the instances
    first: np.ndarray  # (R,) int64, in the splats of the instance's geometry
    count: np.ndarray  # (R,) int64
    nodes: int = 0  # nodes drawn
    points: int = 0  # points drawn
    culled: int = 0  # points below nodes that are out of view or face away

    def of(self, rows: np.ndarray) -> Cut:
        """The same, where instances were counted among `rows`, in rising order."""
        return replace(self, instance=rows[self.instance].astype(np.int32))

    @property
    def splats(self) -> int:
        return self.nodes + self.points


def cut_of_all_points(points: np.ndarray, geometry: np.ndarray) -> Cut:
    """The cut of all points: `points` (G,) per geometry, `geometry` (I,) per instance. Needs no hierarchy."""
    count = np.asarray(points, np.int64)[geometry] if len(geometry) else np.empty(0, np.int64)
    instance = np.flatnonzero(count)
    return Cut(instance.astype(np.int32), np.zeros(len(instance), np.int64), count[instance], points=int(count.sum()))


def select_cut(
    forest: NodeTable,
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
    """The cut of one view.

    `geometry` (I,) holds geometry indices (those that the forest lacks are skipped), `view_from_object`
    (I, 4, 4) float64. A node is drawn where its projected diameter is at most `tolerance` pixels, or up to `band`
    octaves less, a share that each node keeps (`staggered`). `cull` (I,) bool allows to leave out what faces away.
    Whatever reaches into the camera's window, widened by `margin` pixels, is kept. Instances whose transform is not
    finite, or zero, have no splats. `blur`: nodes may be as large as their disks of confusion allow (core/lens/defocus.py);
    `wanted`: ALL, only what may be out of focus (BLURRED), or only what may be in it, in usual nodes (SHARP).
    """
    geometry = np.asarray(geometry, np.int64)
    known = (geometry >= 0) & (geometry < len(forest.root))
    place = np.where(known, geometry, 0)
    drawable = known & (forest.points[place] > 0) if len(forest.root) else np.zeros(len(geometry), bool)
    drawable &= all_finite(view_from_object) & view_from_object[:, :3, :3].any(axis=(1, 2))
    instance = np.flatnonzero(drawable)
    root = forest.root[place[instance]]
    views = instance_views(
        view_from_object, forest.origin[place] if len(forest.root) else np.zeros((0, 3)), cull, drawable
    )

    found = _Found(forest, place)
    bare = instance[root < 0]
    found.add_points(bare, np.zeros(len(bare), np.int64), forest.points[place[bare]])
    instance, node = instance[root >= 0], root[root >= 0]
    inside = np.zeros(len(node), bool)
    lens = replace(criteria_of(camera, tolerance, margin), band=band, blur=blur, wanted=wanted)
    while len(node):
        pieces = [
            _step(forest, views, lens, instance[i : i + CHUNK], node[i : i + CHUNK], inside[i : i + CHUNK], found)
            for i in range(0, len(node), CHUNK)
        ]
        instance, node, inside = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    return found.cut()


class _Found:
    """Collects what is drawn and makes the cut of it."""

    def __init__(self, forest: NodeTable, geometry: np.ndarray) -> None:
        self.forest, self.geometry = forest, geometry
        self.instance, self.first, self.count = [], [], []
        self.nodes = self.points = self.culled = 0

    def add_points(self, instance: np.ndarray, first: np.ndarray, count: np.ndarray) -> None:
        self.points += int(count.sum())
        self._add(instance, first, count)

    def add_nodes(self, instance: np.ndarray, node: np.ndarray) -> None:
        self.nodes += len(node)
        geometry = self.geometry[instance]
        first = node - self.forest.root[geometry] + self.forest.points[geometry]
        self._add(instance, first, np.ones(len(node), np.int64))

    def _add(self, instance: np.ndarray, first: np.ndarray, count: np.ndarray) -> None:
        if len(instance):
            for held, array in zip(
                (self.instance, self.first, self.count), _merge(instance, first, count), strict=True
            ):
                held.append(array)

    def cut(self) -> Cut:
        if not self.instance:
            none = np.empty(0, np.int64)
            return Cut(none.astype(np.int32), none, none, culled=self.culled)
        instance, first, count = (np.concatenate(a) for a in (self.instance, self.first, self.count))
        # Each level is sorted already: a stable sort only has to merge them.
        order = (instance << 32 | first).argsort(kind="stable")
        instance, first, count = _merge(instance[order], first[order], count[order])
        return Cut(instance.astype(np.int32), first, count, self.nodes, self.points, self.culled)


def _merge(instance: np.ndarray, first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Join each range with its predecessor where it continues it; int64 all."""
    first = first.astype(np.int64)
    new = np.ones(len(first), bool)
    new[1:] = (first[1:] != first[:-1] + count[:-1]) | (instance[1:] != instance[:-1])
    at = np.flatnonzero(new)
    return instance[at].astype(np.int64), first[at], np.add.reduceat(count, at, dtype=np.int64)


def _step(
    forest: NodeTable,
    views: InstanceViews,
    lens: Criteria,
    instance: np.ndarray,
    node: np.ndarray,
    inside: np.ndarray,
    found: _Found,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decide about some nodes of one level; what is drawn goes to `found`, the children of the rest come back.

    `inside` says which nodes have an ancestor that lies in the frustum as a whole.
    """
    view = _pick(views, instance)
    center = forest.center.take(node, axis=1)
    sphere = forest.sphere.take(node)
    position = np.stack([m[0] * center[0] + m[1] * center[1] + m[2] * center[2] + m[3] for m in view.matrix])
    reach = sphere * view.scale

    # What is out of view or faces away is left out; `safe` are nodes of which no part can be.
    away, least, most = blur_extent(lens, position, reach)
    gone, inside = against_frustum(lens, position, reach + away, inside)
    safe = inside
    if lens.blur is not None:
        outside = {"BLURRED": most <= IN_FOCUS, "SHARP": least >= OUT_OF_FOCUS}.get(lens.wanted)
        if outside is not None:
            gone, safe = gone | outside, inside & (most < OUT_OF_FOCUS)
    if view.culls.any():
        away, toward = against_cone(forest, view, lens, node, center, sphere)
        gone, safe = gone | away, inside & toward
    count = forest.point_count.take(node)
    found.culled += int(count[gone].sum(dtype=np.int64))

    # A node small enough is drawn; one whose descendants are all too large shows all its points, as do leaves.
    small, large = within_tolerance(
        forest, lens, node, position, forest.size.take(node) * view.scale, reach, view.scale
    )
    drawn = ~gone & small & (count > 1)
    children = forest.child_count.take(node)
    whole = ~gone & ~drawn & ((children == 0) | (safe & large))
    found.add_nodes(instance[drawn], node[drawn])
    found.add_points(instance[whole], forest.first_point.take(node[whole]), count[whole])

    rest = np.flatnonzero(~(gone | drawn | whole))
    children = children[rest]
    return (
        np.repeat(instance[rest], children),
        ranges(forest.first_child.take(node[rest]), children),
        np.repeat(inside[rest], children),
    )
