"""TODO: say what this module is."""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import basis
from ..scene.cloud import PointCloud


def splat_weight(cloud: PointCloud, which: slice) -> np.ndarray:
    """(n,) float64: area over pi (1 where points have no extent) times opacity, in media the volume over 4/3 pi: what a
    splat counts in averages."""
    weight = np.ones(len(cloud.position[which]))
    if cloud.extinction is not None and cloud.radii is not None:
        return np.maximum(np.prod(splat_frames(cloud, which)[2], axis=0), 1e-60)
    if cloud.radii is not None:
        r = cloud.radii[which].astype(np.float64)
        flat = cloud.axis is not None and r.shape[1] > 1
        weight = r[:, 0] * r[:, 1 if flat else 0]
    if cloud.opacity is not None:
        weight = weight * cloud.opacity[which]
    # Splats of no area or opacity still have a place: a weight that only counts among their like.
    return np.maximum(weight, 1e-60)


def splat_frames(cloud: PointCloud, which: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal, major axis and three half-axes of points, (3, n) float64 each; balls get a fixed frame, and flat splats
    of a medium stand for a slab as thick as it is wide."""
    n = len(cloud.position[which])
    radii = np.zeros((3, n))
    given = cloud.radii[which].T if cloud.radii is not None else radii
    if cloud.normal is None:
        normal, axis = np.tile([[0.0], [0.0], [1.0]], n), np.tile([[1.0], [0.0], [0.0]], n)
        radii[:] = given[0]
        return normal, axis, radii
    normal = cloud.normal[which].T.astype(np.float64)
    if cloud.axis is None or len(given) < 2:
        axis = basis(normal)[0]
        radii[:2] = given[0]
    else:
        axis = cloud.axis[which].T.astype(np.float64)
        radii[: len(given)] = given
    if cloud.extinction is not None and len(given) < 3:
        radii[2] = np.sqrt(radii[0] * radii[1])
    return normal, axis, radii


def half_surface(radii: np.ndarray) -> np.ndarray:
    """(n,) half the surface of ellipsoids of half-axes (3, n): the area of flat ones. Thomsen's approximation with the
    exponent that makes disks exact, as balls are anyway."""
    a, b, c = np.maximum(radii.astype(np.float64), 1e-30)
    power = np.log(3) / np.log(2)
    return 2 * np.pi * (((a * b) ** power + (a * c) ** power + (b * c) ** power) / 3) ** (1 / power)
