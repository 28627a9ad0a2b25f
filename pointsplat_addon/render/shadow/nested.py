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

from ...core.numeric.record import record
from ...core.scene.camera import Camera
from ...core.scene.scene import Geometry, Scene
from ...core.surface.seen import Sketch, narrowest_pixel, seen_places, sketch_of_points, sketches_of_meshes
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .map_views import MARGIN, LightViews, MapView, Nested, arranged_blocks
from .maps import WIDEST_TEXTURE, ShadowMaps

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
    widest_step = max(view.step for light in suns for view in light.views if view is not None)
    sketches = _sketches(scene, store)
    if widest_step <= narrowest_pixel(camera, sketches):
        return maps
    places, pixel, cell = seen_places(camera, sketches)
    if len(places) == 0 or widest_step <= pixel.min():
        return maps
    texels, widest = min(TEXELS, MOST_TEXELS // len(suns)), min(WIDEST_TEXTURE, texture_size)
    found = [
        light if light is None or light.kind != "PARALLEL"
        else _with_levels(light, _Seen(places, pixel, cell), texels, widest)
        for light in maps.lights
    ]  # fmt: skip
    return _arranged(maps, found, widest, texture_size)


@record
class _Seen:
    """What seen_places finds."""

    places: np.ndarray  # (N, 3) float64: in the world, or in a light's space
    pixel: np.ndarray  # (N,) world units
    cell: float  # pixels

    def take(self, which: np.ndarray | slice) -> _Seen:
        return _Seen(self.places[which], self.pixel[which], self.cell)

    def octaves(self, step: np.ndarray | float) -> float:
        """Returns by how many octaves texels, (N,) or all of one width, are wider than pixels, on average."""
        return float(np.maximum(np.log2(step / self.pixel), 0).mean()) if len(self.pixel) else 0.0


def _sketches(scene: Scene, store: Store) -> list[tuple[Sketch, np.ndarray]]:
    geometries, instances = scene.geometries, scene.instances
    keys = [Key(Kind.SKETCH, geometry.key) for geometry in geometries]
    sketches = store.lookup_all(keys, lambda rows: _made([geometries[row] for row in rows]))
    of_each = instances.of_each(len(geometries))
    return [
        (sketch, instances.world_from_object[where])
        for sketch, where in zip(sketches, of_each, strict=True)
        if sketch is not None and len(where)
    ]


def _made(geometries: list[Geometry]) -> list[Sketch | None]:
    meshes = [one.mesh for one in geometries if one.mesh is not None and len(one.mesh.triangles)]
    of_meshes = iter(sketches_of_meshes(meshes))

    def sketch(geometry: Geometry) -> Sketch | None:
        if geometry.mesh is not None and len(geometry.mesh.triangles):
            return next(of_meshes)
        cloud = geometry.cloud
        return None if cloud is None or not len(cloud) else sketch_of_points(cloud.position + cloud.origin)

    return [sketch(geometry) for geometry in geometries]


def _arranged(maps: ShadowMaps, lights: Sequence[LightViews | None], widest: int, texture_size: int) -> ShadowMaps:
    """Returns maps whose nested ones have places in the texture, above those of the scene; those of the scene alone
    where a texture does not hold them."""
    blocks = [view.block for light in lights if light is not None for view in _nested(light)]
    if not blocks:
        return maps
    corners, (width, height) = arranged_blocks(blocks, widest)
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
    views = [view for light in arranged if light is not None for view in _nested(light)]
    look = tuple(
        (*view.low.tolist(), view.step, *view.size, *view.corner, view.nested and view.nested.depths) for view in views
    )
    key = Key(Kind.NESTED_MAPS, maps.key, other=look)
    return ShadowMaps(key, arranged, (max(width, maps.size[0]), below + height), maps.casters, maps, maps.strands)


def _nested(light: LightViews) -> list[MapView]:
    return [view for view in light.views if view is not None and view.nested is not None]


def _with_levels(light: LightViews, seen: _Seen, texels: int, widest: int) -> LightViews:
    """Returns a sun's views with nested ones, the outermost first. widest: texels along a side of a texture."""
    outer = light.views[0]
    assert outer is not None
    local = (seen.places - light.origin) @ light.axes.T
    shaded = ((local[:, :2] > outer.low) & (local[:, :2] < outer.low + outer.step * np.array(outer.size))).all(axis=1)
    seen = _Seen(local, seen.pixel, seen.cell).take(np.flatnonzero(shaded))
    seen = seen.take(np.argsort(seen.pixel, kind="stable"))
    ends = np.unique(np.linspace(0, len(seen.pixel), CANDIDATES + 1).astype(int))[1:].tolist()
    found = [(end, _level(light, outer, seen.take(slice(end)), texels, widest)) for end in ends]
    fine = [(end, level) for end, level in found if level is not None]
    steps = np.full((len(fine), len(seen.pixel)), outer.step)
    for row, (end, level) in zip(steps, fine, strict=True):
        row[:end] = level.step
    chosen: tuple[int, ...] = ()
    wide = seen.octaves(outer.step)
    for count in range(1, min(MOST_LEVELS, len(fine)) + 1):
        sets = list(combinations(range(len(fine)), count))
        octaves = [seen.octaves(steps[list(rows)].min(axis=0)) for rows in sets]
        best = int(np.argmin(octaves))
        if wide - octaves[best] < GAIN:
            break
        wide, chosen = octaves[best], sets[best]
    return replace(light, views=(outer, *(fine[k][1] for k in reversed(chosen))))


def _level(light: LightViews, outer: MapView, seen: _Seen, texels: int, widest: int) -> MapView | None:
    """Returns the view of places in a light's space, those with the narrowest pixels first; None where its texels are
    hardly narrower than those of the outer view."""
    around = (seen.cell * seen.pixel)[:, None]
    low, high = (seen.places - around).min(axis=0), (seen.places + around).max(axis=0)
    more = DEEPER * (high[2] - low[2])
    depths = float(max(low[2] - more, 0.0)), float(high[2] + more)
    lift = 0.0
    aside = np.zeros(2)
    if light.shape is not None and outer.across is not None:
        # A ray to a point c passes the height h at c (h - own), which is seen from c' at c' (lift - h) from there: at
        # most as far aside as another point is from c', over all heights, and c' over half of the range of own ones.
        lift = -sum(depths) / 2
        aside = light.shape.bounds(outer.across) * (depths[1] + (depths[1] - depths[0]) / 2)
    extent = high[:2] - low[:2] + 2 * aside
    columns, rows = outer.tiles
    needed = max(
        float(np.sqrt(extent.prod() * columns * rows / texels)),
        float((extent / (widest / np.array([columns, rows]) - 6 * MARGIN)).max()),
        FINEST * float(seen.pixel[0]),
        outer.finest,
    )
    if not needed * 2 ** (LEAST / 2) <= outer.step:
        return None
    step = outer.step * 2 ** (-np.floor(2 * np.log2(outer.step / needed)) / 2)
    first = np.floor((low[:2] - aside - outer.low) / step) - 2 * MARGIN
    size = np.ceil((high[:2] + aside - outer.low) / step) + 2 * MARGIN - first
    corner = outer.low + step * first
    inside = corner + aside + MARGIN * step, corner + step * size - aside - MARGIN * step
    return replace(
        outer, low=corner, step=step, size=(int(size[0]), int(size[1])), nested=Nested(*inside, depths, lift)
    )
