"""Nested maps of suns: finer depth maps of what a camera sees from near, within those of the whole scene.

A picture's pixels are narrower near the camera than a map of a whole park can be. Up to three maps more show what
lies nearer than some depths (cascades: Engel 2006, Zhang et al. 2006), chosen so that over the picture texels are as
few pixels wide as they can be (Lauritzen et al. 2010 choose them by what is seen, too). Their rectangles and texels
lie on lattices that stay where they are, so that edges of shadows do not crawl when the camera moves. They are
for what a camera sees directly; all else looks at the map of the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...core.lod.seen import Sketch, seen_places, sketch_of_points, sketch_of_triangles
from ...core.scene.camera import Camera
from ...core.scene.scene import Geometry, Scene
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .map_views import MARGIN, LightViews, MapView, Nested, arranged_blocks
from .maps import ShadowMaps

MOST_LEVELS = 3
TEXELS = 1 << 22  # of a level of a light, seen from all its points
MOST_TEXELS = 1 << 24  # of all
CANDIDATES = 10  # depths up to which a level may show what is seen
GAIN = 0.35  # octaves by which a level has to narrow texels, on average over the picture, that exceed pixels
FINEST = 0.7  # pixels at the nearest place: texels are not narrower
LEAST = 2  # half octaves between texels of a level and those of the map of the scene
DEEPER = 0.2  # of the range of depths: so much is added to it


def with_nested(maps: ShadowMaps, scene: Scene, camera: Camera, store: Store, texture_size: int) -> ShadowMaps:
    """Returns the maps with nested ones for a camera, where texels of suns' maps are wider than its pixels.

    texture_size: along a side, of the device.
    """
    suns = [light for light in maps.lights if light is not None and light.kind == "PARALLEL"]
    if not suns:
        return maps
    places, pixel, cell = seen_places(camera, _sketches(scene, store))
    if len(places) == 0 or all(view.step <= pixel.min() for light in suns for view in light.views if view is not None):
        return maps
    texels = min(TEXELS, MOST_TEXELS // len(suns))
    found = [
        light if light is None or light.kind != "PARALLEL" else _with_levels(light, places, pixel, cell, texels)
        for light in maps.lights
    ]
    return _arranged(maps, found, texture_size)


def _sketches(scene: Scene, store: Store) -> list[tuple[Sketch, np.ndarray]]:
    instances, found = scene.instances, []
    for row, geometry in enumerate(scene.geometries):
        here = instances.world_from_object[instances.geometry == row]
        sketch = store.lookup(Key(Kind.SKETCH, geometry.key), lambda geometry=geometry: _sketch(geometry))
        if sketch is not None and len(here):
            found.append((sketch, here))
    return found


def _sketch(geometry: Geometry) -> Sketch | None:
    mesh, cloud = geometry.mesh, geometry.cloud
    if mesh is not None and len(mesh.triangles):
        return sketch_of_triangles(mesh.position, mesh.triangles)
    if cloud is not None and len(cloud):
        return sketch_of_points(cloud.position + cloud.origin)
    return None


def _arranged(maps: ShadowMaps, lights: Sequence[LightViews | None], texture_size: int) -> ShadowMaps:
    """Returns maps whose nested ones have places in the texture, above those of the scene; those of the scene alone
    where a texture does not hold them."""
    blocks = [view.block for light in lights if light is not None for view in _nested(light)]
    if not blocks:
        return maps
    corners, (width, height) = arranged_blocks(blocks, texture_size)
    below = maps.size[1]
    if max(width, below + height) > texture_size:
        return maps
    places = iter(corners)

    def placed(view: MapView) -> MapView:
        x, y = next(places)
        return replace(view, corner=(x, y + below))

    arranged = tuple(
        light if light is None or not _nested(light)
        else replace(light, views=(light.views[0], *(placed(view) for view in _nested(light))))
        for light in lights
    )  # fmt: skip
    look = tuple(
        tuple((*view.low.tolist(), view.step, *view.size, *view.corner, view.nested.lift) for view in _nested(light))
        for light in arranged if light is not None
    )  # fmt: skip
    key = Key(Kind.NESTED_MAPS, maps.key, other=look)
    return ShadowMaps(key, arranged, (max(width, maps.size[0]), below + height), maps.casters, maps)


def _nested(light: LightViews) -> list[MapView]:
    return [view for view in light.views if view is not None and view.nested is not None]


def _with_levels(light: LightViews, places: np.ndarray, pixel: np.ndarray, cell: float, texels: int) -> LightViews:
    """Returns a sun's views with nested ones, the widest first. places, pixel, cell: see seen_places."""
    outer = light.views[0]
    assert outer is not None
    local = (places - light.origin) @ light.axes.T
    nearest = np.argsort(pixel, kind="stable")
    local, pixel = local[nearest], pixel[nearest]
    ends = np.unique(np.linspace(0, len(pixel), CANDIDATES + 1)[1:].astype(int))
    ends = ends[ends > 0]
    levels = [_level(light, outer, local[:end], pixel[:end], cell, texels) for end in ends]
    fine = [(end, level) for end, level in zip(ends.tolist(), levels, strict=True) if level is not None]
    steps = np.full((len(fine), len(pixel)), outer.step)
    for row, (end, level) in zip(steps, fine, strict=True):
        row[:end] = level.step
    chosen: tuple[int, ...] = ()
    wide = _octaves(np.full(len(pixel), outer.step), pixel)
    for count in range(1, min(MOST_LEVELS, len(fine)) + 1):
        sets = list(combinations(range(len(fine)), count))
        cost = [_octaves(steps[list(rows)].min(axis=0), pixel) for rows in sets]
        best = int(np.argmin(cost))
        if wide - cost[best] < GAIN:
            break
        wide, chosen = cost[best], sets[best]
    return replace(light, views=(outer, *(fine[k][1] for k in reversed(chosen))))


