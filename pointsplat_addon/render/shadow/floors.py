"""Finds casters that shadow nothing: floors, flat meshes and slabs with all lights and all geometry on one side; and a
convex body that is alone."""

from __future__ import annotations

import numpy as np

from ...core.numeric.linear import all_finite
from ...core.scene.bounds import box_corners
from ...core.scene.camera import Camera
from ...core.scene.scene import Geometry, Scene
from ...core.shadow.floor import (
    FLATNESS,
    SLAB_TRIANGLES,
    is_thin,
    light_is_above,
    lowest_box_height,
    lowest_height,
    plane_of_mesh,
    planes_of_body,
)
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store
from ..prepare.separation import is_translucent
from .casting import CastingGeometry, cached_bounding_box, cached_mesh_extents, light_key

MAX_FLOOR_INSTANCES = 64  # instances of one mesh up to which they may be floors
MAX_HEIGHTS = 1 << 22  # vertices of all instances up to which each is tested against a floor


def is_lone_body(scene: Scene, casters: list[CastingGeometry], camera: Camera, store: Store) -> bool:
    """Returns whether nothing is there but one closed, convex and opaque mesh with flat shading, and the camera is
    outside of it: what of such a body is turned to a light is never in its own shadow."""
    if len(scene.instances) != 1 or len(casters) != 1:
        return False
    caster, materials = casters[0], scene.materials
    mesh, matrix = caster.geometry.mesh, caster.matrices[0]
    if mesh is None or len(mesh.triangles) > SLAB_TRIANGLES or is_translucent(caster.geometry, materials):
        return False
    graphs = [materials.graphs[row] for row in mesh.materials if row < len(materials.graphs)]
    if any(graph is not None and getattr(graph, "normal", None) is not None for graph in graphs):
        return False  # its normals may be turned to a light that is behind its surface
    view = camera.view_from_world @ matrix
    depth = -(box_corners(*cached_bounding_box(caster.geometry, store)) @ view[2, :3] + view[2, 3])
    if not depth.min() > camera.nearest:
        return False  # the inside may be seen, where it is dark
    return bool(
        store.lookup(
            Key(Kind.CASTER_BODY, caster.geometry.key),
            lambda: planes_of_body(mesh, cached_mesh_extents(caster.geometry, mesh, store)),
        )
    )


def split_floors(
    scene: Scene, casters: list[CastingGeometry], store: Store
) -> tuple[list[CastingGeometry], tuple[bool, ...]]:
    """Returns the casters, those of which some instances are floors as two, and for each whether it is a floor."""
    found, floors = [], []
    for caster, which in zip(casters, which_are_floors(scene, casters, store), strict=True):
        for kind in (False, True):
            if (which == kind).any():
                found.append(caster.take(which == kind))
                floors.append(kind)
    return found, tuple(floors)


def which_are_floors(scene: Scene, casters: list[CastingGeometry], store: Store) -> tuple[np.ndarray, ...]:
    """Returns for each caster (I,) bool: which instances are floors: flat or a slab, with all lights and all geometry
    on one side.

    A floor shadows nothing, and would need as many samples as the tables have cells.
    """
    instances = scene.instances
    every = (*(g.key for g in scene.geometries), *(light_key(light) for light in scene.lights if light.shadow))
    held = instances.world_from_object.tobytes() + instances.geometry.tobytes()
    key = Key(Kind.FLOORS, (every, tuple(c.geometry.key for c in casters)), other=hashed(held))

    def look() -> tuple[np.ndarray, ...]:
        return tuple(_floors(scene, caster, store) for caster in casters)

    return store.lookup(key, look)


def _floors(scene: Scene, caster: CastingGeometry, store: Store) -> np.ndarray:
    """Tells (I,) which instances of a caster are flat, or slabs, and have nothing behind them."""
    mesh = caster.geometry.mesh
    if mesh is None or len(caster.matrices) > MAX_FLOOR_INSTANCES:
        return np.zeros(len(caster.matrices), bool)

    def planes() -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        flat = plane_of_mesh(mesh, *cached_bounding_box(caster.geometry, store))
        if flat is not None:
            return flat, (flat[0], -flat[1])
        few = len(mesh.triangles) <= SLAB_TRIANGLES
        return tuple(planes_of_body(mesh, cached_mesh_extents(caster.geometry, mesh, store))) if few else ()

    found = store.lookup(Key(Kind.CASTER_PLANE, caster.geometry.key), planes)
    return np.array(
        [
            any(_has_nothing_behind(scene, caster.geometry, point, normal, matrix, store) for point, normal in found)
            for matrix in caster.matrices
        ]
    )


def _has_nothing_behind(
    scene: Scene, own: Geometry, point: np.ndarray, normal: np.ndarray, matrix: np.ndarray, store: Store
) -> bool:
    """Tells whether all lights, and all geometry but an instance of `own`, are above a plane of that, or in it.

    `point`, `normal`: (3,) of the plane in object space. `matrix`: (4, 4) of the instance, world from object.
    """
    linear = matrix[:3, :3]
    cofactors = np.cross(np.roll(linear, -1, axis=0), np.roll(linear, -2, axis=0))
    point, normal = linear @ point + matrix[:3, 3], np.sign(np.linalg.det(linear)) * (cofactors @ normal)
    length = np.linalg.norm(normal)
    if not 0 < length < np.inf:
        return False
    normal = normal / length
    if not all(light_is_above(light, point, normal) for light in scene.lights if light.shadow):
        return False
    if own.mesh is None or not is_thin(own.mesh, matrix, point, normal):
        return False
    with np.errstate(all="ignore"):
        drawn = all_finite(scene.instances.world_from_object.astype(np.float32))  # no others are
    of_each = scene.instances.of_each(len(scene.geometries), drawn)
    for geometry, where in zip(scene.geometries, of_each, strict=True):
        matrices = scene.instances.world_from_object[where]
        if geometry is own:
            matrices = matrices[(matrices != matrix).any(axis=(1, 2))]
        if len(matrices) and not _lies_above(geometry, matrices, point, normal, store):
            return False
    return True


def _lies_above(geometry: Geometry, matrices: np.ndarray, point: np.ndarray, normal: np.ndarray, store: Store) -> bool:
    """Tells whether all instances of a geometry, (I, 4, 4) world from object, lie above a plane in the world, or on
    it."""
    low, high = cached_bounding_box(geometry, store)
    if not (low <= high).all():
        return True
    with np.errstate(all="ignore"):
        reach = np.abs(matrices[:, :3, 3]).max() + np.abs(matrices[:, :3, :3]).max() * np.abs([low, high]).max()
        slack = FLATNESS * (reach + np.abs(point).max())
    if lowest_box_height(low, high, matrices, point, normal) >= -slack:
        return True
    mesh = geometry.mesh
    if mesh is None or len(matrices) * len(mesh.position) > MAX_HEIGHTS:
        return False
    return lowest_height(mesh.position[mesh.triangles.reshape(-1)], matrices, point, normal) >= -slack
