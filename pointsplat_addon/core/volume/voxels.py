"""Participating media as points: each active voxel becomes one splat.

A splat's `extinction` is the share that it alone contributes, spread over its own ellipsoid (radius 2 sigma): its
optical mass 4/3 pi a b c * extinction is that of the voxel, extinction times the voxel's volume. Overlapping splats of
neighbouring voxels then add up to the medium: a standard deviation of EVEN_SPACING voxel edges is just wide
enough that the lattice does not show.
"""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import column_ranges
from ..scene.cloud import PointCloud
from ..scene.volume import Medium, Volume
from ..splat.kernel import EVEN_SPACING
from .lattice import ROWS
from .merging import merge_blocks, merge_level
from .normals import gradient_normals
from .optics import Optics, any_channel, voxel_optics

VOXEL_SHARE = 1 / (4 / 3 * np.pi * (2 * EVEN_SPACING) ** 3)  # the volume of a voxel over that of its splat's ellipsoid
NEARLY_CUBIC = 1.03  # ratio of a voxel's principal lengths up to which its splat is a ball
MOST_EDGE_DEPTH = 1e6  # optical depth along a voxel's edge at which extinction is clamped


def volume_splats(
    volume: Volume, medium: Medium | None = None, extinction: float = 0.0, spacing: float = 0.0
) -> tuple[PointCloud, np.ndarray, list[str]]:
    """One splat for each voxel that has any effect, in object space; the lattice's cells that they stand for, (N, 3)
    int; and warnings that name the object.

    medium: what fills the volume where it has no transfer function; None is Blender's default, a Principled Volume.
    extinction: instead of the medium's (or the transfer function's) density; 0 takes theirs. spacing: distance of
    splats in object units; blocks of 2^k voxels to a side that are no longer than it become one splat of their mass.

    Under a transfer function all voxels become splats, whatever their opacity, and `shading_normal` holds
    `gradient_normals`.
    """
    found, warnings = voxel_optics(volume, medium or Medium(), extinction)
    index, matrix, shading = volume.index, volume.object_from_index, None
    if volume.transfer is None:
        seen = any_channel(found.extinction > 0)
        if found.emission is not None:
            seen |= any_channel(found.emission > 0)
    else:
        grid = volume.grids.get(volume.transfer.grid)
        shading = None if grid is None else gradient_normals(volume, volume.transfer.grid)
        seen = np.zeros(len(index), bool) if grid is None else any_channel(np.isfinite(grid))
    if not seen.all():
        index, found, shading = index[seen], _take(found, seen), None if shading is None else shading[seen]
    level, cells = merge_level(matrix, spacing), index
    if level > 0 and len(index):
        index, cells, found, shading = merge_blocks(index, found, shading, level)
    position, origin = _positions(index, matrix)
    normal, axis, radii = _splat_shape(matrix[:3, :3] * 2.0**level, len(index))
    share, edge = np.float32(VOXEL_SHARE), max(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))), 1e-30)
    cloud = PointCloud(
        position=position,
        origin=origin,
        normal=normal,
        axis=axis,
        radii=radii,
        color=found.albedo,
        emission=None if found.emission is None else found.emission * share,
        shading_normal=shading,
        extinction=np.minimum(found.extinction, np.float32(MOST_EDGE_DEPTH / edge)) * share,
        material=np.full(len(index), volume.material, np.uint16) if volume.material else None,
        value=found.value,
    )
    return cloud, cells, warnings


# Positions and shapes


def _positions(index: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) float32 relative to an origin (3,) float64, of indices (N, 3) in object space."""
    if len(index) == 0:
        return np.empty((0, 3), np.float32), matrix[:3, 3].copy()
    low, high = column_ranges(index)
    middle = np.round((low.astype(np.float64) + high) / 2)
    position = np.zeros((len(index), 3), np.float32)
    # Column by column, since few matrices turn: of 0 is nothing to be added.
    for i in range(0, len(index), ROWS):
        block = (index[i : i + ROWS] - middle).T.copy()
        for k, row in enumerate(matrix[:3, :3]):
            position[i : i + ROWS, k] = sum(share * block[j] for j, share in enumerate(row.tolist()) if share)
    return position, matrix[:3, :3] @ middle + matrix[:3, 3]


def _splat_shape(linear: np.ndarray, count: int) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray]:
    """Normal, axis (both None for balls) and half-axes of the Gaussian of `count` voxels under a linear map (3, 3).

    The map's left singular vectors and values are the principal axes; they hold shear, too.
    """
    axes, lengths, _ = np.linalg.svd(linear)
    radii = 2 * EVEN_SPACING * lengths
    if lengths[0] <= NEARLY_CUBIC * lengths[2]:
        return None, None, np.full((count, 1), np.cbrt(np.prod(radii)), np.float32)
    axis, normal = (np.tile(axes[:, k].astype(np.float32), (count, 1)) for k in (0, 2))
    return normal, axis, np.tile(radii.astype(np.float32), (count, 1))


def _take(found: Optics, which: np.ndarray) -> Optics:
    emission = None if found.emission is None else found.emission[which]
    return Optics(found.extinction[which], found.albedo[which], emission, found.value[which])


# The sparse lattice
