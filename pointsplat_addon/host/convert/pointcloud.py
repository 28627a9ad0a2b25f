"""Points of a PointCloud object, of a particle system, or of a mesh without edges and faces, as a point cloud of core.

Points without normals are balls. Translucent ones become Gaussians whose extinction is the object's own, or that of the
medium of a material with a volume and no surface, or such that a ray through the centre of a ball meets its alpha.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import field, replace
from typing import Any

import bpy
import numpy as np

from ...core.material.evaluation import Appearance, evaluate_materials
from ...core.material.expression import Part, SampleInputs
from ...core.material.graph import MaterialGraph, Needs, needs
from ...core.material.nodes.procedural.hashes import point_numbers
from ...core.material.object_values import POINT_RADIUS, POINT_RANDOM
from ...core.numeric.record import record
from ...core.numeric.vectors import column_ranges, each_block, moved_rows, put_rows, take_rows
from ...core.scene.cloud import PointCloud, coherent_places
from ...core.scene.volume import Medium, Volume
from ...core.splat.kernel import PROFILES
from ...core.surface.appearance import CLIP, ball_extinction, hidden_and_shaded
from ...core.surface.nearest import median_spacing
from ...core.surface.neighbourhoods.estimate import Ellipses
from ...core.volume.optics import voxel_optics
from ...render.cache.on_disk import form_of_records
from ..shared_store import STORE
from . import arrays
from .arrays import COLOR_TYPES, attribute_as_color, unit_or_up
from .point_shapes import AS_GIVEN, PointShape, elements, radius_of, station_of
from .sample_material import SampleMaterial, generated_coordinates, surface_constants

ELLIPSES_FORM = form_of_records(Ellipses)
DEFAULT_RADIUS = 0.01  # Blender's, for points without a radius attribute
COLOR_NAMES = ("Color", "Col")  # names that importers give to colours
VELOCITY = "velocity"  # object units a second, as Cycles and Blender's simulations have it
OPACITY_NAMES = ("opacity", "alpha")
CAPTURED_ATTRIBUTE = "f_dc_0"  # an attribute of captured splats, whose opacities are logits
READABLE_TYPES = {"FLOAT": 1, "FLOAT2": 2, "FLOAT_VECTOR": 3}  # to numbers of a value
Lookup = Callable[[str, Callable[[], Any]], Any]  # the object of a key, made only if it is not known
Data = bpy.types.PointCloud | bpy.types.Mesh


@record
class Points:
    """Arrays of N points as Blender has them, in object units; they may be its own: see `arrays.view`."""

    position: np.ndarray  # (N, 3) float32
    radius: np.ndarray | None = None  # (N,) float32; None: half the median distance to the nearest neighbour
    normal: np.ndarray | None = None  # (N, 3) float32
    station: np.ndarray | None = None  # (N,) int32
    opacity: np.ndarray | None = None  # (N,) float32
    velocity: np.ndarray | None = None  # (N, 3) float32, object units a frame
    kernel: np.ndarray | None = None  # (N,) uint8, rows of core.splat.kernel.PROFILES
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # by name, (N, 4) as stored
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # by name, (N, 2) float32
    grids: dict[str, np.ndarray] = field(default_factory=dict)  # by name, what a medium reads, (N,) or (N, 3) float32

    def take(self, rows: np.ndarray | None) -> Points:
        """The points of some rows (K,) int, None: all."""
        if rows is None:
            return self
        own = self.radius, self.normal, self.station, self.opacity, self.velocity, self.kernel
        taken = [None if array is None else take_rows(array, rows) for array in own]
        groups = self.colors, self.uv, self.grids
        colors, uv, grids = ({name: take_rows(array, rows) for name, array in group.items()} for group in groups)
        return Points(take_rows(self.position, rows), *taken, colors=colors, uv=uv, grids=grids)

    def part(self, rows: slice) -> Points:
        """Some of the points, without what materials do not read."""
        normal = None if self.normal is None else self.normal[rows]
        colors, uv = ({name: array[rows] for name, array in group.items()} for group in (self.colors, self.uv))
        return Points(self.position[rows], None, normal, colors=colors, uv=uv)

    @property
    def key(self) -> str:
        """Content key of all arrays."""
        named = [part for group in (self.colors, self.uv, self.grids) for item in group.items() for part in item]
        own = self.position, self.radius, self.normal, self.station, self.opacity, self.velocity, self.kernel
        return arrays.digest("pointcloud", *own, *named)


def read_pointcloud(
    data: Data,
    material: SampleMaterial,
    lookup: Lookup,
    shape: PointShape = AS_GIVEN,
    rows: np.ndarray | None = None,
    motion: float = 0.0,
) -> tuple[str, PointCloud] | None:
    """(content key, cloud) of a point cloud, or of the vertices of a mesh, in object space; None if it is empty.

    rows: the points that are wanted, (K,) int; None: all. motion: seconds of a frame, where velocities are wanted.

    Where the shape has no radius, it is the points' attribute. Without such an attribute, points of a point cloud have
    Blender's default radius, and vertices half the median distance to their nearest neighbours.
    """
    count = len(data.vertices if isinstance(data, bpy.types.Mesh) else data.points)
    if "position" not in data.attributes or 0 in (count, count if rows is None else len(rows)):
        return None
    wanted, imported = needs(material.graph) if material.graph else Needs(), material.row == 0
    position = arrays.values(data.attributes["position"], 3, np.float32)
    chosen = position if rows is None or shape.unit != "SPACING" else take_rows(position, rows)
    radius = 0.0 if shape.kind == "SURFACE" else radius_of(shape, chosen)
    radii = np.full(count, radius, np.float32) if radius > 0 else _read(data, "radius", "FLOAT")
    if radii is None and isinstance(data, bpy.types.PointCloud):
        radii = np.full(count, DEFAULT_RADIUS, np.float32)
    points = Points(
        position,
        radii,
        None if shape.kind == "BALLS" else _read(data, "normal", "FLOAT_VECTOR"),
        station_of(data) if shape.stations else None,
        _opacity(data) if imported else None,
        _velocity(data, motion) if motion > 0 else None,
        _kernel(data),
        {a.name: attribute_as_color(a) for a in _color_attributes(data, wanted, imported)}
        | _point_info(wanted, count, radii),
        _present((name, _read(data, name, "FLOAT2")) for name in wanted.uv if name is not None),
        _present((name, _grid(data, name)) for name in _grid_names(material.medium)),
    )
    return convert_points(points.take(rows), material, lookup, shape)


def convert_points(
    points: Points, material: SampleMaterial, lookup: Lookup, shape: PointShape = AS_GIVEN
) -> tuple[str, PointCloud]:
    """(content key, cloud) of points with their material; the cloud is made only if `lookup` does not know the key."""
    key = f"{points.key} {arrays.digest(material.key, shape)}"
    return key, lookup(key, lambda: _make_cloud(points, material, shape, lookup))


def _make_cloud(points: Points, material: SampleMaterial, shape: PointShape, lookup: Lookup) -> PointCloud:
    """The cloud of points, in spatially coherent order."""
    count, places = len(points.position), coherent_places(points.position)
    radius, axis = points.radius, None
    if radius is None:
        radius = np.full(count, 0.5 * median_spacing(points.position) or DEFAULT_RADIUS, np.float32)
    # What is a medium has no surface.
    shaped = shape.estimates and not material.extinction > 0 and material.medium is None
    if shaped:

        def kept(key: str, make: Callable[[], Any]) -> Any:
            return lookup(key, lambda: STORE.on_disk.lookup(key, make, ELLIPSES_FORM))

        found = elements(shape, points.position, radius, points.normal, points.station, kept)
        axis, radius = found.axis, found.radii
        points = replace(points, position=found.position, normal=found.normal)
    fields = _evaluated(points, material, places, shaped)
    radii = _in_order(radius, places)
    cloud = PointCloud(
        position=fields["position"],
        normal=fields.get("normal"),
        axis=None if axis is None else _in_order(axis, places),
        radii=radii[:, None] if radii.ndim == 1 else radii,
        color=fields.get("color"),
        surface=fields.get("surface"),
        emission=fields.get("emission"),
        material=np.full(count, material.row, np.uint16) if material.row else None,
        velocity=None if points.velocity is None else _in_order(points.velocity, places),
        kernel=None if points.kernel is None else _in_order(points.kernel, places),
    )
    if material.extinction > 0 or material.medium is not None:
        return _with_medium(cloud, {name: _in_order(grid, places) for name, grid in points.grids.items()}, material)
    alpha = fields.get("alpha")
    if alpha is None and (points.opacity is not None or material.alpha < 1):
        alpha = np.full(count, material.alpha, np.float32)
    if alpha is None:
        return cloud
    color, shaded = fields.get("transmission_color"), None
    if color is None and min(material.transmission_color) < 1:
        color = np.full((count, 3), material.transmission_color, np.float32)
    if color is not None:
        alpha, shaded = hidden_and_shaded(alpha, color)
    if points.opacity is not None:
        alpha = (alpha.T * _in_order(points.opacity, places)).T
    return _with_alpha(replace(cloud, shaded=shaded), alpha, material)


def _in_order(array: np.ndarray, places: np.ndarray | None) -> np.ndarray:
    """An array (N, ...) with its items at places (N,), None: where they are; not in Blender's memory."""
    if places is not None:
        return moved_rows(array, places)
    return array if array.flags.owndata else array.copy()


