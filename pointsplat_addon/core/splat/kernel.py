"""Kernels of translucent splats: how the optical depth of a splat falls from its centre in the image to the rim.

The projection of a Gaussian would be a Gaussian, but its support is unbounded, and lattices of Gaussians are even only
where these are wide. (1 - q / SUPPORT)^POWER, with q the squared Mahalanobis distance, has the same second moments,
ends at 3.5 standard deviations, and adds up to within 0.4 % on a lattice seen from any direction, with a standard
deviation of only EVEN_SPACING of the lattice's edge. Gaussians that are as even (0.6, cut off at 3) cover 1.7 times as
many pixels and blur 1.5 times as far. shaders/lib/splat/kernel.glsl is its twin.

A point may choose another profile (PROFILES) with the same integral, so that its optical mass stays what it is.
"""

from __future__ import annotations

import math

import numpy as np

POWER = 4
SUPPORT = 2 * (POWER + 2)  # squared Mahalanobis distance of the rim: unit variance along each axis
PEAK = (POWER + 1) / (POWER + 2)  # the middle's value over that of a Gaussian of the same moments and integral
# Standard deviation over the edge of the lattice on which kernels add up evenly
EVEN_SPACING = 1.4 / math.sqrt(SUPPORT)


def kernel(q: np.ndarray) -> np.ndarray:
    """The kernel at squared Mahalanobis distances q >= 0, over the peak 1 / (2 pi sqrt(det)) of a Gaussian of the same
    moments and integral."""
    return PEAK * np.maximum(1 - q / SUPPORT, 0) ** POWER


STEPS = 64  # values of a profile, evenly over q in [0, SUPPORT]
MASS = PEAK * SUPPORT / (POWER + 1)  # integral of a profile over q: 2, as that of a Gaussian


def _profiles() -> np.ndarray:
    """The table PROFILES."""
    q = np.linspace(0, SUPPORT, STEPS)
    share = np.sqrt(q / SUPPORT)  # of the rim's radius
    rim = np.clip((1 - share) / 0.25, 0, 1)
    disk = rim * rim * (3 - 2 * rim)
    ring = np.maximum(1 - ((share - 0.7) / 0.25) ** 2, 0) ** 2
    spark = np.exp(-2 * q) * (1 - q / SUPPORT)  # half the standard deviation
    rows = np.stack([kernel(q), disk, ring, spark])
    integral = (rows.sum(axis=1) - (rows[:, 0] + rows[:, -1]) / 2) * q[1]
    return (rows * (MASS / integral)[:, None]).astype(np.float32)


# Profiles that a point may have, (K, STEPS) float32 in the units of `kernel`, linear between the steps and 0 at the
# rim: the kernel above, an even disk with a soft rim, a ring, and a spark that is bright in the middle.
PROFILES = _profiles()
