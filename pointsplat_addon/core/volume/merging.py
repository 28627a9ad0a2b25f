"""Blocks of voxels merged into one voxel each, at its centre of mass."""

from __future__ import annotations

import numpy as np

from .lattice import group_equal_rows
from .normals import normalise
from .optics import Optics


def merge_level(matrix: np.ndarray, spacing: float) -> int:
    """How often voxels may be merged two by two along each axis until they are no longer than `spacing`."""
    edge = float(np.linalg.norm(matrix[:3, :3], axis=0).max())
    if not (spacing > 0 and edge > 0):
        return 0
    return int(np.clip(np.floor(np.log2(spacing / edge) + 1e-6), 0, 20))


def merge_blocks(
    index: np.ndarray, found: Optics, shading: np.ndarray | None, level: int
) -> tuple[np.ndarray, Optics, np.ndarray | None]:
    """One voxel for each block of 2^level to a side: (K, 3) float64 indices at the centres of mass, mean optics.

    Means are over the block's volume, so that mass stays. Blocks lie on a lattice through index 0 whatever is active,
    and do not swim in animations.
    """
    order, first = group_equal_rows(index >> level)
    voxels = 8.0**level
    inside = np.diff(np.append(first, len(index)))

    def total(array: np.ndarray) -> np.ndarray:
        return np.add.reduceat(array[order], first, axis=0, dtype=np.float64)

    depth = found.extinction if found.extinction.ndim == 1 else found.extinction.mean(axis=1)
    weight = depth if found.emission is None else depth + found.emission.mean(axis=1)
    # Voxels of no optics still have a place.
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
    # An index is a voxel's centre in the finer lattice; the merged splat is placed by the finer matrix as well.
    return total(index * weight[:, None]) / mass, merged, shading
