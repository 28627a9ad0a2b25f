"""Bounds and checks of small matrices."""

from __future__ import annotations

import math

import numpy as np

from .vectors import blocks, dot

ALIKE_SCALES = 1e-5  # relative difference of the squares of scales that makes no visible ellipsoid of a ball
HALF_DIGITS = 1.5e-8  # the root of what float64 resolves


def largest_singular_value(matrix: np.ndarray) -> np.ndarray:
    """Largest singular values (I,) of matrices (I, 3, 3), never too small and too large by at most 1e-8 of themselves.

    The largest root of the characteristic cubic of A^T A in trigonometric form (Smith 1961). Where two roots nearly
    coincide, their angle is known to half the digits only; that error, times the roots' distance from their mean, is
    added as a margin. Uniform scales need none.
    """
    found = np.empty(len(matrix))
    for some in blocks(len(matrix)):
        found[some] = _largest_singular_value(np.ascontiguousarray(matrix[some].transpose(1, 2, 0)))
    return found


def _largest_singular_value(a: np.ndarray) -> np.ndarray:
    """Largest singular values (n,) of matrices (3, 3, n), see above."""
    size = np.maximum(np.maximum.reduce(np.abs(a).reshape(9, -1)), np.finfo(float).tiny)
    x, y, z = (a / size).transpose(1, 0, 2)
    xx, yy, zz, xy, xz, yz = dot(x, x), dot(y, y), dot(z, z), dot(x, y), dot(x, z), dot(y, z)
    middle = (xx + yy + zz) / 3
    xx, yy, zz = xx - middle, yy - middle, zz - middle
    spread = np.sqrt((xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    cosine = np.clip(determinant / np.maximum(2 * spread**3, np.finfo(float).tiny), -1, 1)
    return size * np.sqrt(middle + 2 * spread * (np.cos(np.arccos(cosine) / 3) + HALF_DIGITS)) * (1 + 1e-15)


def all_finite(matrix: np.ndarray) -> np.ndarray:
    """(I,) bool: which of the matrices (I, n, m) hold neither a NaN nor an infinity."""
    numbers = math.prod(matrix.shape[1:])
    with np.errstate(invalid="ignore"):
        return np.asarray(matrix.reshape(-1, numbers) @ np.zeros(numbers) == 0)


def are_similarities(matrix: np.ndarray) -> bool:
    """Tells whether the linear parts of all matrices (I, 4, 4) keep angles, so that balls stay balls."""
    with np.errstate(all="ignore"):
        for some in blocks(len(matrix)):
            linear = matrix[some, :3, :3]
            gram = linear.swapaxes(1, 2) @ linear
            size = np.trace(gram, axis1=1, axis2=2)[:, None, None] / 3
            if not (np.abs(gram - size * np.eye(3)) <= ALIKE_SCALES * size).all():
                return False
    return True


def outer_product(a: np.ndarray) -> np.ndarray:
    """Outer products (6, n) of vectors (3, n) with themselves: xx, xy, xz, yy, yz, zz."""
    x, y, z = a
    return np.stack([x * x, x * y, x * z, y * y, y * z, z * z])


def principal_axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minor axis (3, n), major axis (3, n) and half-axes (3, n) (major, middle, minor) of covariances (6, n), float32.

    A half-axis is two standard deviations. Covariances are given as in `outer_product`.
    """
    matrix = covariance[[0, 1, 2, 1, 3, 4, 2, 4, 5]].T.reshape(-1, 3, 3)
    scale = np.maximum(np.abs(matrix).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    variance, vectors = np.linalg.eigh(matrix / scale)
    radii = 2 * np.sqrt(np.maximum(variance[:, ::-1], 0) * scale[:, :, 0])
    normal, axis = vectors[:, :, 0], vectors[:, :, 2]
    return normal.T.astype(np.float32), axis.T.astype(np.float32), radii.T.astype(np.float32)


def bilinear_form(matrix: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a^T M b, (n,), of vectors (3, n) and symmetric matrices (6, n) as in `outer_product`."""
    xx, xy, xz, yy, yz, zz = matrix
    return (
        a[0] * (xx * b[0] + xy * b[1] + xz * b[2])
        + a[1] * (xy * b[0] + yy * b[1] + yz * b[2])
        + a[2] * (xz * b[0] + yz * b[1] + zz * b[2])
    )
