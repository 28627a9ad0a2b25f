"""Depth maps of lights: which lights and casters have them, and their records for a view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.numeric.linear import all_finite
from ...core.numeric.record import record
from ...core.scene.bounds import box_corners
from ...core.scene.lights import Light
from ...core.scene.scene import Geometry, Scene
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store
from ..prepare.separation import is_translucent
from .casting import CastingGeometry, cached_bounding_box, caster_keys, light_key
from .light_points import cell_points, grid_shifts, views_of_light
from .map_views import CastingBoxes, LightViews, MapView, angular_reach, light_views, placed

MOST_PRIMITIVES = 1 << 25  # of all instances of a geometry that maps draw: where there are more, nodes cast into tables
WIDEST_STRAND = 1 / 32  # of the radius of the ball around an instance, on average
WIDEST_TEXTURE = 8192  # texels
HEAD_TEXELS, VIEW_TEXELS = 4, 2  # of a light's record, and of each of its views
SHAPE_TEXELS = 9  # after them: of a light with a size
NESTED_TEXELS = 6  # of nested maps
KINDS = ("NONE", "PARALLEL", "SINGLE", "CUBE")


@record
class ShadowMaps:
    """The views of all depth maps of a scene, and what is drawn into them."""

    key: Key
    lights: tuple[LightViews | None, ...]  # in the order of the light table's rows; None: the light has no map
    size: tuple[int, int]  # of the texture that holds all
    casters: tuple[tuple[str, np.ndarray], ...]  # key of a geometry, (I, 4, 4) its casting instances
    of_scene: ShadowMaps | None = None  # whose texture this one's begins with; what follows are nested maps
    # (4,) float64: middle and radius, in the world, of a ball around strands that cast; None: there are none
    strands: np.ndarray | None = None

    @property
    def blocks(self) -> list[MapView]:
        """All that are drawn, those from all points of a light as one."""
        found = [view for light in self.lights if light is not None for view in light.views if view is not None]
        return [view for view in found if self.of_scene is None or view.nested is not None]

    @property
    def views(self) -> list[MapView]:
        """All that are drawn."""
        return [each for view in self.blocks for each in view.each]

    @property
    def nested(self) -> bool:
        """Whether some are nested in others."""
        return self.of_scene is not None

    @property
    def soft(self) -> bool:
        """Whether some light has a size."""
        return any(light is not None and light.shape is not None for light in self.lights)

    def records(self, view_from_world: np.ndarray) -> np.ndarray:
        """Returns ps_map_lights, float32 texels of four, for a view, (4, 4) float64, rigid: a row for each light.

        Texels 0 to 2 are rows that take view space to the light's, 3 holds the index of the kind. Two follow for each
        view: where the place (0, 0) lies in the texture, texels from a place to the next one, and the near plane; first
        and last texel. For lights with a size the kind is negative, beside it are how many points are seen from, and
        the row of their places; the views are those of the first point; and what follows them is, from SHAPE on: the
        half-axes in the light's space, with whether they face receivers, for each view both half-axes in its plane, and
        the ball around strands in the light's space.
        Behind all that, from NESTED on, two more for each nested map, whose view is the second, third or fourth: the
        places of receivers that look at it, from and to; their depths, and the height at which its views meet.

        More rows hold, for each outline and number of cells that some light has, of each cell its middle, by how many
        texels those of its view lie further on, and its points.
        """
        world_from_view = np.linalg.inv(view_from_world)
        shape = HEAD_TEXELS + 6 * VIEW_TEXELS
        outlines = sorted({_cells(light) for light in self.lights if light is not None and light.shape is not None})
        points = [_record_of_cells(*outline) for outline in outlines]
        nested = shape + SHAPE_TEXELS
        width = nested + (NESTED_TEXELS if self.nested else 0)
        found = np.zeros((len(self.lights) + len(points), max([width, *map(len, points)]), 4))
        for row, places in zip(found[len(self.lights) :], points, strict=True):
            row[: len(places)] = places
        for row, light in zip(found, self.lights, strict=False):
            if light is None:
                continue
            row[:3, :3] = light.axes @ world_from_view[:3, :3]
            row[:3, 3] = light.axes @ (world_from_view[:3, 3] - light.origin)
            row[3, 0] = KINDS.index(light.kind)
            if light.shape is not None:
                cells = _cells(light)
                row[3] = -row[3, 0], cells[0], len(self.lights) + outlines.index(cells), 0
                row[shape : shape + 2, :3] = light.shape.axes @ light.axes.T
                row[shape : shape + 2, 3] = light.shape.facing
                if self.strands is not None:
                    row[shape + 8] = *(light.axes @ (self.strands[:3] - light.origin)), self.strands[3]
            for i, view in enumerate(light.views):
                texels = row[HEAD_TEXELS + VIEW_TEXELS * i :]
                if view is None:
                    texels[1] = 0, 0, -1, -1
                    continue
                texels[0, :2] = np.array(view.corner) - view.low / view.step
                texels[0, 2:] = 1 / view.step, view.near
                texels[1] = *view.corner, *(np.array(view.corner) + view.size - 1)
                if view.across is not None:
                    row[shape + 2 + i] = view.across.T.ravel()
                if view.nested is not None:
                    row[nested + 2 * i - 2] = *view.nested.low, *view.nested.high
                    row[nested + 2 * i - 1, :3] = *view.nested.depths, view.nested.lift
        return found.astype(np.float32)


def _cells(light: LightViews) -> tuple[int, bool]:
    """Returns into how many cells the outline of a light with a size is divided, and whether it is a rectangle."""
    assert light.shape is not None
    counts = [len(view.points) for view in light.views if view is not None and view.points is not None]
    return max(counts, default=0), light.shape.rectangle


def _record_of_cells(count: int, rectangle: bool) -> np.ndarray:
    """Returns the texels of a divided outline, (N, 4), see `ShadowMaps.records`."""
    if count == 0:
        return np.zeros((0, 4))
    middle, places = cell_points(count, rectangle)
    row = np.zeros((count, 1 + places.shape[1], 4))
    row[:, 0, :2], row[:, 1:, :2], row[:, 0, 2:] = middle, places, grid_shifts(count)
    return row.reshape(-1, 4)


def takes_map(light: Light) -> bool:
    """Tells whether a light casts shadows by depth maps: where it has a place."""
    return (
        light.shadow
        and bool(np.isfinite(light.position).all() and np.isfinite(light.direction).all())
        and np.isfinite(light.radius)
    )


def casts_into_map(scene: Scene, caster: CastingGeometry) -> bool:
    """Tells whether maps show a caster: a mesh or a cloud that no light passes through."""
    geometry = caster.geometry
    primitives = 0 if geometry.strands is not None else _primitives(geometry)
    if primitives == 0 or is_translucent(geometry, scene.materials):
        return False
    return primitives * len(caster.matrices) <= MOST_PRIMITIVES and bool(
        all_finite(caster.matrices.astype(np.float32)).all()
    )


def casts_as_strands(caster: CastingGeometry) -> bool:
    """Tells whether maps show a caster: strands, but for those as wide as ropes, which tables
    show as well in less time."""
    strands = caster.geometry.strands
    if strands is None or not len(strands.radius):
        return False
    reach = float((caster.radius / np.maximum(caster.scale, 1e-30)).max(initial=0.0))  # in object space, as radii are
    if float(strands.radius.mean(dtype=np.float64)) > WIDEST_STRAND * reach:
        return False
    primitives = _primitives(caster.geometry)
    return 0 < primitives * len(caster.matrices) <= MOST_PRIMITIVES and bool(
        all_finite(caster.matrices.astype(np.float32)).all()
    )


def _primitives(geometry: Geometry) -> int:
    if geometry.strands is not None:
        return len(geometry.strands.position)
    if geometry.mesh is not None:
        return len(geometry.mesh.triangles)
    return len(geometry.cloud) if geometry.cloud is not None and geometry.cloud.radii is not None else 0


def make_maps(
    scene: Scene,
    lights: Sequence[Light],
    casters: Sequence[CastingGeometry],
    resolution: int,
    store: Store,
    texture_size: int,
) -> ShadowMaps | None:
    """Returns the maps of `lights`, those that take one, of casters that cast into maps; None where there are none."""
    chosen = [light if takes_map(light) else None for light in lights]
    if not casters or not any(chosen):
        return None
    look = tuple(caster_keys(scene, casters))
    keys = tuple(None if light is None else light_key(light) for light in chosen)
    key = Key(Kind.SHADOW_MAPS, hashed((look, keys)), other=(resolution, texture_size))

    def make() -> ShadowMaps:
        boxes = casting_boxes(casters, store)
        points = _light_points(chosen, casters, boxes)
        views = [
            None if light is None else light_views(light, boxes, resolution, count)
            for light, count in zip(chosen, points, strict=True)
        ]
        splats = sum(len(c.geometry.cloud) * len(c.matrices) for c in casters if c.geometry.cloud is not None)
        arranged, size = placed(views, min(texture_size, WIDEST_TEXTURE), splats)
        shown = tuple((c.geometry.key, c.matrices) for c in casters)
        return ShadowMaps(key, tuple(arranged), size, shown, strands=ball_around_strands(casters, store))

    found = store.lookup(key, make)
    return found if found.views else None  # where all that casts lies where no light looks


def _light_points(lights: Sequence[Light | None], casters: Sequence[CastingGeometry], boxes: CastingBoxes) -> list[int]:
    """Returns for each light from how many of its points, if it has a size, what casts is seen."""
    primitives = sum(_primitives(caster.geometry) * len(caster.matrices) for caster in casters)
    spreads = [None if light is None else angular_reach(light, boxes) for light in lights]
    drawn = primitives * sum(spread is not None for spread in spreads)
    return [0 if spread is None else views_of_light(spread, drawn) for spread in spreads]


def ball_around_strands(casters: Sequence[CastingGeometry], store: Store) -> np.ndarray | None:
    """Returns middle and radius, (4,) float64, of a ball around all strands, in the world; None if there are none."""
    fibres = [caster for caster in casters if caster.geometry.strands is not None]
    if not fibres:
        return None
    corners = casting_boxes(fibres, store).corners.reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return np.append(middle, np.linalg.norm(corners - middle, axis=1).max())


def casting_boxes(casters: Sequence[CastingGeometry], store: Store) -> CastingBoxes:
    """Returns the boxes around all instances of casters, in the world, and how small their splats are."""
    matrices = np.concatenate([caster.matrices for caster in casters])
    boxes = np.array([cached_bounding_box(caster.geometry, store) for caster in casters])  # (C, 2, 3)
    corners = np.repeat(box_corners(boxes[:, 0], boxes[:, 1]), [len(c.matrices) for c in casters], axis=0)
    radius = []
    for caster in casters:
        cloud = caster.geometry.cloud
        typical = np.inf
        if cloud is not None and cloud.radii is not None:
            typical = float(np.median(cloud.radii[:: max(1, len(cloud) // 4096), 0]))
        radius.append(typical * caster.scale if np.isfinite(typical) else np.full(len(caster.scale), np.inf))
    moved = np.einsum("iab,icb->ica", matrices[:, :3, :3], corners) + matrices[:, None, :3, 3]
    return CastingBoxes(moved, np.concatenate(radius))
