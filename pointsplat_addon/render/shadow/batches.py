"""Turns shadow casters into splats and strand segments in world space, from which shadow tables are built."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...core.lod.hierarchy import build
from ...core.lod.levels import make_levels
from ...core.scene.bounds import box_corners
from ...core.scene.cloud import PointCloud
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Scene
from ...core.shadow import builder
from ...core.shadow.captured.casters import captured_casters
from ...core.shadow.samples import caster_clouds, mesh_is_foliage
from ...core.shadow.strand_casters import StrandSegments, cut_strands
from ...core.surface.appearance import hiding
from ..cache.keys import Key, Kind
from ..cache.store import Store
from ..prepare.layers import MANY_INSTANCES
from ..prepare.point_sets import coherent_with_foliage
from .casting import CastingGeometry, cached_bounding_box, cached_mesh_extents, cached_strands, transmission_digests
from .spacing import MAX_SAMPLES

MAX_POINTS_WITHOUT_NODES = 1 << 22  # of all instances of one mesh: if there are more, nodes replace them


def box_corner_casters(caster: CastingGeometry, store: Store) -> builder.Casters:
    """Returns the corners of the bounding boxes of all instances, in world space, as casters without size."""
    corners = box_corners(*cached_bounding_box(caster.geometry, store))
    world = np.einsum("iab,nb->ina", caster.matrices[:, :3, :3], corners) + caster.matrices[:, None, :3, 3]
    world = world.reshape(-1, 3)
    middle = world.mean(axis=0)
    return builder.Casters("OPAQUE", middle, (world - middle).astype(np.float32), np.zeros(len(world), np.float32))


def strand_segments(casters: list[CastingGeometry], spacing: list[float], store: Store) -> list[StrandSegments]:
    """Returns the segments of all strands that cast, in world space, at most as long as `spacing` of their caster."""
    return [
        cut_strands(cached_strands(caster.geometry, store), matrix, length)
        for caster, length in zip(casters, spacing, strict=True)
        if caster.geometry.strands is not None and length > 0
        for matrix in caster.matrices
    ]


def splat_batches(
    scene: Scene, casters: list[CastingGeometry], spacing: list[float], store: Store, check: Callable[[], None]
) -> list[builder.Casters]:
    """Returns the splats of all clouds, captured ones and meshes that cast, in world space.

    `spacing`: of the samples of each caster, object units; 0: a mesh does not cast. `check` may raise to stop.
    """
    found = []
    for caster, length, transmits in zip(casters, spacing, transmission_digests(scene, casters), strict=True):
        check()
        cloud, mesh, captured = caster.geometry.cloud, caster.geometry.mesh, caster.geometry.captured
        if captured is not None:
            found += [captured_casters(captured, matrix) for matrix in caster.matrices]
        clouds = []
        if cloud is not None:
            clouds = [
                store.lookup(
                    Key(Kind.COHERENT_POINTS, caster.geometry.key), lambda cloud=cloud: coherent_with_foliage(cloud)
                )
            ]
        if mesh is not None and length > 0:
            clouds = _mesh_samples(scene, caster.geometry, mesh, transmits, length, store)
        for cloud in clouds:
            if len(cloud) * len(caster.matrices) > MAX_POINTS_WITHOUT_NODES and _can_use_nodes(cloud, caster):
                key = Key(Kind.CASTER_NODES, caster.geometry.key, transmits, spacing=length, other=len(caster.matrices))
                coarse = store.lookup(
                    key, lambda cloud=cloud, caster=caster: _coarse_nodes(cloud, len(caster.matrices))
                )
                found.append(builder.casters(_instances_in_world(coarse, caster.matrices), np.eye(4)))
            elif len(cloud):
                found += [builder.casters(cloud, matrix) for matrix in caster.matrices]
    return found


def _can_use_nodes(cloud: PointCloud, caster: CastingGeometry) -> bool:
    """Tells whether a cloud is an opaque surface with so many instances that nodes may replace its points."""
    surface = cloud.opacity is None and cloud.extinction is None and cloud.normal is not None
    return surface and cloud.radii is not None and len(caster.matrices) >= MANY_INSTANCES


def _coarse_nodes(cloud: PointCloud, instances: int) -> PointCloud:
    """Returns the finest level of nodes of which all instances together have at most MAX_SAMPLES; the cloud itself
    if it has no levels."""
    levels = make_levels(build(cloud))
    if levels is None:
        return cloud
    fits = np.flatnonzero(levels.count * instances <= MAX_SAMPLES)
    level = int(fits[-1]) if len(fits) else 0
    first = int(levels.first[level])
    return levels.cloud.take(np.arange(first, first + int(levels.count[level])))


def _instances_in_world(cloud: PointCloud, matrices: np.ndarray) -> PointCloud:
    """Returns the splats of all instances, (I, 4, 4) world from object, as one cloud in world space.

    Radii are exact for uniform scales only.
    """
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


def _mesh_samples(
    scene: Scene, geometry: Geometry, mesh: Mesh, transmits: str, spacing: float, store: Store
) -> tuple[PointCloud, ...]:
    """Returns clouds of samples of a mesh at `spacing`, in object units, independent of any view."""
    key = Key(Kind.CASTER_SAMPLES, geometry.key, transmits, spacing=spacing)
    shape = cached_mesh_extents(geometry, mesh, store)

    def make() -> tuple[PointCloud, ...]:
        is_foliage = store.lookup(
            Key(Kind.IS_FOLIAGE, geometry.key), lambda: mesh_is_foliage(mesh, shape)
        )  # as render/prepare/meshes/points.py keeps it
        return tuple(caster_clouds(mesh, shape, spacing, hiding(scene.materials), is_foliage))

    return store.lookup(key, make)
