"""The painter's splats in float64: the twin of shaders/translucent/light.frag for fuzzy splats and of their blending.

core/splat/painter.py has the formulas and their reasons.
"""

from __future__ import annotations

import math

import numpy as np

from pointsplat_addon.core.splat.kernel import POWER
from pointsplat_addon.core.splat.kernel import SUPPORT as RIM
from pointsplat_addon.core.splat.painter import DEPTH, SUPPORT

GAMMA = math.gamma(1 + 1 / POWER)  # integral of exp(-u^POWER) over u > 0
LOW_PASS, THINNEST = 0.04, 1e-4  # shaders/translucent/light.frag: pixels^2 of variance; of the sum of variances
LEAK = 1 / 16  # of what lies behind, that one side of a surface lets through at the corner of four cells


def depth(q: np.ndarray) -> np.ndarray:
    """Optical depth of a splat at squared distances q >= 0 from its centre, in half-axes."""
    return DEPTH * np.maximum(1 - q / SUPPORT, 0) ** POWER


def alpha(q: np.ndarray) -> np.ndarray:
    """Opacity of a splat at squared distances q >= 0 from its centre, in half-axes."""
    return -np.expm1(-depth(q))


def hidden_share(depth: float | np.ndarray) -> float | np.ndarray:
    """The area that a splat hides over that of the ellipse at its rim, for the optical depth of its centre.

    Within 0.004 for depths of 3 and more.
    """
    return 1 - GAMMA * depth**-0.25


def depth_for_share(share: np.ndarray) -> np.ndarray:
    """Optical depth of the centre of a splat that hides `share` (0 to 1) of what one of DEPTH hides, within 3.5 %.

    The inverse of `hidden_share`, with the right slope at 0 and value at 1.
    """
    most = hidden_share(DEPTH)
    return (GAMMA / (1 - most * share)) ** 4 - GAMMA**4 * (1 - share) ** ((5 / GAMMA**4 - 4) * most)


def weights(
    pixels: np.ndarray, centre: np.ndarray, moments: np.ndarray, samples: int = 1, disconnected: bool = False
) -> np.ndarray:
    """The weight (P, N) of each splat in the colour at the positions `pixels` (P, 2), for splats given back to front.

    `centre` (N, 2) in pixels; `moments` (N, 2, 2): a a^T + b b^T of the conjugate half-axes a, b, in pixels^2. They are
    widened so that splats between the `samples` of a pixel are not missed, and their optical depth falls by as much;
    `disconnected` splats hide as much as if they were not widened. 1 minus the sum of a row is the weight of what lies
    behind all splats.
    """
    trace = np.trace(moments, axis1=1, axis2=2)[:, None, None]
    low_pass = np.maximum(LOW_PASS / samples**2 * RIM / SUPPORT, THINNEST * trace)
    wide = moments + low_pass * np.eye(2)
    thin = np.sqrt(np.maximum(np.linalg.det(moments), 0) / np.linalg.det(wide))
    offset = pixels[:, None] - centre
    q = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(wide), offset)
    thin = depth_for_share(thin) / DEPTH if disconnected else thin
    covers = -np.expm1(-thin * depth(q))
    before = np.cumprod(1 - covers[:, ::-1], axis=1)[:, ::-1]
    return covers * np.concatenate([before[:, 1:], np.ones((len(pixels), 1))], axis=1)