def appearance_of(points: Points, material: SampleMaterial) -> dict[str, np.ndarray]:
    """Positions, and what of the material varies at the points, in their order: arrays (N, ...) float32 by the names of
    PointCloud's attributes, and alpha. Points without a normal have none."""
    return _evaluated(points, material, None, points.normal is not None)


def _evaluated(
    points: Points, material: SampleMaterial, places: np.ndarray | None, shaped: bool
) -> dict[str, np.ndarray]:
    """Positions, unit normals and what of the material varies at the points, at places (N,): arrays (N, ...) by name.

    `shaped`: points whose normal is zero are balls; else they look upwards.

    Block by block: what is in between stays in the processor's cache, and Blender's arrays are copied once.
    """
    count = len(points.position)
    box = None
    if material.graph is not None and needs(material.graph).generated:
        box = list(column_ranges(points.position))

    def look_at(rows: slice) -> dict[str, np.ndarray]:
        part = points.part(rows)
        look = _appearance(part, material, box)
        facing = part.normal if look.normal is None else look.normal
        normal = None if facing is None else unit_or_up(facing)
        if shaped and normal is not None and part.normal is not None:
            normal[~part.normal.any(axis=1)] = 0  # balls among disks
        named = {"position": part.position, "normal": normal, "color": look.color, "surface": look.surface,
                 "emission": look.emission, "alpha": look.alpha,
                 "transmission_color": look.transmission_color}  # fmt: skip
        return {name: array for name, array in named.items() if array is not None}

    found = {name: np.empty((count, *a.shape[1:]), a.dtype) for name, a in look_at(slice(0, 1)).items()}

    def fill(block: slice) -> None:
        for name, array in look_at(block).items():
            if places is None:
                found[name][block] = array
            else:
                put_rows(found[name], places[block], array)

    each_block(count, fill)
    return found


