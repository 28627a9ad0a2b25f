"""Fuzzy opaque splats, painted from back to front (Coconu and Hege 2002, section 5), in float64.

A splat is a fuzzy ellipse, blended over all that lies behind it. There is no depth test among splats, and nothing is
normalised.

In the paper alpha is a Gaussian that is 1/2 at half the threshold distance, the distance between splats that they are
still to cover (section 5.4). Here that is the diagonal of the cells that splats stand for, whose corners their
half-axes reach (core/sampling.py): alpha is 1/2 at the ellipse, and where four cells meet a surface lets 1/16 of what
lies behind it through, both sides of a closed one 1/256. A Gaussian of that width is 1/4 at twice the distance, so that
textures blur and outlines grow by half a splat; the kernel of what is translucent (core/kernel.py) ends. With
q = (distance / half-axis)^2,

    depth(q) = DEPTH (1 - q / SUPPORT)^POWER,    alpha(q) = 1 - exp(-depth(q)).

The nearer SUPPORT is to one, the harder is the rim, and the more do single samples alias; the farther, the more does
the middle let through. docs/techniques.md has the errors of both.
"""

from __future__ import annotations

import math

import numpy as np

from .kernel import POWER
from .kernel import SUPPORT as RIM

SUPPORT = 1.6  # q of the rim
DEPTH = math.log(2) / (1 - 1 / SUPPORT) ** POWER  # optical depth of the middle
LOW_PASS, THINNEST = 0.04, 1e-4  # shaders/translucent_light.frag: pixels^2 of variance; of the sum of variances
LEAK = 1 / 16  # of what lies behind, that one side of a surface lets through at the corner of four cells


def depth(q: np.ndarray) -> np.ndarray:
    """Optical depth of a splat at the squared distances q >= 0 from its middle, in half-axes."""
    return DEPTH * np.maximum(1 - q / SUPPORT, 0) ** POWER


def alpha(q: np.ndarray) -> np.ndarray:
    """How much a splat covers there."""
    return -np.expm1(-depth(q))


def weights(pixels: np.ndarray, centre: np.ndarray, moments: np.ndarray, samples: int = 1) -> np.ndarray:
    """(P, N) how much of each splat is seen at places (P, 2), of splats given back to front.

    `centre` (N, 2) in pixels; `moments` (N, 2, 2): a a^T + b b^T of the conjugate half-axes a, b, in pixels^2, which
    are widened so that splats between the `samples` of a pixel are not missed, and grow as much thinner. What is left
    to one of a row's sum is what lies behind them all.
    """
    trace = np.trace(moments, axis1=1, axis2=2)[:, None, None]
    low_pass = np.maximum(LOW_PASS / samples**2 * RIM / SUPPORT, THINNEST * trace)
    wide = moments + low_pass * np.eye(2)
    thin = np.sqrt(np.maximum(np.linalg.det(moments), 0) / np.linalg.det(wide))
    offset = pixels[:, None] - centre
    q = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(wide), offset)
    covers = -np.expm1(-thin * depth(q))
    before = np.cumprod(1 - covers[:, ::-1], axis=1)[:, ::-1]
    return covers * np.concatenate([before[:, 1:], np.ones((len(pixels), 1))], axis=1)
