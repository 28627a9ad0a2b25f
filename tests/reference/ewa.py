"""The kernel of EWA splatting in float64: the twin of shaders/lib/splat/ewa.glsl.

A splat is an elliptical Gaussian. Its resampling kernel on the screen is a Gaussian again, with the covariance

    J V J^T + v I                                                            (Zwicker et al. 2001, equation 8)

V: the splat's own, of a uniform disk of radius r: r^2 / 4 along its plane, nothing across. J: the Jacobian of the
perspective projection at the splat's centre, in pixels. v: the low-pass of a pixel (core/splat/ewa.py).

Kernels end at the squared Mahalanobis distance CUTOFF = r^2, which leaves 1 - exp(-c), c = r^2 / 2, of a Gaussian's
mass; they are divided by that. Each is scaled so that its sum over all pixels is the number of pixels that the splat
stands for, and their sum over a surface without gaps is one: how much of each pixel the surface covers.
"""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.splat.ewa import CELL_SHARE

CUTOFF = 5.0
KEPT_MASS = 1 - np.exp(-CUTOFF / 2)
WITHIN = np.sqrt(2)  # where an ellipse holds the pixel's centre the lower sums count as much as the higher ones


def projected_covariance(
    centre: np.ndarray, a: np.ndarray, b: np.ndarray, focal: tuple[float, float], perspective: bool
) -> np.ndarray:
    """J V J^T (N, 2, 2) in pixels^2 of ellipses with centres (N, 3) and conjugate half-axes a, b (N, 3) in view
    space."""
    depth = -centre[:, 2]
    scale = 1 / depth if perspective else np.ones(len(centre))
    slope = centre[:, :2] / depth[:, None] if perspective else np.zeros((len(centre), 2))

    def project(axis: np.ndarray) -> np.ndarray:
        return np.asarray(focal) * scale[:, None] * (axis[:, :2] + slope * axis[:, 2:])

    p, q = project(a), project(b)
    return (p[:, :, None] * p[:, None, :] + q[:, :, None] * q[:, None, :]) / 4


def resampling_weights(pixels: np.ndarray, centre: np.ndarray, moments: np.ndarray, v: float) -> np.ndarray:
    """Resampling kernels (P, N) at positions (P, 2) of splats with centres (N, 2) in pixels, moments = J V J^T
    (N, 2, 2) and the low-pass variance v, pixels^2."""
    wide = moments + v * np.eye(2)
    offset = pixels[:, None] - centre
    q = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(wide), offset)
    covered = 4 * np.pi * np.sqrt(np.maximum(np.linalg.det(moments), 0)) * CELL_SHARE
    peak = covered / (2 * np.pi * np.sqrt(np.linalg.det(wide))) / KEPT_MASS
    return np.where(q <= CUTOFF, peak * np.exp(-q / 2), 0.0)


def coverage(total: np.ndarray, within: np.ndarray) -> np.ndarray:
    """How much of each pixel a surface covers: (P,), from the sums of its kernels (P,), at its edges as well.

    `within` (P,) bool: whether an ellipse holds the pixel's centre.
    """
    return np.minimum(np.where(within, WITHIN * total, total), 1.0)
