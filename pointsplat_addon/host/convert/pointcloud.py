"""Points of an evaluated PointCloud object, of a particle system, or of a mesh without edges and faces, to splats.

Points without normals are balls. Those that light passes through become Gaussians: by the object's own extinction, by
the medium of a material that has a volume and no surface, or such that a ray through a ball's centre meets its alpha.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from ...core.material.evaluation import Appearance, SurfaceConstants, evaluate_materials
from ...core.material.expression import Part, SampleInputs
from ...core.material.graph import MaterialGraph, Needs, needs
from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.scene.volume import Medium, Volume
from ...core.splat.kernel import PROFILES
from ...core.surface.appearance import CLIP, ball_extinction
from ...core.surface.nearest import median_spacing
from ...core.volume.optics import voxel_optics
from . import arrays
from .mesh import COLOR_TYPES, as_color

DEFAULT_RADIUS = 0.01  # Blender's, for points without a radius attribute
COLOR_NAMES = ("Color", "Col")  # what importers call it
OPACITY_NAMES = ("opacity", "alpha")
CAPTURED = "f_dc_0"  # an attribute of captured splats, whose opacities are logits
NUMBERS = {"FLOAT": ("value", 1), "FLOAT2": ("vector", 2), "FLOAT_VECTOR": ("vector", 3)}
Lookup = Callable[[str, Callable[[], PointCloud]], PointCloud]
Data = bpy.types.PointCloud | bpy.types.Mesh


@dataclass(frozen=True, eq=False)
class CloudMaterial:
    """What points must know of their material."""

    row: int  # of the scene's table; 0 is no material, and then attributes by the names of importers give the looks
    graph: MaterialGraph | None = None
    roughness: float = 0.5  # the constants, for when only the other one varies
    metallic: float = 0.0
    emission: tuple[float, ...] = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    translucent: bool = False
    medium: Medium | None = None  # of a material without a surface
    extinction: float = 0.0  # the object's own, per object unit; 0 takes the material's
    base_color: tuple[float, ...] = (0.8, 0.8, 0.8)  # of strands, which may have several materials

    @property
    def key(self) -> str:
        volume = None if self.medium is None else [np.asarray(v).tolist() for v in vars(self.medium).values()]
        looks = self.roughness, self.metallic, self.emission, self.alpha, self.translucent, self.extinction
        return repr((self.row, self.graph and self.graph.digest, looks, volume))


def cloud_material(table: MaterialTable, row: int, extinction: float = 0.0) -> CloudMaterial:
    """What the table says of a material's points."""
    graph = table.graphs[row] if row < len(table.graphs) else None
    alpha = float(table.alpha[row])
    varies = isinstance(graph, MaterialGraph) and graph.alpha is not None
    return CloudMaterial(
        row,
        graph,  # pyright: ignore[reportArgumentType]
        float(table.roughness[row]),
        float(table.metallic[row]),
        tuple(table.emission[row].tolist()),
        alpha,
        table.translucent is not None and bool(table.translucent[row]),
        table.media[row] if row < len(table.media) and alpha == 0 and not varies else None,
        extinction,
        tuple(table.base_color[row].tolist()),
    )


@dataclass(frozen=True, eq=False)
class Points:
    """Arrays of N points as Blender has them."""

    position: np.ndarray  # (N, 3) float32
    radius: np.ndarray | None  # (N,) float32; None: half the median distance to the nearest neighbour
    normal: np.ndarray | None = None  # (N, 3) float32
    opacity: np.ndarray | None = None  # (N,) float32
    kernel: np.ndarray | None = None  # (N,) uint8, rows of core.kernel.PROFILES
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # name to (N, 4) as stored
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # name to (N, 2) float32
    grids: dict[str, np.ndarray] = field(default_factory=dict)  # what a medium reads, (N,) or (N, 3) float32

    @property
    def key(self) -> str:
        named = [part for group in (self.colors, self.uv, self.grids) for item in group.items() for part in item]
        return arrays.digest("pointcloud", self.position, self.radius, self.normal, self.opacity, self.kernel, *named)


