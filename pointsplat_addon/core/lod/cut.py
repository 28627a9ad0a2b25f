"""Level-of-detail selection (Pajarola 2003, section 6; Křivánek 2003, sections 3.4 and 3.5).

A cut holds, for every instance, the coarsest nodes whose projected size is within the tolerance. A node is
replaced only by all of its children, or by all of its points, so no cut has holes. The frontier of all
instances goes down one level at a time, as arrays of (instance, node).

Splats are counted per geometry as `hierarchy.splats` lays them out: N points in tree order, then M nodes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..numeric.linear import all_finite, largest_singular_value
from ..numeric.segments import ranges, starts
from ..numeric.vectors import number
from ..scene.camera import Camera
from ..scene.cloud import PointCloud
from ..splat.blur import BLURRED, IN_FOCUS, Blur
from .hierarchy import Hierarchy

NEIGHBOURS = 3.0  # radii from a splat's middle to the farthest ends of those beside it
CHUNK = 1 << 15  # nodes that are classified together, so that their working arrays stay in the cache
BAND = 0.25  # octaves, see `staggered`: a fifth more nodes in the mean, on surfaces
FLAT = 1e-12  # determinant over scale^3 below which a transform has no inverse worth using


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


@dataclass(frozen=True, eq=False)
class Forest:
    """Of several geometries' nodes, one after the other, what a cut reads. Made once per set of hierarchies.

    Columns are contiguous; `root` and `points` have a row for each geometry index up to the largest.
    """

    root: np.ndarray  # (G,) int64: the geometry's first node; -1 for a cloud without nodes
    points: np.ndarray  # (G,) int64; 0 for geometries that are not drawn as points
    origin: np.ndarray  # (G, 3) float64
    first_child: np.ndarray  # (M,) int64, in the forest
    child_count: np.ndarray  # (M,) uint8
    first_point: np.ndarray  # (M,) int32
    point_count: np.ndarray  # (M,) int32
    center: np.ndarray  # (3, M) float32
    normal: np.ndarray  # (3, M) float32
    cone: np.ndarray  # (2, M) float32
    sphere: np.ndarray  # (M,) float32
    size: np.ndarray  # (M,) float32
    smallest: np.ndarray  # (M,) float32
    lot: np.ndarray  # (M,) float32 in [0, 1): each node's own, whatever else the forest holds


def forest(hierarchies: Mapping[int, Hierarchy | PointCloud]) -> Forest:
    """Hierarchies by geometry index. A PointCloud stands for one without nodes, which is always drawn whole."""
    geometries = max(hierarchies, default=-1) + 1
    root, points, origin = np.full(geometries, -1), np.zeros(geometries, np.int64), np.zeros((geometries, 3))
    trees: list[Hierarchy] = []
    base = 0
    for geometry, entry in hierarchies.items():
        cloud = entry if isinstance(entry, PointCloud) else entry.cloud
        points[geometry], origin[geometry] = len(cloud), cloud.origin
        if isinstance(entry, Hierarchy) and len(entry):
            root[geometry] = base
            base += len(entry)
            trees.append(entry)
    bases = starts([len(h) for h in trees])
    first_child = [h.tree.first_child.astype(np.int64) + b for h, b in zip(trees, bases, strict=True)]

    def joined(arrays: list[np.ndarray], dtype: type) -> np.ndarray:
        return np.concatenate([np.empty((*arrays[0].shape[:-1], 0) if arrays else 0, dtype), *arrays], axis=-1)

    return Forest(
        root, points, origin,
        first_child=joined(first_child, np.int64),
        child_count=joined([h.tree.child_count for h in trees], np.uint8),
        first_point=joined([h.tree.first_point for h in trees], np.int32),
        point_count=joined([h.tree.point_count for h in trees], np.int32),
        center=joined([h.center.T for h in trees], np.float32),
        normal=joined([h.normal.T for h in trees], np.float32),
        cone=joined([h.cone.T for h in trees], np.float32),
        sphere=joined([h.sphere for h in trees], np.float32),
        size=joined([h.size for h in trees], np.float32),
        smallest=joined([h.smallest for h in trees], np.float32),
        lot=joined([number(np.arange(len(h))) for h in trees], np.float32),
    )  # fmt: skip


def fully(points: np.ndarray, geometry: np.ndarray) -> Cut:
    """The cut of all points: `points` (G,) per geometry, `geometry` (I,) per instance. Needs no hierarchy."""
    count = np.asarray(points, np.int64)[geometry] if len(geometry) else np.empty(0, np.int64)
    instance = np.flatnonzero(count)
    return Cut(instance.astype(np.int32), np.zeros(len(instance), np.int64), count[instance], points=int(count.sum()))


def select(
    forest: Forest,
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
    views = _views(view_from_object, forest.origin[place] if len(forest.root) else np.zeros((0, 3)), cull, drawable)

    found = _Found(forest, place)
    bare = instance[root < 0]
    found.add_points(bare, np.zeros(len(bare), np.int64), forest.points[place[bare]])
    instance, node = instance[root >= 0], root[root >= 0]
    inside = np.zeros(len(node), bool)
    lens = replace(lens_of(camera, tolerance, margin), band=band, blur=blur, wanted=wanted)
    while len(node):
        pieces = [
            _step(forest, views, lens, instance[i : i + CHUNK], node[i : i + CHUNK], inside[i : i + CHUNK], found)
            for i in range(0, len(node), CHUNK)
        ]
        instance, node, inside = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    return found.cut()


@dataclass(frozen=True)
class Lens:
    """The camera as the tests need it."""

    planes: np.ndarray  # (6, 4) float64, view space: a sphere is outside where plane . (p, 1) < -radius
    perspective: bool
    near: float
    limit: float  # tolerance over twice the focal length: projected half size over distance
    tolerance: float
    band: float = 0.0  # octaves by which nodes' limits lie below that, each by its own share of them
    blur: Blur | None = None
    wanted: str = "ALL"  # where there is a blur: ALL, BLURRED or SHARP

    def disk(self, depth: np.ndarray) -> np.ndarray:
        """World units: radius of the disks of confusion at these depths."""
        assert self.blur is not None
        per_pixel = 2 * self.limit / self.tolerance
        return self.blur.radius(depth) * per_pixel * (np.abs(depth) if self.perspective else 1.0)


@dataclass(frozen=True)
class _Views:
    """Per instance, in columns."""

    matrix: np.ndarray  # (3, 4, I) float64, view from points relative to the cloud's origin
    scale: np.ndarray  # (I,) float64: largest singular value
    culls: np.ndarray  # (I,) bool
    eye: np.ndarray  # (3, I) float64, relative to the cloud's origin; only where `culls`
    forward: np.ndarray  # (3, I) float64, unit, in object space; only where `culls`


def lens_of(camera: Camera, tolerance: float, margin: float) -> Lens:
    """Frustum planes (Gribb and Hartmann 2001) of the window, from the rows of clip_from_view."""
    x, y, z, w = camera.clip_from_view
    (width, height), (x0, y0, across, up) = camera.resolution, camera.window
    planes = np.stack([
        x - (2 * (x0 - margin) / width - 1) * w,
        (2 * (x0 + across + margin) / width - 1) * w - x,
        y - (2 * (y0 - margin) / height - 1) * w,
        (2 * (y0 + up + margin) / height - 1) * w - y,
        z + w,
        w - z,
    ])  # fmt: skip
    length = np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    # A far plane at infinity has no direction and excludes nothing.
    planes = np.where(length > 1e-12, planes / np.maximum(length, 1e-300), [0.0, 0.0, 0.0, np.inf])
    fx, fy, _, _ = camera.pixel_from_view()
    return Lens(planes, camera.perspective, max(camera.near, 0.0), tolerance / (2 * max(abs(fx), abs(fy))), tolerance)


def staggered(tolerance: float) -> float:
    """Octaves of projected size over which the nodes of one level give way to their children. Of a surface that faces
    the camera all of them would otherwise do so in one frame, and be seen to where they are wider than a pixel; what is
    not changes unseen, and gets no more nodes than it needs."""
    return BAND * min(math.log2(max(tolerance, 1.0)), 1.0)


def _views(view_from_object: np.ndarray, origin: np.ndarray, cull: np.ndarray | None, use: np.ndarray) -> _Views:
    matrix = np.where(use[:, None, None], view_from_object[:, :3], 0.0)
    linear = matrix[:, :, :3]
    matrix[:, :, 3] += np.einsum("kij,kj->ki", linear, origin) if len(origin) else 0.0
    scale = largest_singular_value(linear)
    flat = np.abs(np.linalg.det(linear)) <= FLAT * scale**3
    culls = np.zeros(len(scale), bool) if cull is None else np.asarray(cull, bool) & ~flat
    eye, forward = np.zeros((3, len(scale))), np.zeros((3, len(scale)))
    if culls.any():
        inverse = np.linalg.inv(linear[culls])
        eye[:, culls] = -np.einsum("kij,kj->ik", inverse, matrix[culls, :, 3])
        backward = inverse[:, :, 2].T
        forward[:, culls] = -backward / np.linalg.norm(backward, axis=0)
    return _Views(np.ascontiguousarray(matrix.transpose(1, 2, 0)), scale, culls, eye, forward)


class _Found:
    """Collects what is drawn and makes the cut of it."""

    def __init__(self, forest: Forest, geometry: np.ndarray) -> None:
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
    forest: Forest,
    views: _Views,
    lens: Lens,
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
    away, least, most = _confusion(lens, position, reach)
    gone, inside = against_frustum(lens, position, reach + away, inside)
    safe = inside
    if lens.blur is not None:
        outside = {"BLURRED": most <= IN_FOCUS, "SHARP": least >= BLURRED}.get(lens.wanted)
        if outside is not None:
            gone, safe = gone | outside, inside & (most < BLURRED)
    if view.culls.any():
        away, toward = _against_cone(forest, view, lens, node, center, sphere)
        gone, safe = gone | away, inside & toward
    count = forest.point_count.take(node)
    found.culled += int(count[gone].sum(dtype=np.int64))

    # A node small enough is drawn; one whose descendants are all too large shows all its points, as do leaves.
    small, large = _projected(forest, lens, node, position, forest.size.take(node) * view.scale, reach, view.scale)
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


def _pick(views: _Views, instance: np.ndarray) -> _Views:
    """The views of a frontier's nodes; columns of length one where there is but one instance."""
    if len(views.scale) == 1:
        return views
    culls = views.culls.take(instance)
    use = instance if culls.any() else instance[:0]
    return _Views(
        views.matrix.take(instance, axis=2), views.scale.take(instance), culls,
        views.eye.take(use, axis=1), views.forward.take(use, axis=1),
    )  # fmt: skip


