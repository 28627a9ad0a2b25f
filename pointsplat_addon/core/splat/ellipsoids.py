"""Splats as ellipsoids: their frames and half-axes, their weight in averages, and their surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..numeric.vectors import basis
from ..scene.cloud import PointCloud


class SplatFrames(NamedTuple):
    """Principal axes of n splats; the third axis is normal x axis."""

    normal: np.ndarray  # (3, n) float64, unit
    axis: np.ndarray  # (3, n) float64, unit, perpendicular to normal: the major axis
    radii: np.ndarray  # (3, n) float64, half-axes in object units: along axis, along the third axis, along normal


def splat_weight(cloud: PointCloud, which: slice) -> np.ndarray:
    """How much each splat counts in averages: (n,) float64, positive.

    The area over pi (1 for points without extent) times the mean opacity; in media the volume over 4/3 pi.
    """
    weight = np.ones(len(cloud.position[which]))
    if cloud.extinction is not None and cloud.radii is not None:
        return np.maximum(np.prod(splat_frames(cloud, which).radii, axis=0), 1e-60)
    if cloud.radii is not None:
        r = cloud.radii[which].astype(np.float64)
        flat = cloud.axis is not None and r.shape[1] > 1
        weight = r[:, 0] * r[:, 1 if flat else 0]
    if cloud.opacity is not None:
        opacity = cloud.opacity[which]
        weight = weight * (opacity if opacity.ndim == 1 else opacity.mean(axis=1))
    # Splats without area or opacity still have a position: their weight only counts among their like.
    return np.maximum(weight, 1e-60)


def splat_frames(cloud: PointCloud, which: slice) -> SplatFrames:
    """Principal axes and half-axes of some splats of a cloud.

    Balls (no normals) get a fixed frame and three equal half-axes. Flat splats have no thickness, but in a medium
    they stand for a slab as thick as it is wide.
    """
    n = len(cloud.position[which])
    radii = np.zeros((3, n))
    given = cloud.radii[which].T if cloud.radii is not None else radii
    if cloud.normal is None:
        normal, axis = np.tile([[0.0], [0.0], [1.0]], n), np.tile([[1.0], [0.0], [0.0]], n)
        radii[:] = given[0]
        return SplatFrames(normal, axis, radii)
    normal = cloud.normal[which].T.astype(np.float64)
    if cloud.axis is None or len(given) < 2:
        axis = basis(normal)[0]
        radii[:2] = given[0]
    else:
        axis = cloud.axis[which].T.astype(np.float64)
        radii[: len(given)] = given
    balls = ~normal.any(axis=0)
    if balls.any():
        normal[2, balls], axis[:, balls] = 1, np.array([[1.0], [0.0], [0.0]])
        radii[:, balls] = given[0, balls]
    if cloud.extinction is not None and len(given) < 3:
        radii[2] = np.sqrt(radii[0] * radii[1])
    return SplatFrames(normal, axis, radii)


def half_surface(radii: np.ndarray) -> np.ndarray:
    """Half the surface of ellipsoids with half-axes (3, n): (n,) float64; for flat ones, their area.

    Thomsen's approximation, with the exponent that is exact for disks as well as for balls.
    """
    a, b, c = np.maximum(radii.astype(np.float64), 1e-30)
    power = np.log(3) / np.log(2)
    return 2 * np.pi * (((a * b) ** power + (a * c) ** power + (b * c) ** power) / 3) ** (1 / power)