def read_pointcloud(
    data: Data, material: CloudMaterial, lookup: Lookup, radius: float = 0.0
) -> tuple[str, PointCloud] | None:
    """(content key, cloud) of a point cloud, or of the vertices of a mesh, in object space; None where it is empty.

    `radius`: of all points, in object units; 0 takes their attribute. Without that, points of a point cloud have
    Blender's radius and vertices one by how far apart they lie.
    """
    count = len(data.vertices if isinstance(data, bpy.types.Mesh) else data.points)
    if "position" not in data.attributes or count == 0:
        return None
    wanted, imported = needs(material.graph) if material.graph else Needs(), material.row == 0
    radii = np.full(count, radius, np.float32) if radius > 0 else _read(data, "radius", "FLOAT")
    if radii is None and isinstance(data, bpy.types.PointCloud):
        radii = np.full(count, DEFAULT_RADIUS, np.float32)
    points = Points(
        arrays.read(data.attributes["position"].data, "vector", 3, np.float32),
        radii,
        _read(data, "normal", "FLOAT_VECTOR"),
        _opacity(data) if imported else None,
        _kernel(data),
        {a.name: as_color(a) for a in _color_attributes(data, wanted, imported)},
        _present((name, _read(data, name, "FLOAT2")) for name in wanted.uv if name is not None),
        _present((name, _grid(data, name)) for name in _grid_names(material.medium)),
    )
    return splats(points, material, lookup)


def splats(points: Points, material: CloudMaterial, lookup: Lookup) -> tuple[str, PointCloud]:
    """(content key, cloud) of points by their material; the cloud is made only where it is not known."""
    key = f"{points.key} {arrays.digest(material.key)}"
    return key, lookup(key, lambda: _build(points, material))


def _build(points: Points, material: CloudMaterial) -> PointCloud:
    count, graph, normal = len(points.position), material.graph, points.normal
    linear = {name: arrays.scene_linear(array) for name, array in points.colors.items()}
    look = Appearance()
    if graph is not None:
        look = _evaluate(points, linear, graph, material)
    elif linear and material.row == 0:
        color = next(iter(linear.values()))
        look = Appearance(np.ascontiguousarray(color[:, :3], np.float32), alpha=np.clip(color[:, 3], 0, 1))
    facing = normal if look.normal is None else look.normal
    cloud = PointCloud(
        position=points.position,
        normal=None if facing is None else unit(facing),
        radii=_radii(points)[:, None],
        color=look.color,
        surface=look.surface,
        emission=look.emission,
        material=np.full(count, material.row, np.uint16) if material.row else None,
        kernel=points.kernel,
    )
    if material.extinction > 0 or material.medium is not None:
        return _filled(cloud, points, material)
    alpha = np.full(count, material.alpha, np.float32) if look.alpha is None else look.alpha
    if points.opacity is not None:
        alpha = alpha * points.opacity
    return _seen(cloud, alpha, material)


def _radii(points: Points) -> np.ndarray:
    """(N,) float32 in object units."""
    if points.radius is not None:
        return points.radius
    radius = 0.5 * median_spacing(points.position) or DEFAULT_RADIUS
    return np.full(len(points.position), radius, np.float32)


def _filled(cloud: PointCloud, points: Points, material: CloudMaterial) -> PointCloud:
    """Balls of a medium."""
    if material.medium is None:
        return _balls(cloud, np.full(len(cloud), material.extinction, np.float32), material)
    medium = material.medium
    if medium.density_grid not in points.grids:
        medium = replace(medium, density_grid="")
    # Points are voxels without places: what is read of them does not depend on where they are.
    voxels = Volume("", "", np.empty((len(cloud), 0), np.int32), np.eye(4), points.grids)
    found, _ = voxel_optics(voxels, medium, material.extinction)
    return replace(cloud, normal=None, color=found.albedo, emission=found.emission, extinction=found.extinction)


def _balls(cloud: PointCloud, extinction: np.ndarray, material: CloudMaterial) -> PointCloud:
    """Gaussians of an extinction (N,), in whose depths the surface's emitted radiance is reached."""
    radiance = cloud.emission
    if radiance is None and any(material.emission):
        radiance = np.array([material.emission], np.float32)
    emission = None if radiance is None else radiance * extinction[:, None]
    return replace(cloud, normal=None, extinction=extinction, emission=emission)


def _seen(cloud: PointCloud, alpha: np.ndarray, material: CloudMaterial) -> PointCloud:
    """The points that show, with their extinction, or opacity where they have normals, unless all are opaque."""
    if material.graph is not None and not material.translucent:
        return cloud if (alpha >= CLIP).all() else cloud.take(alpha >= CLIP)
    if not (alpha < 1).any():
        return cloud
    if cloud.normal is not None:
        cloud = replace(cloud, opacity=alpha.astype(np.float32))
    else:
        assert cloud.radii is not None
        cloud = _balls(cloud, ball_extinction(alpha, cloud.radii[:, 0]), material)
    return cloud.take(alpha > 0)


