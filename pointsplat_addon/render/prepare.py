"""What of a scene is drawn as points and what as polygons, how densely sampled, and which cut of it: numpy only.

Clouds and hierarchies depend on the geometry, its materials and an octave of spacing; they are kept in a `Store` that
all views and frames share. Only the cut depends on the view.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core import sampling
from ..core.appearance import digest, point_cloud
from ..core.cloud import PointCloud, finite
from ..core.cut import Cut, Forest, forest, fully, select
from ..core.hierarchy import Hierarchy, build
from ..core.scene import Camera, Geometry, Instances, Mesh, Scene, Settings

POLYGON_PIXELS = 4.0  # AUTO draws polygons where the typical triangle's edge spans more than this many pixels
HIERARCHY_PAYS = 80  # building costs about as much as drawing the points this many times
SMALL_SPLAT = 0.25  # of the tolerance: where typical splats are smaller, most of a cloud can be left out
NEAREST_INSTANCES = 64  # of one mesh, that are asked exactly how fine they need it


@dataclass(frozen=True, eq=False)
class PointSet:
    """Splats of one geometry: all points, or points and nodes."""

    key: tuple
    cloud: PointCloud
    hierarchy: Hierarchy | None = None

    def __len__(self) -> int:
        return len(self.cloud) + (len(self.hierarchy) if self.hierarchy else 0)


@dataclass(frozen=True, eq=False)
class Prepared:
    """What one view draws."""

    point_sets: dict[int, PointSet]  # by geometry row
    cut: Cut
    polygons: np.ndarray  # (P,) int: instances that are drawn as polygons
    view_from_object: np.ndarray  # (I, 4, 4) float64
    largest: float  # upper bound of a drawn splat's projected radius in pixels
    total: int  # points of all instances, before any cut
    warnings: tuple[str, ...] = ()


@dataclass
class Store:
    """Clouds and hierarchies by content, least recently used first; shared by threads."""

    limit: int = 4 << 30  # bytes
    nbytes: int = 0
    _items: OrderedDict[tuple, tuple[Any, int]] = field(default_factory=OrderedDict)
    _spacing: dict[tuple, float] = field(default_factory=dict)
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def __contains__(self, key: tuple) -> bool:
        with self._lock:
            return key in self._items

    def lookup(self, key: tuple, make: Callable[[], Any]) -> Any:
        with self._lock:
            if key not in self._items:
                item = make()
                self._items[key] = item, _nbytes(item)
                self.nbytes += self._items[key][1]
                self._trim()
            self._items.move_to_end(key)
            return self._items[key][0]

    def finest(self, key: tuple, spacing: float) -> float:
        """The finer of `spacing` and what was asked for `key` before: samples are only ever refined."""
        with self._lock:
            self._spacing[key] = min(spacing, self._spacing.get(key, np.inf))
            return self._spacing[key]

    def clear(self) -> None:
        with self._lock:
            self._items.clear()
            self._spacing.clear()
            self.nbytes = 0

    def _trim(self) -> None:
        while self.nbytes > self.limit and len(self._items) > 1:
            _, (_, size) = self._items.popitem(last=False)
            self.nbytes -= size


def _nbytes(item: Any) -> int:
    """Bytes of the arrays that an item, or the items of a tuple, hold."""
    if isinstance(item, tuple):
        return sum(_nbytes(part) for part in item)
    size = getattr(item, "nbytes", 0)
    return int(size) if isinstance(size, int | np.integer) else 0


STORE = Store()


def prepare(scene: Scene, camera: Camera, settings: Settings, samples: int, store: Store = STORE) -> Prepared:
    """Choose, sample and cut everything that `camera` sees."""
    instances = scene.instances
    with np.errstate(all="ignore"):
        view_from_object = camera.view_from_world @ instances.world_from_object
    usable = np.isfinite(view_from_object).all(axis=(1, 2)) if len(instances) else np.zeros(0, bool)
    warnings: list[str] = []
    point_sets: dict[int, PointSet] = {}
    polygons: list[np.ndarray] = []
    for row, geometry in enumerate(scene.geometries):
        where = np.flatnonzero(usable & (instances.geometry == row))
        if len(where) == 0:
            continue
        chosen = _choose(scene, geometry, view_from_object[where], camera, settings, store, warnings)
        if chosen is None:
            continue
        if chosen is POLYGONS:
            polygons.append(where)
        elif len(chosen):
            point_sets[row] = _with_hierarchy(chosen, view_from_object[where], camera, settings, samples, store)
    cut = _cut(scene, point_sets, view_from_object, camera, settings, store)
    counts = np.zeros(len(scene.geometries), np.int64)
    for row, points in point_sets.items():
        counts[row] = len(points.cloud)
    return Prepared(
        point_sets,
        cut,
        np.concatenate(polygons) if polygons else np.empty(0, np.int64),
        view_from_object,
        _largest(instances, point_sets, cut, view_from_object, camera, settings),
        int(counts[instances.geometry].sum()) if len(instances) else 0,
        tuple(dict.fromkeys(warnings)),
    )


POLYGONS = object()


def _choose(
    scene: Scene,
    geometry: Geometry,
    view_from_object: np.ndarray,
    camera: Camera,
    settings: Settings,
    store: Store,
    warnings: list[str],
) -> PointSet | object | None:
    """The points of a geometry at the density that this view needs, POLYGONS, or None where nothing can be seen."""
    if geometry.cloud is not None:
        cloud, dropped = store.lookup(("finite", geometry.key), lambda: finite(geometry.cloud))  # type: ignore[arg-type]
        if dropped:
            warnings.append(f"{geometry.name}: {dropped} points that are not finite were left out")
        return PointSet(("cloud", geometry.key), cloud)
    mesh = geometry.mesh
    if mesh is None or len(mesh.triangles) == 0:
        return None
    ok, dropped = store.lookup(("valid", geometry.key), lambda: sampling.validate(mesh))
    if dropped.total:
        warnings.append(dropped.message(geometry.name))
    if not ok.any():
        return None
    if geometry.primitive == "POLYGONS":
        return POLYGONS
    needed = sampling.required_spacing(mesh, view_from_object, camera, settings.tolerance, max_samples=None, ok=ok)
    if not np.isfinite(needed):
        return None
    if geometry.primitive == "AUTO":
        edge = store.lookup(("edge", geometry.key), lambda: _typical_edge(mesh, ok))
        if edge * settings.tolerance > POLYGON_PIXELS * needed:
            return POLYGONS
    spacing = geometry.spacing if geometry.spacing > 0 else needed
    look = digest(mesh, scene.materials)
    known = store.finest(("spacing", geometry.key, geometry.spacing), np.inf)
    if geometry.spacing <= 0 and spacing < known:
        spacing = sampling.quantise_spacing(sampling.limit_spacing(mesh, spacing, ok=ok))
    spacing = store.finest(("spacing", geometry.key, geometry.spacing), spacing)
    method = store.lookup(("method", geometry.key, spacing), lambda: sampling.choose(mesh, spacing, ok))
    key = ("samples", geometry.key, look, method, 0.0 if method == "VERTICES" else spacing)
    return PointSet(key, store.lookup(key, lambda: _sample(scene, mesh, spacing, method, ok)))


def _sample(scene: Scene, mesh: Mesh, spacing: float, method: str, ok: np.ndarray) -> PointCloud:
    samples = sampling.sample(mesh, spacing, method, ok)
    evaluated = sampling.evaluate(mesh, samples, ok=ok)
    return finite(point_cloud(mesh, samples, evaluated, scene.materials))[0]


def _typical_edge(mesh: Mesh, ok: np.ndarray) -> float:
    """The side of the square of the mean triangle's area."""
    a, b, c = mesh.position[mesh.triangles[ok]].astype(np.float64).transpose(1, 0, 2)
    return float(np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1).mean()))


