"""Shadow tables of a scene's lamps: made once for lamps and geometry, and kept for every view.

What casts is every point set and every polygon, sampled as densely as the tables tell apart: not what a view draws.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..core import sampling, shadow
from ..core.appearance import digest
from ..core.cloud import PointCloud, finite
from ..core.cut import largest_singular_value
from ..core.lighting import in_rows
from ..core.scene import Geometry, Light, Mesh, Scene, Settings
from ..core.shadow_samples import Outline, outline, places, sampled
from .prepare import Store, given
from .shadow_pages import PackedTables, pack

MOST_SAMPLES = 1 << 20  # of all meshes together; where more would be needed, all are sampled more coarsely
NEAREST = 0.05  # of the scene's radius: lamps that are nearer to a surface do not ask for finer samples
FEW_INSTANCES = 64  # of one mesh: so many are asked where they are nearest to a lamp
LARGEST_PICTURE = 16384  # rows of a texture
FARTHEST = 1e18  # units from the origin: squares of distances are to fit float32
ENDS = (np.min, np.inf), (np.max, -np.inf)


@dataclass(frozen=True, eq=False)
class Shadows:
    """What lamps need to be shadowed on a device."""

    key: tuple  # content key
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
    spacing = _spacings(casters, scene.lights, settings.shadow_resolution, store)
    look = tuple(
        (c.geometry.key, _look(scene, c.geometry), c.matrices.tobytes(), s)
        for c, s in zip(casters, spacing, strict=True)
    )
    matter = ("casters", hashlib.blake2b(repr(look).encode(), digest_size=16).digest(), settings.shadow_resolution)
    lights = in_rows(scene.lights)
    keys = tuple(_key(light) if light.shadow else None for light in lights)

    def make() -> Shadows:
        batches: list[shadow.Casters] = []
        warnings: list[str] = []
        tables: list[shadow.ShadowTable | None] = []
        for light, key in zip(lights, keys, strict=True):
            check()
            if key is None:
                tables.append(None)
                continue

            def build(light: Light = light) -> shadow.ShadowTable | None:
                if not batches:
                    batches.extend(_batches(scene, casters, spacing, store, check))
                try:
                    return shadow.build(light, batches, settings.shadow_resolution)
                except ValueError as error:
                    warnings.append(f"{light.name or 'A light'} casts no shadow: {error}")
                    return None

            tables.append(store.lookup(("shadow", matter, key), build))
        packed = pack(tables, LARGEST_PICTURE)
        entries = sum(table.entries for table in tables if table is not None)
        wide = any(light.shadow and (light.radius > 0 or light.kind == "AREA") for light in lights)
        return Shadows((matter, keys), packed, entries, wide, tuple(warnings))

    return store.lookup(("shadows", matter, keys), make), ""


def _key(light: Light) -> tuple:
    """What a lamp's table depends on; not its colour."""
    arrays = (light.position, light.direction, light.axis_u, light.axis_v)
    numbers = (light.kind, light.radius, light.spot_cos, light.ellipse, light.spread, light.soft)
    return (*numbers, *(None if a is None else np.asarray(a, float).tobytes() for a in arrays))


def _look(scene: Scene, geometry: Geometry) -> str:
    """What of the materials decides which light a geometry lets through."""
    return "" if geometry.mesh is None else digest(geometry.mesh, scene.materials)


def _casters(scene: Scene, store: Store) -> list[_Caster]:
    """Everything that casts, by geometry."""
    casting, found = _casting(scene), []
    for row, geometry in enumerate(scene.geometries):
        where = np.flatnonzero(casting & (scene.instances.geometry == row))
        bounds = store.lookup(("ball", geometry.key), lambda g=geometry: _ball(g, store)) if len(where) else None
        if bounds is None or bounds[1] < 0:
            continue
        matrices = scene.instances.world_from_object[where]
        centre = matrices[:, :3, :3] @ bounds[0] + matrices[:, :3, 3]
        found.append(_Caster(geometry, matrices, centre, bounds[1] * largest_singular_value(matrices[:, :3, :3])))
    return found


def _outline(geometry: Geometry, mesh: Mesh, store: Store) -> Outline:
    valid, _ = store.lookup(("valid", geometry.key), lambda: sampling.validate(mesh))
    return store.lookup(("shadow outline", geometry.key), lambda: outline(mesh, valid))