# Attributes


def _read(data: Data, name: str, kind: str) -> np.ndarray | None:
    """A point attribute, or None where there is none of that name and type."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type != kind or attribute.domain != "POINT":
        return None
    return arrays.read(attribute.data, *NUMBERS[kind], np.float32)


def _opacity(data: Data) -> np.ndarray | None:
    """(N,) in [0, 1]; what is no number counts as opaque."""
    if CAPTURED in data.attributes:
        return None
    found = next((a for name in OPACITY_NAMES if (a := _read(data, name, "FLOAT")) is not None), None)
    return None if found is None else np.clip(np.nan_to_num(found, nan=1.0), 0, 1)


def _kernel(data: Data) -> np.ndarray | None:
    """(N,) uint8 shapes of splats by an attribute of integers, if any; numbers that name none are the default, 0."""
    attribute = data.attributes.get("kernel")
    if attribute is None or attribute.data_type != "INT":
        return None
    row = arrays.read(attribute.data, "value", 1, np.int32)
    return np.where((row >= 0) & (row < len(PROFILES)), row, 0).astype(np.uint8)


def _grid_names(medium: Medium | None) -> set[str]:
    names = {medium.density_grid, medium.color_grid, medium.temperature_grid} if medium else set()
    return names - {""}


def _grid(data: Data, name: str) -> np.ndarray | None:
    """(N,) of a number, (N, 3) of a vector or colour; None where there is no such attribute."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type not in ("FLOAT", "FLOAT_VECTOR", *COLOR_TYPES):
        return None
    value = arrays.scene_linear(as_color(attribute))
    return value[:, 0].copy() if attribute.data_type == "FLOAT" else value[:, :3].copy()


def _present(named: Iterable[tuple[str, np.ndarray | None]]) -> dict[str, np.ndarray]:
    return {name: array for name, array in named if array is not None}


def _color_attributes(data: Data, wanted: Needs, imported: bool) -> list[Any]:
    """Attributes that give colours: those that the material reads, or the one that importers make."""
    colors = [a for a in data.attributes if a.data_type in COLOR_TYPES and a.domain == "POINT"]
    colors.sort(key=lambda a: COLOR_NAMES.index(a.name) if a.name in COLOR_NAMES else len(COLOR_NAMES))
    if imported:
        return colors[:1]
    readable = (*COLOR_TYPES, "FLOAT", "FLOAT_VECTOR")
    named = (data.attributes.get(name) for name in sorted(n for n in wanted.colors if n is not None))
    found = [a for a in named if a is not None and a.data_type in readable and a.domain == "POINT"]
    # The first one is what a node without a name reads.
    return [*colors[:1], *found] if None in wanted.colors else found


def _evaluate(
    points: Points, colors: dict[str, np.ndarray], graph: MaterialGraph, material: CloudMaterial
) -> Appearance:
    """What a material's graph gives at points whose colour attributes are these, (N, 4) scene-linear."""
    position, generated = points.position, None
    if needs(graph).generated:
        generated = generated_coordinates(position, position.min(axis=0), position.max(axis=0))
    active = next(iter(points.uv), None)
    inputs = SampleInputs(points.uv, active, colors, None, position, generated, points.normal)

    def some(graph: MaterialGraph, part: Part) -> SampleInputs:
        return inputs.take(part)

    rows = np.zeros(len(position), np.uint8)
    return evaluate_materials(rows, {0: graph}, some, constants_of([material]), points.normal)


def constants_of(materials: Sequence[CloudMaterial]) -> SurfaceConstants:
    """The materials' constants, a row for each."""

    def column(name: str) -> np.ndarray:
        return np.array([getattr(m, name) for m in materials], np.float32)

    return SurfaceConstants(
        column("base_color"), column("roughness"), column("metallic"), column("emission"), column("alpha")
    )


def generated_coordinates(position: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(N, 3) positions as shares of the box from low to high, each (3,); where a side has no length, offsets."""
    return (position - low) / np.where(high > low, high - low, 1)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised rows; a zero vector becomes +Z."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), [0, 0, 1]).astype(np.float32)
