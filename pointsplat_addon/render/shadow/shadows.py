"""Shadow tables of a scene's lamps: made once for lamps and geometry, and kept for every view.

What casts is every point set and every polygon, sampled as densely as the tables tell apart: not what a view draws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...core.light.light_table import sorted_by_kind
from ...core.lod.hierarchy import build
from ...core.lod.levels import make_levels
from ...core.numeric.linear import all_finite, largest_singular_value
from ...core.scene.bounds import box_corners
from ...core.scene.cloud import PointCloud
from ...core.scene.lights import Light
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Scene
from ...core.scene.settings import Settings
from ...core.shadow import builder
from ...core.shadow.floor import FLATNESS, light_is_above, lowest_box_height, lowest_height, plane_of_mesh
from ...core.shadow.grid import NARROW_ANGLE, rotation_to
from ...core.shadow.samples import (
    MeshExtents,
    caster_clouds,
    mesh_extents,
    mesh_is_foliage,
    surface_points,
)
from ...core.shadow.strand_casters import StrandSegments, cut_strands
from ...core.strand.levels import StrandLevels
from ...core.strand.preparation import with_levels
from ...core.surface.appearance import digest, hiding
from ...core.surface.spacing import quantise_spacing
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store
from ..prepare.layers import MANY_INSTANCES
from ..prepare.point_sets import given
from .pages import PackedTables, pack

MOST_TOGETHER = 1 << 22  # points of many instances of one mesh: where they have more, nodes stand for them
MOST_SAMPLES = 1 << 20  # of all meshes together; where more would be needed, the largest are sampled more coarsely
WITHIN = 1.2  # cells: the spacing of samples whose disks fit into cells once it is rounded to an octave
NEAREST = 0.05  # of the scene's radius: lamps that are nearer to a surface do not ask for finer samples
FEW_FLOORS = 16  # instances of one flat mesh that may all be floors
MOST_HEIGHTS = 1 << 22  # vertices of all instances that are asked whether they lie above a floor
FEW_INSTANCES = 64  # of one mesh, and meshes: so many are asked where they are nearest to a lamp
LARGEST_PICTURE = 16384  # rows of a texture
FARTHEST = 1e18  # units from the origin: squares of distances are to fit float32
ENDS = (np.min, np.inf), (np.max, -np.inf)


@dataclass(frozen=True, eq=False)
class Shadows:
    """What lamps need to be shadowed on a device."""

    key: Key
    packed: PackedTables
    entries: int
    wide: bool  # some lamp's penumbrae are seen: samples of a picture see different points of it
    warnings: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        return self.packed.data.nbytes


@dataclass(frozen=True, eq=False)
class _Caster:
    """Instances of one geometry that cast."""

    geometry: Geometry
    matrices: np.ndarray  # (I, 4, 4) float64, world from object
    centre: np.ndarray  # (I, 3) float64, of balls that hold them
    radius: np.ndarray  # (I,) float64


def why_none(scene: Scene, settings: Settings) -> str:
    """Why no lamp needs a table; empty where one does."""
    if not settings.use_shadows:
        return "shadows are switched off"
    if not any(light.shadow for light in scene.lights):
        return "no light casts shadows"
    return "" if _casting(scene).any() else "nothing casts shadows"


def _casting(scene: Scene) -> np.ndarray:
    """(I,) bool: instances that cast shadows."""
    instances = scene.instances
    casts = np.ones(len(instances), bool) if instances.casts is None else instances.casts.astype(bool)
    # What is no number is not smaller.
    return casts & (np.abs(instances.world_from_object) < FARTHEST).all(axis=(1, 2))


def cast(
    scene: Scene, settings: Settings, store: Store, check: Callable[[], None] = lambda: None
) -> tuple[Shadows | None, str]:
    """The tables of all lamps that cast shadows, in the order of lighting's rows; or None, and why."""
    why = why_none(scene, settings)
    if why:
        return None, why
    casters = _casters(scene, store)
    if not casters:
        return None, "nothing casts shadows"
    floors = _floors(scene, casters, store)
    if all(floors):
        return None, "there is nothing in the shadow of anything"
    held = tuple((c.geometry.key, c.matrices.tobytes()) for c in casters)
    lamps = tuple(_key(light) for light in scene.lights if light.shadow)
    spacing = store.lookup(
        Key(Kind.CASTER_SPACINGS, hashed((held, lamps)), other=(settings.shadow_resolution, floors)),
        lambda: _spacings(casters, scene.lights, settings.shadow_resolution, store, floors),
    )
    look = tuple(
        (c.geometry.key, _look(scene, c.geometry), c.matrices.tobytes(), s)
        for c, s in zip(casters, spacing, strict=True)
    )
    matter = Key(Kind.CASTERS, hashed(look), other=settings.shadow_resolution)
    # Cells are as wide as they would be if floors cast, so that shadows on these do not move with what stands there.
    around = [_outer(c, store) for c, floor in zip(casters, floors, strict=True) if floor]
    lights = sorted_by_kind(scene.lights)
    keys = tuple(_key(light) if light.shadow else None for light in lights)

    every = Key(Kind.SHADOW_TABLES, matter, other=keys)

    def make() -> Shadows:
        batches: list[builder.Casters] = []
        strands: list[StrandSegments] = []
        warnings: list[str] = []
        tables: list[builder.ShadowTable | None] = []
        for light, key in zip(lights, keys, strict=True):
            check()
            if key is None:
                tables.append(None)
                continue

            def build(light: Light = light) -> builder.ShadowTable | None:
                if not batches and not strands:
                    batches.extend(_batches(scene, casters, spacing, store, check))
                    strands.extend(_pieces(casters, spacing, store))
                try:
                    every = [*batches, *(one.casters_toward(light) for one in strands)]
                    return builder.build_table(light, every, settings.shadow_resolution, around)
                except ValueError as error:
                    warnings.append(f"{light.name or 'A light'} casts no shadow: {error}")
                    return None

            tables.append(store.lookup(Key(Kind.SHADOW_TABLE, matter, other=key), build))
        packed = pack(tables, LARGEST_PICTURE)
        entries = sum(table.entries for table in tables if table is not None)
        wide = any(light.shadow and (light.radius > 0 or light.kind == "AREA") for light in lights)
        return Shadows(every, packed, entries, wide, tuple(warnings))

    return store.lookup(every, make), ""


