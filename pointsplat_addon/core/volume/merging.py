"""Blocks of voxels merged into one voxel each, at its centre of mass."""

from __future__ import annotations

import numpy as np

from .lattice import group_equal_rows
from .normals import normalise
from .optics import Optics


def merge_level(matrix: np.ndarray, spacing: float) -> int:
    """The number of times that voxels may be merged by twos along each axis while they are no longer than `spacing`."""
    edge = float(np.linalg.norm(matrix[:3, :3], axis=0).max())
    if not (spacing > 0 and edge > 0):
        return 0
    return int(np.clip(np.floor(np.log2(spacing / edge) + 1e-6), 0, 20))


def merge_blocks(
    index: np.ndarray, found: Optics, shading: np.ndarray | None, level: int
) -> tuple[np.ndarray, np.ndarray, Optics, np.ndarray | None]:
    """Merges blocks of 2^level voxels to a side: (K, 3) float64 indices of centres of mass, (K, 3) int indices of the
    blocks, mean optics, and mean normals.

    Means are over the block's volume, so that mass stays. Blocks lie on a lattice through index 0 whatever is active,
    and do not swim in animations.
    """
    blocks = index >> level
    order, first = group_equal_rows(blocks)
    voxels = 8.0**level
    inside = np.diff(np.append(first, len(index)))

    def total(array: np.ndarray) -> np.ndarray:
        return np.add.reduceat(array[order], first, axis=0, dtype=np.float64)

    depth = found.extinction if found.extinction.ndim == 1 else found.extinction.mean(axis=1)
    weight = depth if found.emission is None else depth + found.emission.mean(axis=1)
    # Voxels without extinction and emission still have a position.
    weight = np.maximum(weight, max(float(weight.max()), 1e-30) * np.float32(1e-12)).astype(np.float64)
    mass = total(weight)[:, None]
    scattering = found.albedo * (found.extinction if found.extinction.ndim == 2 else depth[:, None])
    extinction = total(found.extinction)
    across = extinction if extinction.ndim == 2 else extinction[:, None]
    albedo = np.divide(total(scattering), across, out=np.zeros((len(first), 3)), where=across > 0)
    merged = Optics(
        extinction=(extinction / voxels).astype(np.float32),
        albedo=albedo.astype(np.float32),
        emission=None if found.emission is None else (total(found.emission) / voxels).astype(np.float32),
        value=(total(found.value) / inside).astype(np.float32),
    )
    if shading is not None:
        shading = normalise(total(shading * weight[:, None].astype(np.float32)))
    # An index is a voxel's centre in the finer lattice; so the finer matrix also gives the position of the merged
    # splat.
    return total(index * weight[:, None]) / mass, blocks[order[first]], merged, shading
