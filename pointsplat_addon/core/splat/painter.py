"""The painter's splats: fuzzy opaque ellipses, blended from back to front (Coconu and Hege 2002, section 5).

There is no depth test among splats, and nothing is normalised. With q = (distance / half-axis)^2,

    depth(q) = DEPTH (1 - q / SUPPORT)^POWER,    alpha(q) = 1 - exp(-depth(q)).

In the paper alpha is a Gaussian that is 1/2 at half the threshold distance, the largest distance between splats that
still cover a surface (section 5.4). Here that distance is the diagonal of the cells that splats stand for, whose
corners their half-axes touch (core/surface/sampling.py): alpha is 1/2 at the ellipse, and where four cells meet, a
surface transmits 1/16 of what lies behind it, both sides of a closed one 1/256. A Gaussian of that width is still 1/4
at twice the distance: textures would blur, and outlines grow by half a splat. The kernel here has a compact support, as
has that of translucent splats (kernel.py). The nearer SUPPORT is to 1, the harder is the rim, and the more do single
samples alias; the farther, the more does the middle transmit. docs/notes/techniques.md has the errors of both.

Nodes of the octree have the moments of what they stand for, which is a third less than reaches the corners of its cell:
they are enlarged by NODE_SCALE. Disconnected splats, such as leaves, hide as much as their own area where the low-pass
widens them.
"""

from __future__ import annotations

import math

from .kernel import POWER

SUPPORT = 1.6  # q of the rim
DEPTH = math.log(2) / (1 - 1 / SUPPORT) ** POWER  # optical depth of the middle
NODE_SCALE = math.sqrt(1.5)  # from the half-axes of a square's moments to the ellipse around the square