def _appearance(points: Points, material: SampleMaterial, box: list[np.ndarray] | None) -> Appearance:
    """The appearance of points. box: low and high corner, (3,) each, of all points, where generated coordinates are
    read."""
    linear = {name: arrays.scene_linear(array) for name, array in points.colors.items()}
    if material.graph is not None:
        return _evaluate_graph(points, linear, material.graph, material, box)
    if linear and material.row == 0:
        color = next(iter(linear.values()))
        return Appearance(np.ascontiguousarray(color[:, :3], np.float32), alpha=np.clip(color[:, 3], 0, 1))
    return Appearance()


def _with_medium(cloud: PointCloud, grids: dict[str, np.ndarray], material: SampleMaterial) -> PointCloud:
    """The cloud as Gaussians of the object's own extinction or of the material's medium, which reads the grids."""
    if material.medium is None:
        return _gaussians(cloud, np.full(len(cloud), material.extinction, np.float32), material)
    medium = material.medium
    if medium.density_grid not in grids:
        medium = replace(medium, density_grid="")
    # Points are treated as voxels without indices: their optics do not depend on where they are.
    voxels = Volume("", "", np.empty((len(cloud), 0), np.int32), np.eye(4), grids)
    found, _ = voxel_optics(voxels, medium, material.extinction)
    return replace(cloud, normal=None, color=found.albedo, emission=found.emission, extinction=found.extinction)


def _gaussians(cloud: PointCloud, extinction: np.ndarray, material: SampleMaterial) -> PointCloud:
    """The cloud as Gaussians of this extinction (N,) or (N, 3); a very deep one emits the radiance of the material's
    surface."""
    radiance = cloud.emission
    if radiance is None and any(material.emission):
        radiance = np.array([material.emission], np.float32)
    emission = None if radiance is None else radiance * extinction.reshape(len(cloud), -1)
    return replace(cloud, normal=None, extinction=extinction, emission=emission)


def _with_alpha(cloud: PointCloud, alpha: np.ndarray, material: SampleMaterial) -> PointCloud:
    """The cloud without invisible points; translucent ones get an opacity if they have normals, else an extinction.

    alpha: (N,), or of each channel, (N, 3). Materials that are not translucent are cut out where it is below CLIP.
    """
    if material.graph is not None and not material.translucent:
        return cloud if (alpha >= CLIP).all() else cloud.take(alpha >= CLIP)
    if not (alpha < 1).any():
        return cloud
    if cloud.normal is not None:
        cloud = replace(cloud, opacity=alpha.astype(np.float32))
    else:
        assert cloud.radii is not None
        cloud = _gaussians(cloud, ball_extinction(alpha, cloud.radii[:, 0]), material)
    return cloud.take(alpha > 0 if alpha.ndim == 1 else (alpha > 0).any(axis=1))