def _key(light: Light) -> tuple:
    """What a lamp's table depends on; not its colour."""
    arrays = (light.position, light.direction, light.axis_u, light.axis_v)
    numbers = (light.kind, light.radius, light.spot_cos, light.ellipse, light.spread, light.soft)
    return (*numbers, *(None if a is None else np.asarray(a, float).tobytes() for a in arrays))


def _look(scene: Scene, geometry: Geometry) -> str:
    """What of the materials decides which light a geometry lets through."""
    return "" if geometry.mesh is None else digest(geometry.mesh, hiding(scene.materials))


def _casters(scene: Scene, store: Store) -> list[_Caster]:
    """Everything that casts, by geometry."""
    casting, found = _casting(scene), []
    for row, geometry in enumerate(scene.geometries):
        where = np.flatnonzero(casting & (scene.instances.geometry == row))
        bounds = (
            store.lookup(Key(Kind.CASTER_BALL, geometry.key), lambda g=geometry: _ball(g, store))
            if len(where)
            else None
        )
        if bounds is None or bounds[1] < 0:
            continue
        matrices = scene.instances.world_from_object[where]
        centre = matrices[:, :3, :3] @ bounds[0] + matrices[:, :3, 3]
        found.append(_Caster(geometry, matrices, centre, bounds[1] * largest_singular_value(matrices[:, :3, :3])))
    return found