def _with_hierarchy(
    points: PointSet,
    view_from_object: np.ndarray,
    camera: Camera,
    settings: Settings,
    samples: int,
    store: Store,
) -> PointSet:
    """The point-octree is built only where it can leave out most points, often enough to pay for itself."""
    key = ("hierarchy", *points.key)
    built = key in store
    size = store.lookup(("size", *points.key), lambda: _typical_radius(points.cloud))
    if not built:
        scale = np.abs(np.linalg.det(view_from_object[:, :3, :3])) ** (1 / 3)
        centre = view_from_object[:, :3, :3] @ _middle(points.cloud, store, points.key) + view_from_object[:, :3, 3]
        depth = np.maximum(-centre[:, 2], camera.near) if camera.perspective else 1.0
        diameter = 2 * size * scale * abs(camera.pixel_from_view()[0]) / depth
        small = np.count_nonzero(diameter < SMALL_SPLAT * settings.tolerance)
        if small * samples < HIERARCHY_PAYS:
            return points
    return PointSet(key, points.cloud, store.lookup(key, lambda: build(points.cloud)))


def _middle(cloud: PointCloud, store: Store, key: tuple) -> np.ndarray:
    return store.lookup(
        ("middle", *key), lambda: cloud.origin + (cloud.position.min(axis=0) + cloud.position.max(axis=0)) / 2
    )