def _ball(geometry: Geometry, store: Store) -> tuple[np.ndarray, float]:
    """Centre and radius of a ball about a geometry's box, in object space; the radius is negative where it is empty."""
    mesh, cloud = geometry.mesh, geometry.cloud
    if mesh is not None and len(mesh.triangles):
        found = _outline(geometry, mesh, store)
        low, high, origin = found.low, found.high, np.zeros(3)
    elif cloud is not None and len(cloud):
        position, origin = _reached(finite(cloud)[0]).position, cloud.origin
        low, high = (np.array([f(column, initial=start) for column in position.T], float) for f, start in ENDS)
    else:
        return np.zeros(3), -1.0
    if not (low <= high).all():
        return np.zeros(3), -1.0
    return origin + (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def _spacings(casters: list[_Caster], lights: tuple[Light, ...], resolution: int, store: Store) -> list[float]:
    """How far apart the samples of each mesh may lie, in object units: cells of the table that tells most apart. 0 for
    clouds, which have their points."""
    centre = np.concatenate([c.centre for c in casters])
    radius = np.concatenate([c.radius for c in casters])
    low, high = (centre - radius[:, None]).min(axis=0), (centre + radius[:, None]).max(axis=0)
    middle, reach = (low + high) / 2, max(float(np.linalg.norm(high - low) / 2), 1e-30)
    found, samples = [], 0.0
    for caster in casters:
        mesh = caster.geometry.mesh
        if mesh is None:
            found.append(0.0)
            continue
        found_there = _outline(caster.geometry, mesh, store)
        cell = min(
            _cell(light, caster, found_there, middle, reach, resolution, store) for light in lights if light.shadow
        )
        scale = float(largest_singular_value(caster.matrices[:, :3, :3]).max())
        spacing = cell / scale if scale > 0 else np.inf
        found.append(spacing)
        samples += len(caster.matrices) * found_there.size / spacing**2
    coarser = max(np.sqrt(samples / MOST_SAMPLES), 1.0)
    # To the nearest octave.
    return [sampling.quantise_spacing(np.sqrt(2) * coarser * s) if 0 < s < np.inf else 0.0 for s in found]


def _cell(
    light: Light, caster: _Caster, shape: Outline, middle: np.ndarray, reach: float, resolution: int, store: Store
) -> float:
    """World units that a cell of a lamp's table spans where a caster, a mesh of this shape, is nearest to the lamp."""
    if light.kind == "SUN":
        return 2 * reach / resolution
    away = float(np.linalg.norm(light.position - middle))
    angle = 2 * np.arcsin(reach / away) if away > 1.4 * reach else np.pi
    mesh = caster.geometry.mesh
    if mesh is None or len(caster.matrices) > FEW_INSTANCES:
        near = np.linalg.norm(caster.centre - light.position, axis=1) - caster.radius
    else:
        found = store.lookup(("shadow places", caster.geometry.key), lambda: places(mesh, shape))
        world = np.einsum("iab,nb->ina", caster.matrices[:, :3, :3], found) + caster.matrices[:, None, :3, 3]
        near = np.linalg.norm(world - light.position, axis=-1)
    return float(angle / resolution * max(near.min(), NEAREST * reach))


def _batches(
    scene: Scene, casters: list[_Caster], spacing: list[float], store: Store, check: Callable[[], None]
) -> list[shadow.Casters]:
    """The splats of everything that casts, in world space."""
    found = []
    for caster, length in zip(casters, spacing, strict=True):
        check()
        cloud, mesh = caster.geometry.cloud, caster.geometry.mesh
        clouds = []
        if cloud is not None:
            cloud, _ = store.lookup(("finite", caster.geometry.key), lambda cloud=cloud: given(cloud))
            clouds = [_reached(cloud)]
        if mesh is not None and length > 0:
            clouds = _sampled(scene, caster.geometry, mesh, length, store)
        found += [shadow.casters(cloud, matrix) for cloud in clouds if len(cloud) for matrix in caster.matrices]
    return found


def _reached(cloud: PointCloud) -> PointCloud:
    """The points that are not farther away than numbers reach."""
    if len(cloud) == 0 or max(-float(cloud.position.min()), float(cloud.position.max())) < FARTHEST:
        return cloud
    return cloud.take(np.flatnonzero((np.abs(cloud.position) < FARTHEST).all(axis=1)))


def _sampled(scene: Scene, geometry: Geometry, mesh: Mesh, spacing: float, store: Store) -> tuple[PointCloud, ...]:
    """The points of a mesh that is drawn as polygons, or more densely than shadows need."""
    key = ("shadow samples", geometry.key, _look(scene, geometry), spacing)
    shape = _outline(geometry, mesh, store)
    return store.lookup(key, lambda: tuple(sampled(mesh, shape, spacing, scene.materials)))