def against_frustum(
    lens: Lens, position: np.ndarray, reach: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which balls lie outside one of the planes, and which lie inside all of them."""
    gone, inside = np.zeros(len(inside), bool), inside.copy()
    check = np.flatnonzero(~inside)
    if len(check):
        p, r = position.take(check, axis=1), reach.take(check)
        nearest = np.full(len(check), np.inf)
        for a, b, c, d in lens.planes:
            np.minimum(nearest, a * p[0] + b * p[1] + c * p[2] + d, out=nearest)
        gone[check], inside[check] = nearest < -r, nearest >= r
    return gone, inside


def _confusion(
    lens: Lens, position: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray | float, np.ndarray, np.ndarray]:
    """How far balls reach beyond themselves where they are blurred, in world units, and the least and the greatest
    radius in pixels of their disks of confusion."""
    if lens.blur is None:
        return 0.0, np.empty(0), np.empty(0)
    # Surfaces are rebuilt from splats together with their neighbours: what is in focus needs those that are not.
    near, far = _depths(lens, position, reach * (NEIGHBOURS if lens.wanted == "SHARP" else 1.0))
    least, most = lens.blur.bounds(near, far)
    return np.maximum(lens.disk(near), lens.disk(far)) if lens.wanted != "SHARP" else 0.0, least, most


def _depths(lens: Lens, position: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of balls, as far as they may be seen."""
    depth = -position[2]
    if not lens.perspective:
        return depth - reach, depth + reach
    return np.maximum(depth - reach, lens.near), np.maximum(depth + reach, lens.near)


def _against_cone(
    forest: Forest, view: _Views, lens: Lens, node: np.ndarray, center: np.ndarray, sphere: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes face away as a whole, and which face the eye as a whole (all, where nothing is culled).

    In object space, since affine maps keep the sign of n . (eye - p). With phi the angle of the cone's axis
    to the ray, theta the cone's and beta the ball's half-angle: all of it faces away if
    phi + theta + beta <= 90 degrees.
    """
    cosine, sine = forest.cone.take(node, axis=1).astype(np.float64)
    normal = forest.normal.take(node, axis=1)
    if lens.perspective:
        ray = center - view.eye
        tangent = np.sqrt(np.maximum((ray**2).sum(axis=0) - sphere.astype(np.float64) ** 2, 0))
        along = (normal * ray).sum(axis=0)
        least = sine * tangent + cosine * sphere
        narrow = (tangent > 0) & (cosine * np.hypot(tangent, sphere) >= sphere)
    else:
        along, least, narrow = (normal * view.forward).sum(axis=0), sine, cosine >= 0
    return view.culls & narrow & (along >= least), ~view.culls | (narrow & (along <= -least))


def _projected(
    forest: Forest,
    lens: Lens,
    node: np.ndarray,
    position: np.ndarray,
    size: np.ndarray,
    reach: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes are at most as large as their share of the tolerance, and of which all descendants exceed all of it.

    The picture of a ball of radius r whose center has depth z and distance D is longest along the radius from
    the picture's center: f (tan(theta + beta) - tan(theta - beta)) = 2 f r sqrt(D^2 - r^2) / (z^2 - r^2).
    Nodes that reach before the near plane have no size there, and are refined.
    """
    smallest = forest.smallest.take(node) * scale
    limit = lens.limit
    if lens.blur is not None and lens.wanted != "SHARP":
        # Nodes of all sizes may be drawn, where the blur allows it.
        smallest = np.zeros(len(node))
        least, _ = lens.blur.bounds(*_depths(lens, position, size))
        limit = limit * (lens.blur.widest(least, lens.tolerance) / lens.tolerance)
    limit = limit * 2.0 ** (-lens.band * forest.lot.take(node)) if lens.band > 0 else limit
    if not lens.perspective:
        return size <= limit, smallest > lens.limit
    z = -position[2]
    squares = z * z - size * size
    distance = position[0] ** 2 + position[1] ** 2 + squares
    small = (z - size > lens.near) & (size * np.sqrt(np.maximum(distance, 0)) <= limit * squares)
    # No descendant is deeper than the ball's far side, and none projects smaller than r / z.
    return small, smallest > lens.limit * np.maximum(z + reach, 0)
