"""Removes layers of a prepared view that cannot be seen: those out of view, and those that are fully transparent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from ...core.lod.cut import Cut
from ...core.lod.instances import visible_instances
from ...core.numeric.linear import all_finite, largest_singular_value
from ...core.numeric.vectors import blocks
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .meshes.points import keep_mesh_balls, mesh_ball
from .point_sets import Layer, PointSet, set_ball
from .prepare import Prepared

MARGIN = 8.0  # pixels: kernels end this far outside of what they cover, at most
OUT_OF_VIEW, CLEAR = "nothing of it is in view", "nothing of it hides or emits light"
TOGETHER = 4096  # instances, at least, that are looked at as one
Ball = tuple[np.ndarray, np.ndarray, float]  # view_from_object (I, 4, 4); centre (3,) and radius in object space
Balls = tuple[np.ndarray, np.ndarray, np.ndarray]  # the same with a centre (I, 3) and a radius (I,) for each


def without_invisible_layers(
    scene: Scene, prepared: Prepared, camera: Camera, store: Store
) -> tuple[Prepared, dict[str, str]]:
    """Returns a prepared view without layers that cannot be seen, and the reason by name of each such layer.

    The names are points, translucent, spheres and polygons.

    A layer is removed or kept as a whole: if its sets were removed one by one, pages would be uploaded again at each
    change. A lens blurs things outside the picture into it: with an aperture, only transparent layers are removed.
    """
    gone: dict[str, str] = {}
    if prepared.out_of_focus is not None:
        return prepared, gone
    sharp = camera.aperture is None
    for name, layer in (("points", prepared), ("translucent", prepared.translucent), ("spheres", prepared.spheres)):
        if layer.cut.splats == 0:
            continue
        if sharp and not _any_visible(layer_balls(layer, prepared.view_from_object, store), camera):
            gone[name] = OUT_OF_VIEW
        elif name == "translucent" and all(_is_clear(points, store) for points in layer.point_sets.values()):
            gone[name] = CLEAR
    if sharp and len(prepared.all_polygons) and not _any_visible(polygon_balls(scene, prepared, store), camera):
        gone["polygons"] = OUT_OF_VIEW
    return (_without_layers(prepared, gone), gone) if gone else (prepared, gone)


def layer_balls(layer: Layer, view_from_object: np.ndarray, store: Store) -> Iterator[Ball]:
    """Yields a ball for each point set; nodes may extend as far beyond its points as the widest splat does."""
    for key, points in layer.point_sets.items():
        middle, far, radius = set_ball(points, store)
        yield view_from_object[layer.set_of_instance == key], middle, far + 2 * radius


def polygon_balls(scene: Scene, prepared: Prepared, store: Store) -> Iterator[Ball]:
    """Yields a ball for each mesh of which instances are drawn as polygons or panes."""
    drawn = np.zeros(len(scene.instances), bool)
    drawn[prepared.all_polygons] = True
    of_each = zip(scene.geometries, scene.instances.of_each(len(scene.geometries), drawn), strict=True)
    found = [(geometry.mesh, where) for geometry, where in of_each if geometry.mesh is not None and len(where)]
    keep_mesh_balls([mesh for mesh, _ in found], store)
    for mesh, where in found:
        middle, reach = mesh_ball(mesh, store)
        yield prepared.view_from_object[where], middle, reach


def _joined(balls: Iterable[Ball]) -> Iterator[Balls]:
    """Yields the same balls in blocks: scenes may have thousands of geometries of one instance, or one of a million."""
    parts: list[Ball] = []
    gathered = 0

    def join() -> Balls:
        count = [len(views) for views, _, _ in parts]
        views, middles, radii = zip(*parts, strict=True)
        return np.concatenate(views), np.repeat(np.stack(middles), count, axis=0), np.repeat(np.array(radii), count)

    for views, middle, reach in balls:
        for some in blocks(len(views)):
            parts.append((views[some], middle, reach))
            gathered += len(views[some])
            if gathered >= TOGETHER:
                yield join()
                parts, gathered = [], 0
    if parts:
        yield join()


def ball_of_all_drawn(scene: Scene, prepared: Prepared, store: Store) -> tuple[np.ndarray, float]:
    """Returns centre (3,) in view space and radius of a ball about all that is drawn; it is infinite if there are
    strands."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    layers = (prepared, prepared.translucent, prepared.spheres, prepared.nodes)
    found = (ball for layer in layers for ball in layer_balls(layer, prepared.view_from_object, store))
    for views, middle, reach in _joined(chain(found, polygon_balls(scene, prepared, store))):
        finite = all_finite(views)
        views, middle, reach = views[finite], middle[finite], reach[finite]
        centre = np.einsum("iab,ib->ia", views[:, :3, :3], middle) + views[:, :3, 3]
        radius = (reach * largest_singular_value(views[:, :3, :3]))[:, None]
        low = np.minimum(low, (centre - radius).min(axis=0, initial=np.inf))
        high = np.maximum(high, (centre + radius).max(axis=0, initial=-np.inf))
    if prepared.strands or not (np.isfinite(low) & np.isfinite(high)).all():
        return np.zeros(3), np.inf
    return (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def _any_visible(balls: Iterator[Ball], camera: Camera) -> bool:
    """Tells whether any instance of any ball may intersect the picture."""
    return any(
        bool(visible_instances(views, middle, reach, camera, MARGIN).any()) for views, middle, reach in _joined(balls)
    )


def _is_clear(points: PointSet, store: Store) -> bool:
    """Tells whether all splats are fully transparent and emit no light."""

    def look() -> bool:
        cloud = points.cloud
        matter = cloud.opacity if cloud.extinction is None else cloud.extinction
        glows = cloud.extinction is not None and cloud.emission is not None and bool((cloud.emission > 0).any())
        return matter is not None and not glows and not bool((matter > 0).any())

    return store.lookup(Key(Kind.IS_INVISIBLE, points.key), look)


def _without_layers(prepared: Prepared, gone: dict[str, str]) -> Prepared:
    """Returns a prepared view with the layers that `gone` names emptied."""
    none = np.full(len(prepared.set_of_instance), -1)
    nothing = Cut(np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0, np.int64))
    empty = Layer({}, none, nothing)
    more = {name: empty for name in ("translucent", "spheres") if name in gone}
    if "polygons" in gone:
        more |= {"polygons": np.empty(0, np.int64), "panes": np.empty(0, np.int64), "parts": {}}
    if "points" in gone:
        more |= {"point_sets": {}, "set_of_instance": none, "cut": nothing, "largest": 0.0}
    return replace(prepared, **more)