def _outer(caster: _Caster, store: Store) -> builder.Casters:
    """The corners of boxes about all instances, in the world, of no size."""
    corners = box_corners(*_box(caster.geometry, store))
    world = np.einsum("iab,nb->ina", caster.matrices[:, :3, :3], corners) + caster.matrices[:, None, :3, 3]
    world = world.reshape(-1, 3)
    middle = world.mean(axis=0)
    return builder.Casters("OPAQUE", middle, (world - middle).astype(np.float32), np.zeros(len(world), np.float32))


def _floors(scene: Scene, casters: list[_Caster], store: Store) -> tuple[bool, ...]:
    """Casters behind which, seen from all lamps, there is nothing: a floor under all that stands on it would take as
    many samples as the tables have cells."""
    instances = scene.instances
    every = (*(g.key for g in scene.geometries), *(_key(light) for light in scene.lights if light.shadow))
    held = instances.world_from_object.tobytes() + instances.geometry.tobytes()
    key = Key(Kind.FLOORS, (every, tuple(c.geometry.key for c in casters)), other=hashed(held))

    def look() -> tuple[bool, ...]:
        return tuple(_is_floor(scene, caster, store) for caster in casters)

    return store.lookup(key, look)


def _is_floor(scene: Scene, caster: _Caster, store: Store) -> bool:
    mesh = caster.geometry.mesh
    if mesh is None or len(caster.matrices) > FEW_FLOORS:
        return False
    found = store.lookup(
        Key(Kind.CASTER_PLANE, caster.geometry.key),
        lambda: (plane_of_mesh(mesh, _outline(caster.geometry, mesh, store)),),
    )[0]
    if found is None:
        return False
    point, normal = found
    return all(_nothing_behind(scene, point, normal, matrix, store) for matrix in caster.matrices)


def _nothing_behind(scene: Scene, point: np.ndarray, normal: np.ndarray, matrix: np.ndarray, store: Store) -> bool:
    """Whether a plane in object space, of an instance (4, 4), has all lamps and all geometry on one side."""
    linear = matrix[:3, :3]
    cofactors = np.cross(np.roll(linear, -1, axis=0), np.roll(linear, -2, axis=0))
    point, normal = linear @ point + matrix[:3, 3], cofactors @ normal
    length = np.linalg.norm(normal)
    if not 0 < length < np.inf:
        return False
    normal = normal / length
    lights = [light for light in scene.lights if light.shadow]
    if not all(light_is_above(light, point, normal) for light in lights):
        normal = -normal
        if not all(light_is_above(light, point, normal) for light in lights):
            return False
    with np.errstate(all="ignore"):
        drawn = all_finite(scene.instances.world_from_object.astype(np.float32))  # no others are
    for row, geometry in enumerate(scene.geometries):
        matrices = scene.instances.world_from_object[drawn & (scene.instances.geometry == row)]
        if len(matrices) and not _above(geometry, matrices, point, normal, store):
            return False
    return True


def _above(geometry: Geometry, matrices: np.ndarray, point: np.ndarray, normal: np.ndarray, store: Store) -> bool:
    """Whether all instances (I, 4, 4) lie above a plane, or on it."""
    low, high = store.lookup(Key(Kind.CASTER_BOX, geometry.key), lambda: _box(geometry, store))
    if not (low <= high).all():
        return True
    with np.errstate(all="ignore"):
        reach = np.abs(matrices[:, :3, 3]).max() + np.abs(matrices[:, :3, :3]).max() * np.abs([low, high]).max()
        slack = FLATNESS * (reach + np.abs(point).max())
    if lowest_box_height(low, high, matrices, point, normal) >= -slack:
        return True
    mesh = geometry.mesh
    if mesh is None or len(matrices) * len(mesh.position) > MOST_HEIGHTS:
        return False
    return lowest_height(mesh.position[mesh.triangles.reshape(-1)], matrices, point, normal) >= -slack


