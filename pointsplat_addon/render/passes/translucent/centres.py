"""In which pixels the middles of splats lie: which parts of a picture small splats may touch, at one look-up each."""

from __future__ import annotations

import math

import numpy as np

from ....core.numeric.record import value_record
from ....core.splat.kernel import SUPPORT
from .strata import tiles_with, widened

SMALL = 8  # pixels: half a box of splats, up to which it is taken for that of all


@value_record
class Centres:
    """The middles of the splats of a view of `size` (width, height), of which none reaches farther than `reach` pixels.

    pixel: (N,) int32, in rows of a picture with as many pixels around it; that of none which does not touch the picture
    counts, and is -1.
    """

    size: tuple[int, int]
    reach: int
    pixel: np.ndarray

    def sums(self, values: np.ndarray | None) -> np.ndarray:
        """Returns the sums of values (N,) of the splats in each pixel, or how many these are, of the picture and
        what lies around it, (H, W)."""
        width, height = (side + 2 * self.reach for side in self.size)
        return np.bincount(self.pixel + 1, values, width * height + 1)[1:].reshape(height, width)

    def touched(self, around: float = 0.0) -> np.ndarray:
        """Returns which pixels splats may touch, of the picture and what lies around it, (H, W) bool. around: pixels
        around a splat that count as touched, too."""
        return widened(self.sums(None) > 0, self.reach + math.ceil(around))

    def tiles(self, around: float) -> np.ndarray:
        """Returns which tiles of the picture splats may touch, (rows, columns) bool. around: as of `touched`."""
        inner = slice(self.reach, -self.reach)
        return tiles_with(self.touched(around)[inner, inner])

    def near(self, pixels: np.ndarray) -> np.ndarray:
        """Returns which splats may touch some of pixels (H, W) bool, (K,) int64, in their order."""
        within = widened(np.pad(pixels, self.reach), self.reach).reshape(-1)
        return np.flatnonzero(np.append(within, False)[self.pixel])


def centres_of(
    centre: np.ndarray, shape: np.ndarray, principal_point: tuple[float, float], size: tuple[int, int]
) -> Centres | None:
    """Returns them; None: some splats reach farther than SMALL pixels.

    centre, shape: (N, 4) as the pass `light` left them, of a view with this principal point.
    """
    with np.errstate(all="ignore"):
        there = centre[:, 3] > 0
        largest = max(float(shape[:, k].max(initial=0.0, where=there)) for k in (0, 2))
        half = math.sqrt(SUPPORT * largest)
        if not half <= SMALL:
            return None
        reach = max(math.ceil(half), 1)
        width, height = (side + 2 * reach for side in size)
        x, y = (np.floor(centre[:, k] + np.float32(principal_point[k] + reach)) for k in (0, 1))
        there &= (x >= 0) & (y >= 0) & (x < width) & (y < height)
        pixel = np.where(there, y.astype(np.int32) * np.int32(width) + x.astype(np.int32), np.int32(-1))
    return Centres(size, reach, pixel)