# Attributes


def _read(data: Data, name: str, kind: str) -> np.ndarray | None:
    """A point attribute (N,) or (N, 2 | 3) float32; None if there is none of that name and type."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type != kind or attribute.domain != "POINT":
        return None
    return arrays.values(attribute, READABLE_TYPES[kind], np.float32)


def _opacity(data: Data) -> np.ndarray | None:
    """Opacities (N,) in [0, 1], NaN being opaque; None without such an attribute and for captured splats."""
    if CAPTURED_ATTRIBUTE in data.attributes:
        return None
    found = next((a for name in OPACITY_NAMES if (a := _read(data, name, "FLOAT")) is not None), None)
    return None if found is None else np.clip(np.nan_to_num(found, nan=1.0), 0, 1)


def _velocity(data: Data, motion: float) -> np.ndarray | None:
    """How far points move in `motion` seconds, (N, 3) in object units; None where they have no velocity."""
    found = _read(data, VELOCITY, "FLOAT_VECTOR")
    return None if found is None else found * np.float32(motion)


def _kernel(data: Data) -> np.ndarray | None:
    """Rows (N,) uint8 of kernel profiles, from an attribute of integers; invalid ones are 0. None without attribute."""
    attribute = data.attributes.get("kernel")
    if attribute is None or attribute.data_type != "INT":
        return None
    row = arrays.values(attribute, 1, np.int32)
    return np.where((row >= 0) & (row < len(PROFILES)), row, 0).astype(np.uint8)


def _grid_names(medium: Medium | None) -> set[str]:
    """Names of the attributes that a medium reads as grids."""
    names = {medium.density_grid, medium.color_grid, medium.temperature_grid} if medium else set()
    return names - {""}


def _grid(data: Data, name: str) -> np.ndarray | None:
    """An attribute of numbers as (N,), of vectors or colours as (N, 3), scene-linear; None if there is none."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type not in ("FLOAT", "FLOAT_VECTOR", *COLOR_TYPES):
        return None
    value = arrays.scene_linear(attribute_as_color(attribute))
    return value[:, 0].copy() if attribute.data_type == "FLOAT" else value[:, :3].copy()


def _present(named: Iterable[tuple[str, np.ndarray | None]]) -> dict[str, np.ndarray]:
    """The named arrays that are not None."""
    return {name: array for name, array in named if array is not None}


def _point_info(wanted: Needs, count: int, radii: np.ndarray | None) -> dict[str, np.ndarray]:
    """What materials read of Point Info, by attribute, (N, 4)."""
    found = {}
    if POINT_RANDOM in wanted.colors:
        found[POINT_RANDOM] = point_numbers(count)
    if POINT_RADIUS in wanted.colors and radii is not None:
        found[POINT_RADIUS] = radii
    return {name: np.repeat(value[:, None], 4, axis=1).astype(np.float32) for name, value in found.items()}


def _color_attributes(data: Data, wanted: Needs, imported: bool) -> list[Any]:
    """The attributes that give colours: those that the material reads, or, if imported, the one that importers make."""
    colors = [a for a in data.attributes if a.data_type in COLOR_TYPES and a.domain == "POINT"]
    colors.sort(key=lambda a: COLOR_NAMES.index(a.name) if a.name in COLOR_NAMES else len(COLOR_NAMES))
    if imported:
        return colors[:1]
    named = (data.attributes.get(name) for name in sorted(n for n in wanted.colors if n is not None))
    found = [a for a in named if a is not None and a.data_type in arrays.READABLE_TYPES and a.domain == "POINT"]
    # The first one is what a node without a name reads.
    return [*colors[:1], *found] if None in wanted.colors else found


def _evaluate_graph(
    points: Points,
    colors: dict[str, np.ndarray],
    graph: MaterialGraph,
    material: SampleMaterial,
    box: list[np.ndarray] | None,
) -> Appearance:
    """Values of a material's graph at the points. colors: their colour attributes by name, (N, 4) scene-linear; box:
    see `_appearance`."""
    position = points.position
    generated = None if box is None else generated_coordinates(position, *box)
    active = next(iter(points.uv), None)
    inputs = SampleInputs(points.uv, active, colors, None, position, generated, points.normal)

    def inputs_of(graph: MaterialGraph, part: Part) -> SampleInputs:
        return inputs.take(part)

    rows = np.zeros(len(position), np.uint8)
    return evaluate_materials(rows, {0: graph}, inputs_of, surface_constants([material]), points.normal)
