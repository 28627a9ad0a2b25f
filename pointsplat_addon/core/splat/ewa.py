"""The kernel of EWA splatting, in float64: what shaders/lib/splat/ewa.glsl is measured against.

A splat is an elliptical Gaussian. Its resampling kernel on the screen is again one, with the covariance

    J V J^T + v I                                                            (Zwicker et al. 2001, equation 8)

V: the splat's own, of a uniform disk of radius r: r^2 / 4 along its plane, nothing across. J: the Jacobian of the
perspective projection at the splat's centre, in pixels. v: the low-pass of a pixel.

Kernels end at the squared Mahalanobis distance CUTOFF = r^2, which leaves 1 - exp(-c), c = r^2 / 2, of a Gaussian's
mass; they are divided by that. Each is scaled so that its sum over all pixels is the number of pixels that the splat
stands for, and their sum over a surface without gaps is one: how much of each pixel the surface covers.
"""

from __future__ import annotations

import numpy as np

CUTOFF = 5.0
KEPT_MASS = 1 - np.exp(-CUTOFF / 2)
# Of its ellipse's area a splat stands for the cell that the ellipse goes around: between 1 / pi, half a rectangle, and
# 2 / pi, a rectangle (core/surface/sampling.py); the mean of the two.
CELL_SHARE = np.sqrt(2) / np.pi
WITHIN = np.sqrt(2)  # where an ellipse holds the pixel's centre the lower sums count as much as the higher ones
CENTRES = 4  # samples of a pixel from which on what no ellipse holds shows nothing
LEAST_LOW_PASS = 4e-4  # pixels^2, which keeps covariances invertible


def low_pass(samples: int) -> float:
    """v in pixels^2, for a picture whose pixels are means of `samples`.

    With one sample a pixel, all that a picture cannot show must be taken out before: the unit Gaussian of Zwicker et
    al. leaves exp(-2 pi^2 v) = 3e-9 of a pattern as fine as the pixels, which would else show as a constant, and 0.7 %
    at half that frequency. N samples a pixel are sqrt(N) times as dense along each axis, for which 1 / N would be as
    much. They are no grid, though: what they alias is spread, and the filter that they are distributed by takes out
    most of it when they are averaged (render/frame/sample_positions.py). N^-1.5 blurs less than that costs.
    """
    return max(samples**-1.5, LEAST_LOW_PASS)


def centres_decide(samples: int) -> bool:
    """Whether samples are so many that the mean of those that an ellipse holds is an edge without steps.

    What lies beside a sample is then left out: surfaces end where they end, and those in front do not bleed.
    """
    return samples >= CENTRES


def covariance(
    centre: np.ndarray, a: np.ndarray, b: np.ndarray, focal: tuple[float, float], perspective: bool
) -> np.ndarray:
    """(N, 2, 2) J V J^T in pixels^2 of ellipses with centres (N, 3) and conjugate half-axes a, b (N, 3), view space."""
    depth = -centre[:, 2]
    scale = 1 / depth if perspective else np.ones(len(centre))
    slope = centre[:, :2] / depth[:, None] if perspective else np.zeros((len(centre), 2))

    def project(axis: np.ndarray) -> np.ndarray:
        return np.asarray(focal) * scale[:, None] * (axis[:, :2] + slope * axis[:, 2:])

    p, q = project(a), project(b)
    return (p[:, :, None] * p[:, None, :] + q[:, :, None] * q[:, None, :]) / 4


def weights(pixels: np.ndarray, centre: np.ndarray, moments: np.ndarray, v: float) -> np.ndarray:
    """(P, N) kernels of splats with centres (N, 2) in pixels and J V J^T = moments (N, 2, 2), at places (P, 2)."""
    wide = moments + v * np.eye(2)
    offset = pixels[:, None] - centre
    q = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(wide), offset)
    covered = 4 * np.pi * np.sqrt(np.maximum(np.linalg.det(moments), 0)) * CELL_SHARE
    peak = covered / (2 * np.pi * np.sqrt(np.linalg.det(wide))) / KEPT_MASS
    return np.where(q <= CUTOFF, peak * np.exp(-q / 2), 0.0)


def coverage(total: np.ndarray, within: np.ndarray) -> np.ndarray:
    """(P,) how much of each pixel is covered at the edge of a surface, for the sums of its kernels (P,). `within`: (P,)
    bool, an ellipse holds the pixel's centre."""
    return np.minimum(np.where(within, WITHIN * total, total), 1.0)
