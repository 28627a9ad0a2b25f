"""Normals of a volume from the negated 3D Sobel gradient of a grid."""

from __future__ import annotations

import numpy as np

from ..scene.volume import Volume
from .lattice import ROWS, index_bounds, lattice_keys


def gradient_normals(volume: Volume, grid: str) -> np.ndarray:
    """(N, 3) float32 unit vectors in object space towards lower values of a grid: negated 3D Sobel gradients.

    Voxels that are not active hold 0. Where the gradient vanishes, so does the normal.
    """
    index, value = volume.index, volume.grids[grid]
    if len(index) == 0:
        return np.empty((0, 3), np.float32)
    value = np.where(np.isfinite(value), value, np.float32(0))
    value = value if value.ndim == 1 else value.mean(axis=1)
    low, extent = index_bounds(index, margin=1)
    key = lattice_keys(index, low, extent)
    back = None
    if (key[1:] <= key[:-1]).any():
        order = np.argsort(key)
        key, value, back = key[order], value[order], order
    result = np.empty((len(index), 3), np.float32)
    gradient = np.empty((len(index), 3))
    for i in range(0, len(index), ROWS):
        gradient[i : i + ROWS] = _sobel_gradient(key, value, slice(i, i + ROWS), extent)
    # A gradient is a covector: g_object = A^-T g_index.
    with np.errstate(all="ignore"):
        linear = volume.object_from_index[:3, :3] / np.abs(volume.object_from_index[:3, :3]).max()
    found = normalise(-gradient @ np.linalg.pinv(linear))
    if back is None:
        return found
    result[back] = found
    return result


def _sobel_gradient(key: np.ndarray, value: np.ndarray, part: slice, extent: np.ndarray) -> np.ndarray:
    """(n, 3) float64 gradient of rows `part` in index space: central differences smoothed by 1 2 1 across.

    `key` is sorted, so that neighbours along z lie next to each other and only the nine columns are searched for.
    """
    here = key[part]
    last = len(key) - 1
    gradient = np.zeros((len(here), 3))
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            wanted = here + (dx * extent[1] + dy) * extent[2]
            at = np.searchsorted(key, wanted - 1)
            column = []
            for dz in (-1, 0, 1):
                near = np.minimum(at, last)
                there = key[near] == wanted + dz
                column.append(np.where(there, value[near], 0).astype(np.float64))
                at = at + there
            below, middle, above = column
            across = below + 2 * middle + above
            wx, wy = 2 - abs(dx), 2 - abs(dy)
            gradient[:, 0] += dx * wy * across
            gradient[:, 1] += dy * wx * across
            gradient[:, 2] += wx * wy * (above - below)
    return gradient / 32


def normalise(vectors: np.ndarray) -> np.ndarray:
    """Normalised rows, float32; zero vectors stay zero."""
    scale = np.abs(vectors).max(axis=1, keepdims=True)
    vectors = np.divide(vectors, scale, out=np.zeros_like(vectors), where=scale > 0)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0).astype(np.float32)
