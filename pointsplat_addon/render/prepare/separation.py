"""Separates opaque from translucent geometry: splits meshes by material, and turns volumes into points."""

from __future__ import annotations

import hashlib
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.scene.scene import Geometry, Instances, Scene
from ...core.scene.valid.geometry import valid_points
from ...core.scene.volume import Volume
from ...core.surface.appearance import digest, passing, split_translucent
from ...core.volume import voxels
from ..cache.keys import Key, Kind
from ..cache.store import Store


def separate_translucent(scene: Scene, store: Store) -> tuple[Scene, tuple[str, ...]]:
    """Returns the validated scene with geometries that are opaque or translucent as a whole, and warnings.

    It is the scene itself if nothing has to change. Instances keep their rows. The translucent part of a mesh is a
    further geometry with instances of its own, which follow after all others.
    """
    warnings: list[str] = []
    geometries: list[Geometry] = []
    extra: list[tuple[int, Geometry]] = []
    for row, geometry in enumerate(scene.geometries):
        first, *more = _parts(geometry, scene.materials, store, warnings)
        geometries.append(first)
        extra += [(row, part) for part in more]
    if not extra and all(a is b for a, b in zip(geometries, scene.geometries, strict=True)):
        return scene, tuple(warnings)
    instances = scene.instances
    if extra:
        again = [np.flatnonzero(instances.geometry == row) for row, _ in extra]
        count = [len(rows) for rows in again]
        instances = with_repeated(
            instances, np.concatenate(again), np.repeat(len(geometries) + np.arange(len(extra)), count)
        )
    all_of_them = (*geometries, *(part for _, part in extra))
    return replace(scene, geometries=all_of_them, instances=instances), tuple(warnings)


def _parts(geometry: Geometry, table: MaterialTable, store: Store, warnings: list[str]) -> list[Geometry]:
    """Returns the opaque and the translucent part of a geometry, or one of them if the other is empty."""
    if geometry.volume is not None:
        return [_volume_as_points(geometry, geometry.volume, table, store, warnings)]
    mesh = geometry.mesh
    passes = None if mesh is None else passing(mesh, table)
    if mesh is None or passes is None:
        return [geometry]
    key = Key(Kind.SPLIT_BY_MATERIAL, geometry.key, digest(mesh, table), other=passes.tobytes())
    opaque, translucent = store.lookup(key, lambda: split_translucent(mesh, table))
    found = [] if opaque is None else [replace(geometry, key=opaque.key, mesh=opaque)]
    if translucent is not None:
        found.append(replace(geometry, key=translucent.key, mesh=translucent, primitive="POINTS"))
    return found or [replace(geometry, key=f"{geometry.key} of none", mesh=None)]


def is_translucent(geometry: Geometry, table: MaterialTable) -> bool:
    """Tells whether a geometry of a scene that `separate_translucent` returned is translucent."""
    if geometry.cloud is not None:
        return geometry.cloud.opacity is not None or geometry.cloud.extinction is not None
    return geometry.mesh is not None and passing(geometry.mesh, table) is not None


def _volume_as_points(
    geometry: Geometry, volume: Volume, table: MaterialTable, store: Store, warnings: list[str]
) -> Geometry:
    """Returns a geometry whose volume is replaced by its voxels as points."""
    medium = table.media[volume.material] if volume.material < len(table.media) else None
    key = f"{geometry.key} as {_digest(medium, volume.transfer, geometry.extinction, geometry.spacing)}"

    def make() -> _VolumePoints:
        made, cells, found = voxels.volume_splats(volume, medium, geometry.extinction, geometry.spacing)
        # Transforms can take voxels out of the range of float32.
        cloud, dropped = valid_points(made)
        found += [f"{geometry.name}: {dropped} points that are not finite were left out"] if dropped else []
        return _VolumePoints(cloud, None if dropped else cells, found)

    points = store.lookup(Key(Kind.VOXELS, key), make)
    warnings += points.warnings
    lattice = f"{volume.key} {geometry.spacing}"
    return replace(geometry, key=key, volume=None, cloud=points.cloud, lattice=lattice, cells=points.cells)


class _VolumePoints:
    """The points of a volume and the warnings of making them, as the store keeps them."""

    def __init__(self, cloud: PointCloud, cells: np.ndarray | None, warnings: list[str]) -> None:
        self.cloud, self.cells, self.warnings = cloud, cells, warnings
        self.nbytes = cloud.nbytes + (0 if cells is None else cells.nbytes)


def _digest(*things: Any) -> str:
    """Returns a digest of numbers and of dataclasses that hold numbers, names and arrays."""
    hasher = hashlib.blake2b(digest_size=16)
    for thing in things:
        values = (
            [thing] if not hasattr(thing, "__dataclass_fields__") else [getattr(thing, f.name) for f in fields(thing)]
        )
        for value in values:
            hasher.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
            hasher.update(b"|")
    return hasher.hexdigest()


def with_repeated(instances: Instances, rows: np.ndarray, geometry: np.ndarray) -> Instances:
    """Returns the instances, followed by copies of `rows` (R,) with the geometry rows `geometry` (R,)."""

    def extended(array: np.ndarray | None) -> np.ndarray | None:
        return None if array is None else np.concatenate([array, array[rows]])

    names = instances.names
    return Instances(
        np.concatenate([instances.geometry, geometry]).astype(np.int32),
        np.concatenate([instances.world_from_object, instances.world_from_object[rows]]),
        previous=extended(instances.previous),
        pass_index=extended(instances.pass_index),
        holdout=extended(instances.holdout),
        casts=extended(instances.casts),
        seen=extended(instances.seen),
        scatters=extended(instances.scatters),
        mirrored=extended(instances.mirrored),
        matte=extended(instances.matte),
        object_hash=extended(instances.object_hash),
        names=(*names, *(names[row] for row in rows)) if names else (),
        objects={name: np.concatenate([values, values[rows]]) for name, values in instances.objects.items()},
    )
