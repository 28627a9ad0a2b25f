"""Finds which geometries of a scene cast shadows, and the reason if none does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.numeric.linear import largest_singular_value
from ...core.numeric.record import record
from ...core.scene.bounds import bounding_box, triangle_boxes, used_positions
from ...core.scene.lights import Light
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Scene
from ...core.scene.settings import Settings
from ...core.shadow.samples import MeshExtents, mesh_extents
from ...core.splat.captured import WIDEST, bounds_of_scales
from ...core.strand.levels import StrandLevels
from ...core.strand.preparation import with_levels
from ...core.surface.appearance import digest, hiding
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store

MAX_COORDINATE = 1e18  # units from the origin: squares of distances must be in the range of float32
_EXTREMES = (np.min, np.inf), (np.max, -np.inf)


@record
class CastingGeometry:
    """One geometry and those of its instances that cast shadows."""

    geometry: Geometry
    matrices: np.ndarray  # (I, 4, 4) float64, world from object
    centre: np.ndarray  # (I, 3) float64, in world space, of balls that bound the instances
    radius: np.ndarray  # (I,) float64
    scale: np.ndarray  # (I,) float64: by how much the instances are enlarged at most

    def take(self, which: np.ndarray) -> CastingGeometry:
        """Returns the same with some of the instances, (I,) bool."""
        arrays = (one[which] for one in (self.matrices, self.centre, self.radius, self.scale))
        return CastingGeometry(self.geometry, *arrays)


def why_no_shadows(scene: Scene, settings: Settings) -> str:
    """Returns why no light of the scene needs a shadow table; an empty string if one does."""
    if not settings.use_shadows:
        return "shadows are switched off"
    if not any(light.shadow for light in scene.lights):
        return "no light casts shadows"
    return "" if _casting_instances(scene).any() else "nothing casts shadows"


def _casting_instances(scene: Scene) -> np.ndarray:
    """Returns (I,) bool: which instances cast shadows."""
    instances = scene.instances
    casts = np.ones(len(instances), bool) if instances.casts is None else instances.casts.astype(bool)
    # Comparisons with NaN are false, so that such instances do not cast.
    return casts & (np.abs(instances.world_from_object) < MAX_COORDINATE).all(axis=(1, 2))


def light_key(light: Light) -> tuple:
    """Returns all properties of a light that its shadow table depends on, which excludes its colour."""
    arrays = (light.position, light.direction, light.axis_u, light.axis_v)
    numbers = (light.kind, light.radius, light.spot_cos, light.ellipse, light.spread, light.soft)
    return (*numbers, *(None if a is None else np.asarray(a, float).tobytes() for a in arrays))


def transmission_digests(scene: Scene, casters: Sequence[CastingGeometry]) -> list[str]:
    """Returns for each caster a digest of the materials' properties that decide how much light it transmits."""
    hidden = hiding(scene.materials)
    return ["" if c.geometry.mesh is None else digest(c.geometry.mesh, hidden) for c in casters]


def caster_keys(scene: Scene, casters: Sequence[CastingGeometry]) -> list[tuple[str, str, bytes]]:
    """Returns what tells casters' shadows apart: contents, what they transmit, and where instances are."""
    return [
        (caster.geometry.key, transmits, hashed(caster.matrices.tobytes()))
        for caster, transmits in zip(casters, transmission_digests(scene, casters), strict=True)
    ]


def casting_geometries(scene: Scene, store: Store) -> list[CastingGeometry]:
    """Returns all geometries with instances that cast shadows, in scene order; empty geometries are left out."""
    casting = _casting_instances(scene)
    of_each, found = scene.instances.of_each(len(scene.geometries), casting), []
    keep_bounding_boxes([one for one, where in zip(scene.geometries, of_each, strict=True) if len(where)], store)
    # Of all at once: a scene may have as many geometries as instances. Those that cast are finite.
    scale = largest_singular_value(np.where(casting[:, None, None], scene.instances.world_from_object[:, :3, :3], 0.0))
    for geometry, where in zip(scene.geometries, of_each, strict=True):
        bounds = (
            store.lookup(Key(Kind.CASTER_BALL, geometry.key), lambda g=geometry: _bounding_ball(g, store))
            if len(where)
            else None
        )
        if bounds is None or bounds[1] < 0:
            continue
        matrices = scene.instances.world_from_object[where]
        centre = matrices[:, :3, :3] @ bounds[0] + matrices[:, :3, 3]
        found.append(CastingGeometry(geometry, matrices, centre, bounds[1] * scale[where], scale[where]))
    return found


