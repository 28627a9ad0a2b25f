"""Planes through neighbourhoods of points, which outliers do not turn (Hoppe et al. 1992; reweighted least squares).

All work on columns: neighbours along the first axis, points along the last.
"""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ...numeric.vectors import cross, dot

PASSES = 1  # of reweighting
RIM = 1.3  # radius at which a neighbour's weight by distance becomes zero, in distances of the farthest
MEDIAN_SIGMA = 1.4826  # standard deviation of a normal distribution over the median of absolute values
OUTLIER = 2.0  # standard deviations of the residuals at which a neighbour's weight is halved
EXACT = 1e-3  # residuals below this share of the neighbourhood's radius are as good as none
TINY = 1e-30


@record
class Planes:
    """Planes of n points, each fitted to its k neighbours and itself."""

    normal: np.ndarray  # (3, n) float32, unit
    weight: np.ndarray  # (k, n) float32 in [0, 1]: how well each neighbour fits, 0 where there is none
    thickness: np.ndarray  # (n,) float32: smallest over middle eigenvalue of the covariance of all neighbours
    breadth: np.ndarray  # (n,) float32: middle over largest
    height: np.ndarray  # (n,) float32: of the plane above its point, along the normal


def fit_planes(offset: np.ndarray, squared: np.ndarray) -> Planes:
    """Fits a plane to each neighbourhood: offsets (3, k, n) float32 of the neighbours from their points and the squares
    of their lengths (k, n), infinite where there is no neighbour."""
    there = np.isfinite(squared)
    reach = np.where(there, squared, 0).max(axis=0)
    inverse = 1 / np.sqrt(np.maximum(reach, np.float32(TINY)))
    offset = np.where(there, offset * inverse, 0)
    near = np.square(np.maximum(1 - np.where(there, squared, 0) * (inverse * inverse / RIM**2), 0))
    near = np.where(there, near, 0).astype(np.float32)
    fits = there.astype(np.float32)
    for i in range(PASSES + 1):
        normal, values, centre = _plane(offset, near * fits)
        if i == 0:
            smallest, middle, largest = values
        if i == PASSES:
            break
        residual = np.abs(dot(normal[:, None], offset) - dot(normal, centre))
        sigma = MEDIAN_SIGMA * _median(residual, there)
        fits = 1 / (1 + np.square(residual / (OUTLIER * np.maximum(sigma, EXACT))))
        fits = np.where(there, np.square(fits), 0)
    return Planes(
        normal.astype(np.float32),
        fits.astype(np.float32),
        np.clip(smallest / np.maximum(middle, TINY), 0, 1).astype(np.float32),
        np.clip(middle / np.maximum(largest, TINY), 0, 1).astype(np.float32),
        (dot(normal, centre) / inverse).astype(np.float32),
    )


def _median(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """The lower median over the first axis of those values (k, n) that are there; infinite where none is."""
    if there.all():
        middle = (len(values) - 1) // 2
        return np.sort(values.T, axis=1)[:, middle]  # rows so short are sorted faster than partitioned
    at = np.maximum(there.sum(axis=0) - 1, 0) // 2
    return np.take_along_axis(np.sort(np.where(there, values, np.inf), axis=0), at[None], axis=0)[0]


def _plane(offset: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit normals (3, n), eigenvalues (3, n), rising, and centroids (3, n) of weighted neighbours and their points,
    which lie at the origin with the weight 1; float64."""
    total = 1 + weight.sum(axis=0)
    x, y, z = weighted = weight * offset
    centre = weighted.sum(axis=1) / total
    products = ((x, 0), (x, 1), (x, 2), (y, 1), (y, 2), (z, 2))
    moments = [(a * offset[axis]).sum(axis=0) for a, axis in products]
    centre = centre.astype(np.float64)
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    covariance = np.stack([m / total - centre[i] * centre[j] for m, (i, j) in zip(moments, pairs, strict=True)])
    values = eigenvalues(covariance)
    return smallest_eigenvector(covariance, values), values, centre


def eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """Eigenvalues (3, n), rising, of symmetric matrices (6, n) float64, xx, xy, xz, yy, yz, zz: the roots of the
    characteristic cubic in trigonometric form (Smith 1961)."""
    xx, xy, xz, yy, yz, zz = matrix
    middle = (xx + yy + zz) / 3
    xx, yy, zz = xx - middle, yy - middle, zz - middle
    spread = np.sqrt((xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    half = 0.5 * (xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))
    angle = np.arccos(np.clip(half / np.maximum(spread**3, 1e-300), -1, 1)) / 3
    largest = middle + 2 * spread * np.cos(angle)
    smallest = middle + 2 * spread * np.cos(angle + 2 * np.pi / 3)
    return np.stack([smallest, 3 * middle - largest - smallest, largest])


def smallest_eigenvector(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Unit eigenvectors (3, n) of the smallest of the eigenvalues (3, n) of matrices as in `eigenvalues`.

    The longest cross product of two rows of A - λ. Where the two smallest eigenvalues coincide, any vector
    perpendicular to the third; where all do, (0, 0, 1).
    """
    xx, xy, xz, yy, yz, zz = matrix
    least = values[0]
    rows = np.stack([[xx - least, xy, xz], [xy, yy - least, yz], [xz, yz, zz - least]])
    products = np.stack([cross(rows[0], rows[1]), cross(rows[1], rows[2]), cross(rows[2], rows[0])])
    length = (products * products).sum(axis=1)
    best = length.argmax(axis=0)
    lane = np.arange(matrix.shape[1])
    vector, length = products[best, :, lane].T, np.sqrt(length[best, lane])
    size = np.abs(matrix).max(axis=0)
    alike = ~(length > 1e-12 * size * size)
    if alike.any():
        # The longest row lies along the axis of the largest eigenvalue.
        along = rows[:, :, alike]
        square = (along * along).sum(axis=1)
        major = along[square.argmax(axis=0), :, np.arange(along.shape[2])].T
        helper = np.eye(3)[np.abs(major).argmin(axis=0)].T
        other = cross(major, helper)
        norm = np.sqrt(dot(other, other))
        vector[:, alike] = np.where(norm > 0, other / np.maximum(norm, 1e-300), np.array([[0.0], [0.0], [1.0]]))
        length[alike] = 1
    return vector / np.maximum(length, 1e-300)
