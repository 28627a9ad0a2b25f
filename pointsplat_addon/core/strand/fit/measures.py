"""Areas and normals of triangles, and sums over rows."""

from __future__ import annotations

import numpy as np


def sums_by_row(own: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, ...) sums of values (N, ...) that belong to rows `own` (N,)."""
    columns = values.reshape(len(own), int(np.prod(values.shape[1:]))).T
    return np.stack([np.bincount(own, c, count) for c in columns], axis=1).reshape(-1, *values.shape[1:])


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """(...) float64: areas of triangles (..., 3, 3)."""
    return 0.5 * np.linalg.norm(area_vectors(corners), axis=-1)


def area_vectors(corners: np.ndarray) -> np.ndarray:
    """(..., 3) normals of triangles (..., 3, 3), of twice their areas in length."""
    return np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])


def mean_normals(corners: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals of groups of triangles (n, k, 3, 3), weighted by area."""
    total = area_vectors(corners).sum(axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), [0.0, 0, 1])