def cached_bounding_box(geometry: Geometry, store: Store) -> tuple[np.ndarray, np.ndarray]:
    """Returns the low and high corner, (3,) float64, of a geometry's bounding box, in object space; measured once.

    The box includes the radii of splats and strands, and what is seen of captured ones. If the geometry is empty,
    low > high.
    """
    return store.lookup(Key(Kind.CASTER_BOX, geometry.key), lambda: _bounding_box(geometry, store))


def keep_bounding_boxes(geometries: Sequence[Geometry], store: Store) -> None:
    """Measures the boxes of all meshes among geometries, as `cached_bounding_box` does of one, at once."""
    some = [(geometry.key, geometry.mesh) for geometry in geometries if geometry.mesh is not None]
    some = [(key, mesh) for key, mesh in some if len(mesh.triangles)]
    keys = [Key(Kind.CASTER_BOX, key) for key, _ in some]
    store.lookup_all(keys, lambda rows: triangle_boxes([some[row][1] for row in rows]))


def _bounding_box(geometry: Geometry, store: Store) -> tuple[np.ndarray, np.ndarray]:
    mesh, cloud = geometry.mesh, geometry.cloud
    if mesh is not None and len(mesh.triangles):
        return bounding_box(used_positions(mesh))
    if cloud is not None and len(cloud):
        widest = 0.0 if cloud.radii is None else float(cloud.radii.max(initial=0.0))
        low, high = (
            np.array([f(column, initial=start) for column in cloud.position.T], float) for f, start in _EXTREMES
        )
        return cloud.origin + low - widest, cloud.origin + high + widest
    if geometry.strands is not None and len(strands := cached_strands(geometry, store)):
        widest = float(strands.radius.max())
        low, high = strands.position.min(axis=0) - widest, strands.position.max(axis=0) + widest
        return strands.origin + low, strands.origin + high
    if (captured := geometry.captured) is not None and len(captured):
        reach = WIDEST * bounds_of_scales(captured)
        seen = ~np.isnan(reach)
        position, reach = captured.position[seen], reach[seen, None]
        low, high = (position - reach).min(axis=0, initial=np.inf), (position + reach).max(axis=0, initial=-np.inf)
        return captured.origin + low, captured.origin + high
    return np.full(3, np.inf), np.full(3, -np.inf)


def cached_mesh_extents(geometry: Geometry, mesh: Mesh, store: Store) -> MeshExtents:
    """Returns the extents of a mesh's valid triangles, measured once."""
    return store.lookup(Key(Kind.CASTER_EXTENTS, geometry.key), lambda: mesh_extents(mesh))


def _bounding_ball(geometry: Geometry, store: Store) -> tuple[np.ndarray, float]:
    """Returns the centre and radius of a ball around a geometry's box, in object space; radius < 0: it is empty."""
    mesh, cloud = geometry.mesh, geometry.cloud
    if mesh is not None and len(mesh.triangles):
        (low, high), origin = cached_bounding_box(geometry, store), np.zeros(3)
    elif cloud is not None and len(cloud):
        position, origin = cloud.position, cloud.origin
        low, high = (np.array([f(column, initial=start) for column in position.T], float) for f, start in _EXTREMES)
    elif geometry.strands is not None and len(strands := cached_strands(geometry, store)):
        origin, widest = strands.origin, float(strands.radius.max())
        low, high = strands.position.min(axis=0) - widest, strands.position.max(axis=0) + widest
    elif geometry.captured is not None:
        (low, high), origin = cached_bounding_box(geometry, store), np.zeros(3)
    else:
        return np.zeros(3), -1.0
    if not (low <= high).all():
        return np.zeros(3), -1.0
    return origin + (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def cached_strands(geometry: Geometry, store: Store) -> StrandLevels:
    """Returns the valid strands of a geometry that has some, with their levels of detail, made once."""
    strands = geometry.strands
    assert strands is not None
    return store.lookup(Key(Kind.CLEAN_STRANDS, geometry.key), lambda: with_levels(strands))
