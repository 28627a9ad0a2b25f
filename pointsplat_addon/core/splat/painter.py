"""Fuzzy opaque splats, painted from back to front (Coconu and Hege 2002, section 5), in float64.

A splat is a fuzzy ellipse, blended over all that lies behind it. There is no depth test among splats, and nothing is
normalised.

In the paper alpha is a Gaussian that is 1/2 at half the threshold distance, the distance between splats that they are
still to cover (section 5.4). Here that is the diagonal of the cells that splats stand for, whose corners their
half-axes reach (core/surface/sampling.py): alpha is 1/2 at the ellipse, and where four cells meet a surface lets 1/16 of what
lies behind it through, both sides of a closed one 1/256. A Gaussian of that width is 1/4 at twice the distance, so that
textures blur and outlines grow by half a splat; the kernel of what is translucent (core/splat/kernel.py) ends. With
q = (distance / half-axis)^2,

    depth(q) = DEPTH (1 - q / SUPPORT)^POWER,    alpha(q) = 1 - exp(-depth(q)).

The nearer SUPPORT is to one, the harder is the rim, and the more do single samples alias; the farther, the more does
the middle let through. docs/notes/techniques.md has the errors of both.

Nodes of the octree have the moments of what they stand for, which is a third less than reaches its corners: they are
enlarged by NODE_REACH. Splats that stand apart, as leaves do, hide as much as their own area where they are widened.
"""

from __future__ import annotations

import math

import numpy as np

from .kernel import POWER
from .kernel import SUPPORT as RIM

GAMMA = math.gamma(1 + 1 / POWER)  # integral of exp(-u^POWER) over u > 0
SUPPORT = 1.6  # q of the rim
DEPTH = math.log(2) / (1 - 1 / SUPPORT) ** POWER  # optical depth of the middle
LOW_PASS, THINNEST = 0.04, 1e-4  # shaders/translucent/light.frag: pixels^2 of variance; of the sum of variances
NODE_REACH = math.sqrt(1.5)  # from the half-axes of a square's moments to the ellipse around it
LEAK = 1 / 16  # of what lies behind, that one side of a surface lets through at the corner of four cells


def depth(q: np.ndarray) -> np.ndarray:
    """Optical depth of a splat at the squared distances q >= 0 from its middle, in half-axes."""
    return DEPTH * np.maximum(1 - q / SUPPORT, 0) ** POWER


def alpha(q: np.ndarray) -> np.ndarray:
    """How much a splat covers there."""
    return -np.expm1(-depth(q))


def hidden_share(depth: float | np.ndarray) -> float | np.ndarray:
    """What a splat whose middle has this optical depth hides, over what it would if it were opaque up to its rim;
    within 0.004 from depths of 3 on."""
    return 1 - GAMMA * depth**-0.25


def depth_for_share(kept: np.ndarray) -> np.ndarray:
    """Optical depth of the middle of a splat that hides as much as one of DEPTH whose area is the share `kept` of its
    own, within 3.5 %: the inverse of `covered`, with the right slope at 0 and value at 1."""
    most = hidden_share(DEPTH)
    return (GAMMA / (1 - most * kept)) ** 4 - GAMMA**4 * (1 - kept) ** ((5 / GAMMA**4 - 4) * most)


def weights(
    pixels: np.ndarray, centre: np.ndarray, moments: np.ndarray, samples: int = 1, apart: bool = False
) -> np.ndarray:
    """(P, N) how much of each splat is seen at places (P, 2), of splats given back to front.

    `centre` (N, 2) in pixels; `moments` (N, 2, 2): a a^T + b b^T of the conjugate half-axes a, b, in pixels^2, which
    are widened so that splats between the `samples` of a pixel are not missed, and grow as much thinner. What is left
    to one of a row's sum is what lies behind them all. `apart`: they hide as much as if they were not widened;
    what closes a surface stays opaque.
    """
    trace = np.trace(moments, axis1=1, axis2=2)[:, None, None]
    low_pass = np.maximum(LOW_PASS / samples**2 * RIM / SUPPORT, THINNEST * trace)
    wide = moments + low_pass * np.eye(2)
    thin = np.sqrt(np.maximum(np.linalg.det(moments), 0) / np.linalg.det(wide))
    offset = pixels[:, None] - centre
    q = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(wide), offset)
    thin = depth_for_share(thin) / DEPTH if apart else thin
    covers = -np.expm1(-thin * depth(q))
    before = np.cumprod(1 - covers[:, ::-1], axis=1)[:, ::-1]
    return covers * np.concatenate([before[:, 1:], np.ones((len(pixels), 1))], axis=1)
