"""Fuzzy opaque splats, painted from back to front (Coconu and Hege 2002, section 5), in float64.

A splat is a fuzzy ellipse: its optical depth falls from the middle to the rim, its alpha is 1 - exp(-depth), and each
is blended over what lies behind it. There is no depth test among splats, hence no buffer that would have to be resolved
for soft edges, and no normalisation.

The paper's alpha is a Gaussian that is 1/2 at half the distance between neighbours (section 5.4): the outline of a
surface then lies where it should, but between four neighbours on a lattice a third of what lies behind shows through.
Here it is the optical depth that falls as the kernel of what is translucent (core/kernel.py) does, narrower and so deep
that a lattice lets through no more than LEAK anywhere, one layer alone: with q = (distance / half-axis)^2,

    depth(q) = DEPTH (1 - q / SUPPORT)^POWER,    alpha(q) = 1 - exp(-depth(q)).

Half-axes reach the corners of the cells that splats stand for (core/sampling.py), where four meet: each must have a
quarter of -ln LEAK there, at q = 1, which gives DEPTH for any SUPPORT. The nearer SUPPORT is to one, the harder is the
rim; alpha is one half at HALF half-axes from the middle.
"""

from __future__ import annotations

import math

import numpy as np

from .kernel import POWER

LEAK = 1 / 255  # of what lies behind, at the corner of four cells
SUPPORT = 2.0  # q of the rim
DEPTH = -math.log(LEAK) / 4 / (1 - 1 / SUPPORT) ** POWER
HALF = math.sqrt(SUPPORT * (1 - (math.log(2) / DEPTH) ** (1 / POWER)))  # half-axes from the middle, where alpha is 1/2


def alpha(q: np.ndarray) -> np.ndarray:
    """How much a splat covers at the squared distances q >= 0 from its middle, in half-axes."""
    return -np.expm1(-DEPTH * np.maximum(1 - q / SUPPORT, 0) ** POWER)