def _box(geometry: Geometry, store: Store) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) float64 of what holds a geometry with its splats, in object space; low above high: it is empty."""
    mesh, cloud = geometry.mesh, geometry.cloud
    if mesh is not None and len(mesh.triangles):
        found = _outline(geometry, mesh, store)
        return found.low, found.high
    if cloud is not None and len(cloud):
        widest = 0.0 if cloud.radii is None else float(cloud.radii.max(initial=0.0))
        low, high = (np.array([f(column, initial=start) for column in cloud.position.T], float) for f, start in ENDS)
        return cloud.origin + low - widest, cloud.origin + high + widest
    if geometry.strands is not None and len(strands := _strands(geometry, store)):
        widest = float(strands.radius.max())
        low, high = strands.position.min(axis=0) - widest, strands.position.max(axis=0) + widest
        return strands.origin + low, strands.origin + high
    return np.full(3, np.inf), np.full(3, -np.inf)


def _outline(geometry: Geometry, mesh: Mesh, store: Store) -> MeshExtents:
    return store.lookup(Key(Kind.CASTER_OUTLINE, geometry.key), lambda: mesh_extents(mesh))


def _ball(geometry: Geometry, store: Store) -> tuple[np.ndarray, float]:
    """Centre and radius of a ball about a geometry's box, in object space; the radius is negative where it is empty."""
    mesh, cloud = geometry.mesh, geometry.cloud
    if mesh is not None and len(mesh.triangles):
        found = _outline(geometry, mesh, store)
        low, high, origin = found.low, found.high, np.zeros(3)
    elif cloud is not None and len(cloud):
        position, origin = cloud.position, cloud.origin
        low, high = (np.array([f(column, initial=start) for column in position.T], float) for f, start in ENDS)
    elif geometry.strands is not None and len(strands := _strands(geometry, store)):
        origin, widest = strands.origin, float(strands.radius.max())
        low, high = strands.position.min(axis=0) - widest, strands.position.max(axis=0) + widest
    else:
        return np.zeros(3), -1.0
    if not (low <= high).all():
        return np.zeros(3), -1.0
    return origin + (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def _strands(geometry: Geometry, store: Store) -> StrandLevels:
    lines = geometry.strands
    assert lines is not None
    return store.lookup(Key(Kind.CLEAN_STRANDS, geometry.key), lambda: with_levels(lines))


def _pieces(casters: list[_Caster], spacing: list[float], store: Store) -> list[StrandSegments]:
    """Strands of everything that casts, in world space."""
    return [
        cut_strands(_strands(caster.geometry, store), matrix, length)
        for caster, length in zip(casters, spacing, strict=True)
        if caster.geometry.strands is not None and length > 0
        for matrix in caster.matrices
    ]


def _spacings(
    casters: list[_Caster], lights: tuple[Light, ...], resolution: int, store: Store, floors: tuple[bool, ...]
) -> list[float]:
    """How far apart the samples of each mesh may lie, in object units: cells of the table that tells most apart. 0 for
    clouds, which have their points, and for floors. Of strands how long their pieces are."""
    meshes = [caster.geometry.mesh is not None for caster in casters]
    if not any(mesh or caster.geometry.strands is not None for mesh, caster in zip(meshes, casters, strict=True)):
        return [0.0] * len(casters)
    balls = [_balls(caster, store, len(casters)) for caster in casters]
    centre, radius = (np.concatenate(parts) for parts in zip(*balls, strict=True))
    low, high = (centre - radius[:, None]).min(axis=0), (centre + radius[:, None]).max(axis=0)
    reach = max(float(np.linalg.norm(high - low) / 2), 1e-30)
    cell = np.full(len(casters), np.inf)
    for light in lights:
        if light.shadow:
            step = _step(light, centre, radius, (low + high) / 2, resolution)
            near = [
                1.0 if light.kind == "SUN" else max(float((_away(light, c) - r).min()), NEAREST * reach)
                for c, r in balls
            ]
            cell = np.minimum(cell, step * np.array(near))
    scale = np.array([largest_singular_value(c.matrices[:, :3, :3]).max() for c in casters])
    area = np.array([0.0 if floor else _area(c, store) for c, floor in zip(casters, floors, strict=True)])
    with np.errstate(divide="ignore", invalid="ignore"):
        spacing = WITHIN * cell / scale
        samples = area / spacing**2
    some = np.array(meshes) & (spacing > 0) & np.isfinite(spacing) & (samples > 0)
    lengths = [_length(caster, store) for caster in casters]
    strands = [max(s, sum(lengths) / MOST_SAMPLES) if one > 0 else 0.0 for s, one in zip(spacing, lengths, strict=True)]
    if not some.any():
        return strands
    many = samples[some] / _share(samples[some], MOST_SAMPLES)
    # Down to an octave; where there are too many, to the nearest.
    spacing[some] *= np.where(many > 1, np.sqrt(2 * many), 1)
    return [quantise_spacing(s) if ok else other for s, ok, other in zip(spacing.tolist(), some, strands, strict=True)]


def _length(caster: _Caster, store: Store) -> float:
    """Of all strands of all instances, in units of the object."""
    if caster.geometry.strands is None:
        return 0.0
    strands = _strands(caster.geometry, store)
    step = np.linalg.norm(np.diff(strands.position, axis=0), axis=1)
    return len(caster.matrices) * float(step.sum() - step[strands.start[1:-1] - 1].sum())


def _balls(caster: _Caster, store: Store, casters: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (K, 3) and radii (K,), in the world, of balls that hold one of so many casters: of a mesh with few
    instances, places all over it."""
    mesh = caster.geometry.mesh
    if mesh is None or max(len(caster.matrices), casters) > FEW_INSTANCES:
        return caster.centre, caster.radius
    shape = _outline(caster.geometry, mesh, store)
    found = store.lookup(Key(Kind.CASTER_POSITIONS, caster.geometry.key), lambda: surface_points(mesh, shape))
    world = (
        np.einsum("iab,nb->ina", caster.matrices[:, :3, :3], found[:: len(caster.matrices)])
        + caster.matrices[:, None, :3, 3]
    )
    return world.reshape(-1, 3), np.zeros(world.size // 3)


def _area(caster: _Caster, store: Store) -> float:
    """Units^2 of the object, of all instances."""
    mesh = caster.geometry.mesh
    return 0.0 if mesh is None else len(caster.matrices) * _outline(caster.geometry, mesh, store).size


def _away(light: Light, points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - light.position, axis=1)


def _step(light: Light, centre: np.ndarray, radius: np.ndarray, middle: np.ndarray, resolution: int) -> float:
    """Side of the finest cells of a lamp's table over balls about `middle`: radians, of suns units; see fit_frame."""
    if light.kind == "SUN":
        along, half = (centre - middle) @ rotation_to(light.direction)[1:].T, radius[:, None]
        return float(((along + half).max(axis=0) - (along - half).min(axis=0)).max()) / resolution
    axis, seen, away = middle - light.position, centre - light.position, np.maximum(_away(light, centre), 1e-30)
    cosine = seen @ axis / (away * max(float(np.linalg.norm(axis)), 1e-30))
    angle = np.arccos(np.clip(cosine, -1, 1)) + np.arcsin(np.clip(radius / away, 0, 1))
    widest = float(angle.max())
    return (2 * widest if widest <= NARROW_ANGLE else np.pi) / resolution


def _share(samples: np.ndarray, most: float) -> float:
    """How many each of meshes that ask for `samples` (M,) may have, so that all have `most`: small ones what they ask
    for, large ones equally many."""
    ascending = np.sort(samples)
    others = len(samples) - np.arange(len(samples))
    each = (most - (np.cumsum(ascending) - ascending)) / others
    fits = np.flatnonzero(ascending > each)
    return float(each[fits[0]]) if len(fits) else float(ascending[-1])


def _batches(
    scene: Scene, casters: list[_Caster], spacing: list[float], store: Store, check: Callable[[], None]
) -> list[builder.Casters]:
    """The splats of everything that casts, in world space."""
    found = []
    for caster, length in zip(casters, spacing, strict=True):
        check()
        cloud, mesh = caster.geometry.cloud, caster.geometry.mesh
        clouds = []
        if cloud is not None:
            clouds = [store.lookup(Key(Kind.GIVEN_POINTS, caster.geometry.key), lambda cloud=cloud: given(cloud))]
        if mesh is not None and length > 0:
            clouds = _sampled(scene, caster.geometry, mesh, length, store)
        for cloud in clouds:
            if len(cloud) * len(caster.matrices) > MOST_TOGETHER and _shareable(cloud, caster):
                look = _look(scene, caster.geometry)
                key = Key(Kind.CASTER_NODES, caster.geometry.key, look, spacing=length, other=len(caster.matrices))
                coarse = store.lookup(key, lambda cloud=cloud, caster=caster: _coarsened(cloud, len(caster.matrices)))
                found.append(builder.casters(_repeated(coarse, caster.matrices), np.eye(4)))
            elif len(cloud):
                found += [builder.casters(cloud, matrix) for matrix in caster.matrices]
    return found


def _shareable(cloud: PointCloud, caster: _Caster) -> bool:
    """Whether nodes of an opaque surface can stand for its many instances."""
    surface = cloud.opacity is None and cloud.extinction is None and cloud.normal is not None
    return surface and cloud.radii is not None and len(caster.matrices) >= MANY_INSTANCES


def _coarsened(cloud: PointCloud, instances: int) -> PointCloud:
    """The finest level of nodes that so many instances may have, together MOST_SAMPLES; without levels the points."""
    levels = make_levels(build(cloud))
    if levels is None:
        return cloud
    fits = np.flatnonzero(levels.count * instances <= MOST_SAMPLES)
    level = int(fits[-1]) if len(fits) else 0
    first = int(levels.first[level])
    return levels.cloud.take(np.arange(first, first + int(levels.count[level])))


def _repeated(cloud: PointCloud, matrices: np.ndarray) -> PointCloud:
    """The splats of all instances (I, 4, 4) in the world, true to size where scales are alike in all directions."""
    assert cloud.normal is not None
    assert cloud.radii is not None
    middle = matrices[:, :3, 3].mean(axis=0)
    linear = matrices[:, :3, :3]
    scale = np.abs(np.linalg.det(linear)) ** (1 / 3)
    offset = matrices[:, :3, 3] + linear @ cloud.origin - middle

    def turned(vectors: np.ndarray, by: np.ndarray) -> np.ndarray:
        found = np.einsum("iab,nb->ina", by.astype(np.float32), vectors).reshape(-1, 3)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), np.finfo(np.float32).tiny)

    position = np.einsum("iab,nb->ina", linear, cloud.position) + offset[:, None]
    normal = np.cross(np.roll(linear, -1, axis=1), np.roll(linear, -2, axis=1))  # cofactors
    return PointCloud(
        position.reshape(-1, 3).astype(np.float32),
        origin=middle,
        normal=turned(cloud.normal, normal),
        axis=None if cloud.axis is None else turned(cloud.axis, linear),
        radii=(scale[:, None, None] * cloud.radii).reshape(-1, cloud.radii.shape[1]).astype(np.float32),
    )


def _sampled(scene: Scene, geometry: Geometry, mesh: Mesh, spacing: float, store: Store) -> tuple[PointCloud, ...]:
    """The points of a mesh that is drawn as polygons, or more densely than shadows need."""
    key = Key(Kind.CASTER_SAMPLES, geometry.key, _look(scene, geometry), spacing=spacing)
    shape = _outline(geometry, mesh, store)

    def make() -> tuple[PointCloud, ...]:
        leafy = store.lookup(
            Key(Kind.IS_FOLIAGE, geometry.key), lambda: mesh_is_foliage(mesh, shape)
        )  # as render/prepare/meshes.py keeps it
        return tuple(caster_clouds(mesh, shape, spacing, hiding(scene.materials), leafy))

    return store.lookup(key, make)