def _typical_radius(cloud: PointCloud) -> float:
    if cloud.radii is None or len(cloud) == 0:
        return 0.0
    step = max(1, len(cloud) // 4096)
    return float(np.median(cloud.radii[::step, 0]))


def _cut(
    scene: Scene,
    point_sets: dict[int, PointSet],
    view_from_object: np.ndarray,
    camera: Camera,
    settings: Settings,
    store: Store,
) -> Cut:
    geometry = np.where(np.isin(scene.instances.geometry, list(point_sets)), scene.instances.geometry, -1)
    if not any(points.hierarchy for points in point_sets.values()):
        counts = np.zeros(len(scene.geometries) + 1, np.int64)
        for row, points in point_sets.items():
            counts[row] = len(points.cloud)
        good = np.isfinite(view_from_object).all(axis=(1, 2)) if len(geometry) else np.zeros(0, bool)
        return fully(counts, np.where(good, geometry, len(scene.geometries)))
    key = ("forest", *((row, points.key) for row, points in point_sets.items()))
    trees: Forest = store.lookup(key, lambda: forest({row: p.hierarchy or p.cloud for row, p in point_sets.items()}))
    cull = np.array([bool(scene.materials.cull[_rows(g)].all()) for g in scene.geometries], bool)
    return select(trees, geometry, view_from_object, camera, settings.tolerance, cull=cull[scene.instances.geometry])


def _rows(geometry: Geometry) -> list[int]:
    if geometry.mesh is not None:
        return list(geometry.mesh.materials)
    material = geometry.cloud.material if geometry.cloud is not None else None
    return [0] if material is None else np.unique(material).tolist()


def _largest(
    instances: Instances,
    point_sets: dict[int, PointSet],
    cut: Cut,
    view_from_object: np.ndarray,
    camera: Camera,
    settings: Settings,
) -> float:
    """No splat of the cut is wider than this radius in pixels: each instance's largest one at its nearest depth."""
    largest = 0.0
    focal = max(abs(f) for f in camera.pixel_from_view()[:2])
    for row, points in point_sets.items():
        where = np.flatnonzero(instances.geometry == row)
        matrix = view_from_object[where]
        cloud = points.cloud
        radius = 0.0 if cloud.radii is None else float(cloud.radii[:, 0].max(initial=0.0))
        low, high = cloud.position.min(axis=0), cloud.position.max(axis=0)
        reach = float(np.linalg.norm(high - low)) / 2
        with np.errstate(all="ignore"):
            scale = np.linalg.norm(matrix[:, :3, :3], axis=(1, 2))
            centre = matrix[:, :3, :3] @ (cloud.origin + (low + high) / 2) + matrix[:, :3, 3]
            depth = np.maximum(-centre[:, 2] - reach * scale, max(camera.near, 1e-6)) if camera.perspective else 1.0
            pixels = radius * scale * focal / depth
        largest = max(largest, float(np.nanmax(pixels, initial=0.0)))
    return max(largest, settings.tolerance if cut.nodes else 0.0)
