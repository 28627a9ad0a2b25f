"""EWA splatting (Zwicker et al. 2001): the low-pass filter, and how much of its ellipse a splat stands for.

The kernels themselves are in shaders/lib/splat/ewa.glsl.
"""

from __future__ import annotations

import numpy as np

# A sample stands for the cell that its ellipse goes around: between 1 / pi (half a rectangle) and 2 / pi (a rectangle)
# of the ellipse's area (core/surface/sampling.py); the geometric mean of the two.
CELL_SHARE = np.sqrt(2) / np.pi
CENTRES = 4  # samples of a pixel from which on a sample shows only the ellipses that hold it
LEAST_LOW_PASS = 4e-4  # pixels^2, which keeps covariances invertible


def low_pass(samples: int) -> float:
    """The variance v of the low-pass filter in pixels^2, for pixels that are means of `samples`.

    With one sample a pixel, all detail that pixels cannot show must be filtered out before: the unit Gaussian of
    Zwicker et al. leaves exp(-2 pi^2 v) = 3e-9 of a pattern with the pixels' period, which would alias to a constant,
    and 0.7 % at half that frequency. N samples a pixel are sqrt(N) times as dense along each axis, which suggests 1 /
    N. But they do not lie on a grid: what they alias is spread out, and averaging them with the pixel filter
    (render/frame/sample_positions.py) removes most of it. N^-1.5 is sharper than 1 / N and aliases little more.
    """
    return max(samples**-1.5, LEAST_LOW_PASS)


def centres_decide(samples: int) -> bool:
    """Whether a pixel has so many samples that a splat may be shown only by samples within its ellipse.

    Their mean is then an edge without visible steps: surfaces end where they should, and those in front do not bleed.
    """
    return samples >= CENTRES