def _octaves(step: np.ndarray, pixel: np.ndarray) -> float:
    """Returns by how many octaves texels (N,) are wider than pixels (N,), on average."""
    return float(np.maximum(np.log2(step / pixel), 0).mean())


def _level(
    light: LightViews, outer: MapView, local: np.ndarray, pixel: np.ndarray, cell: float, texels: int
) -> MapView | None:
    """Returns the view of places (N, 3) in a light's space where pixels are so wide, (N,); None where its texels are
    hardly narrower than those of the outer view."""
    around = (cell * pixel)[:, None]
    low, high = (local - around).min(axis=0), (local + around).max(axis=0)
    more = DEEPER * (high[2] - low[2])
    depths = float(max(low[2] - more, 0.0)), float(high[2] + more)
    lift = 0.0
    aside = np.zeros(2)
    views = 1
    if light.shape is not None and outer.across is not None and outer.points is not None:
        # A ray to a point c passes the height h at c (h - own), which is seen from c' at c' (lift - h) from there: at
        # most as far aside as another point is from c', over all heights, and c' over half of the range of own ones.
        lift, views = -sum(depths) / 2, len(outer.points)
        aside = light.shape.bounds(outer.across) * (depths[1] + (depths[1] - depths[0]) / 2)
    extent = high[:2] - low[:2] + 2 * aside
    needed = max(float((extent.prod() * views / texels) ** 0.5), FINEST * float(pixel[0]), outer.finest)
    finer = int(np.floor(2 * np.log2(outer.step / needed)))
    if finer < LEAST:
        return None
    step = outer.step * 2 ** (-finer / 2)
    first = np.floor((low[:2] - aside - outer.low) / step) - 2 * MARGIN
    size = np.ceil((high[:2] + aside - outer.low) / step) + 2 * MARGIN - first
    corner = outer.low + step * first
    inside = corner + aside + MARGIN * step, corner + step * size - aside - MARGIN * step
    return replace(
        outer, low=corner, step=step, size=(int(size[0]), int(size[1])), nested=Nested(*inside, depths, lift)
    )
