"""Panes: meshes that light passes through, in layers of depth maps seen from lights.

Each layer holds for every texel the nearest pane behind that of the layer before, by depth peeling (Everitt 2001), and
the share of light that it and all panes before it let through, of each channel where some are coloured: as sharp as the
shadows of what is opaque, and without samples. Where more panes lie behind each other than there are layers, tables
hold what casts. Lights with a size look at faces instead (pane_faces.py), of what lets through the same everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.numeric import segments
from ...core.numeric.linear import all_finite
from ...core.numeric.record import record
from ...core.scene.lights import Light
from ...core.scene.materials import MaterialTable
from ...core.scene.scene import Scene
from ...core.surface.appearance import graphs_of
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store
from ..prepare.separation import is_translucent
from .casting import CastingGeometry, caster_keys, light_key
from .light_points import light_shape
from .map_views import LightViews, MapView, light_views, placed
from .maps import ShadowMaps, casting_boxes, takes_map

MOST_LAYERS = 8
MOST_TRIANGLES = 1 << 14  # of all panes
MOST_TEXELS = 1 << 24  # of all layers together, each of which holds depths and shares: 64 MiB
CHANNELS = 1, 3  # of shares: where all panes are grey, and else
PLACES = 64  # along the longer side of a view, at which panes behind each other are counted
MOST_TESTED = 1 << 22  # places in the boxes around all triangles: if there are more, so are layers


@record
class PaneMaps:
    """The views of all maps of panes, how many layers each has, and what is drawn into them."""

    maps: ShadowMaps
    layers: int
    channels: int  # of shares, one of CHANNELS

    @property
    def key(self) -> Key:
        return self.maps.key

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the texture of all layers: of each its depths, then the shares of each channel."""
        return self.maps.size[0], self.layers * self.layer_height

    @property
    def layer_height(self) -> int:
        """Texels from one layer to the next."""
        return (1 + self.channels) * self.maps.size[1]

    def records(self, view_from_world: np.ndarray) -> np.ndarray:
        """Returns ps_pane_lights, float32 texels of four, for a view, (4, 4) float64, rigid: a row for each light.

        Rows are those of ShadowMaps.records; texel 3 also holds the number of layers, and how many texels it is from
        one to the next, and from depths to shares and from channel to channel.
        """
        found = self.maps.records(view_from_world)
        found[:, 3, 1:] = self.layers, self.layer_height, self.maps.size[1]
        return found


def casts_as_pane(scene: Scene, caster: CastingGeometry, varying: bool = False) -> bool:
    """Tells whether maps of panes may show a caster: a mesh of materials that each let the same light through
    everywhere, or `varying` shares of it."""
    geometry, mesh = caster.geometry, caster.geometry.mesh
    if mesh is None or not is_translucent(geometry, scene.materials):
        return False
    graphs = graphs_of(mesh, scene.materials)
    constant = not any(graph.channels.keys() & {"alpha", "transmission_color"} for graph in graphs.values())
    few = len(mesh.triangles) * len(caster.matrices) <= MOST_TRIANGLES
    return (constant or varying) and few and bool(all_finite(caster.matrices.astype(np.float32)).all())


def pane_shares(materials: MaterialTable) -> np.ndarray:
    """Returns the share of light that a pane of each material lets through, (M, 1) float32, or (M, 3) where some is
    coloured."""
    clear = 1 - materials.alpha[:, None]
    return clear if materials.transmission_color is None else clear * materials.transmission_color


def takes_panes(light: Light) -> bool:
    """Tells whether a light's panes cast by maps: where it has a place, and no size."""
    return takes_map(light) and light_shape(light) is None


def make_panes(
    scene: Scene,
    lights: Sequence[Light],
    casters: Sequence[CastingGeometry],
    resolution: int,
    store: Store,
    texture_size: int,
) -> PaneMaps | None:
    """Returns the maps of `lights`, those that take panes, of casters that are panes; None where there are none, or too
    many of them behind each other."""
    chosen = [light if takes_panes(light) else None for light in lights]
    triangles = sum(len(c.geometry.mesh.triangles) * len(c.matrices) for c in casters if c.geometry.mesh is not None)
    if not 0 < triangles <= MOST_TRIANGLES or not any(chosen):
        return None
    look = tuple(caster_keys(scene, casters))
    keys = tuple(None if light is None else light_key(light) for light in chosen)
    channels = pane_shares(scene.materials).shape[1]
    textures = 1 + channels
    key = Key(Kind.PANE_MAPS, hashed((look, keys)), other=(resolution, texture_size, channels))
    boxes = casting_boxes(casters, store)

    def make() -> PaneMaps | None:
        views = [None if light is None else light_views(light, boxes, resolution) for light in chosen]
        layers = _layers(views, np.concatenate([_corners_in_world(caster) for caster in casters]))
        if not 0 < layers <= MOST_LAYERS:
            return None
        arranged, size = placed(views, texture_size // (textures * layers), most=MOST_TEXELS // (textures * layers))
        if textures * layers * size[1] > texture_size:
            return None
        cast = tuple((c.geometry.key, c.matrices) for c in casters)
        return PaneMaps(ShadowMaps(key, tuple(arranged), size, cast), layers, channels)

    return store.lookup(key, make)


def _corners_in_world(caster: CastingGeometry) -> np.ndarray:
    """Returns (T, 3, 3) float64, the corners of the triangles of all instances."""
    mesh = caster.geometry.mesh
    assert mesh is not None
    corners = mesh.position[mesh.triangles].astype(np.float64)
    moved = np.einsum("iab,tkb->itka", caster.matrices[:, :3, :3], corners) + caster.matrices[:, None, None, :3, 3]
    return moved.reshape(-1, 3, 3)


def _layers(lights: Sequence[LightViews | None], corners: np.ndarray) -> int:
    """Returns how many triangles (T, 3, 3) at most lie behind each other in the views of lights."""
    views = [view for light in lights if light is not None for view in light.views if view is not None]
    return max((_behind_each_other(view, corners) for view in views), default=0)


def _behind_each_other(view: MapView, corners: np.ndarray) -> int:
    """Returns how many triangles (T, 3, 3) at most lie behind each other at evenly spread places of a view; one more
    than MOST_LAYERS, if they are too many to be counted."""
    local = (corners - view.origin) @ view.axes.T
    local = local[(local[..., 2] > view.near).all(axis=1)]
    place = local[..., :2] if view.parallel else local[..., :2] / local[..., 2:]
    size = np.array(view.size)
    step = view.step * size.max() / PLACES
    count = np.ceil(size * view.step / step).astype(int)
    place = (place - view.low) / step - 0.5
    low = np.clip(np.ceil(place.min(axis=1)), 0, count).astype(int)
    sides = np.maximum(np.clip(np.floor(place.max(axis=1)) + 1, 0, count).astype(int) - low, 0)
    tested = sides.prod(axis=1)
    if tested.sum() > MOST_TESTED:
        return MOST_LAYERS + 1
    triangle = segments.owners(tested)
    row, column = np.divmod(segments.ranks(tested), sides[triangle, 0])
    here = low[triangle] + np.stack([column, row], axis=1)
    edge, offset = np.roll(place, -1, axis=1) - place, here[:, None] - place[triangle]
    side = edge[triangle, :, 0] * offset[..., 1] - edge[triangle, :, 1] * offset[..., 0]
    inside = (side > 0).all(axis=1) | (side < 0).all(axis=1)
    return int(np.bincount(here[inside] @ [1, count[0]], minlength=1).max())
