"""The kernel of translucent splats: how their optical depth falls from the middle of the picture to the rim.

A Gaussian would be the projection of what is Gaussian in space, but it never ends, and lattices of Gaussians are even
only where these are wide. (1 - q / SUPPORT)^POWER with q the squared Mahalanobis distance has the same second moments,
ends at 3.5 standard deviations, and adds up to within 0.4 % on a lattice, in any direction that it is seen from, with a
standard deviation of only EVEN of its edge. Gaussians that are as even (0.6, cut off at 3) cover 1.7 times as many
pixels and blur 1.5 times as far. shaders/lib/splat/kernel.glsl is the same.

Points may choose another shape by number, of the same integral: what their splats weigh is the same.
"""

from __future__ import annotations

import math

import numpy as np

POWER = 4
SUPPORT = 2 * (POWER + 2)  # squared Mahalanobis distance of the rim: unit variance along each axis
PEAK = (POWER + 1) / (POWER + 2)  # the middle's value over that of a Gaussian of the same moments and integral
EVEN_SPACING = 1.4 / math.sqrt(
    SUPPORT
)  # standard deviation over the edge of the lattice on which kernels add up evenly


def kernel(q: np.ndarray) -> np.ndarray:
    """Values over that of a whole Gaussian's middle, 1 / (2 pi sqrt(det)), at squared Mahalanobis distances q >= 0."""
    return PEAK * np.maximum(1 - q / SUPPORT, 0) ** POWER


STEPS = 64  # values of a profile, evenly over q in [0, SUPPORT]
MASS = PEAK * SUPPORT / (POWER + 1)  # integral of a profile over q: 2, as that of a Gaussian


def _profiles() -> np.ndarray:
    """(K, STEPS) float32; see PROFILES."""
    q = np.linspace(0, SUPPORT, STEPS)
    share = np.sqrt(q / SUPPORT)  # of the rim's radius
    rim = np.clip((1 - share) / 0.25, 0, 1)
    disk = rim * rim * (3 - 2 * rim)
    ring = np.maximum(1 - ((share - 0.7) / 0.25) ** 2, 0) ** 2
    spark = np.exp(-2 * q) * (1 - q / SUPPORT)  # half the standard deviation
    rows = np.stack([kernel(q), disk, ring, spark])
    integral = (rows.sum(axis=1) - (rows[:, 0] + rows[:, -1]) / 2) * q[1]
    return (rows * (MASS / integral)[:, None]).astype(np.float32)


# Kernels to choose from, in the units of `kernel`, linear between the steps and 0 at the rim: the one above, an even
# disk with a soft rim, a ring, and a spark that is bright in the middle.
PROFILES = _profiles()
