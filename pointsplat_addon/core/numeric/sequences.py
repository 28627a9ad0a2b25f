"""Places that samples of a pixel, and of a lens, are drawn through: how they lie around the middle."""

from __future__ import annotations

import numpy as np


def around(places: np.ndarray, facing: np.ndarray, count: int) -> np.ndarray:
    """(count, 2) float64: the first of `places` (N, 2), which is the middle, and the others in pairs with those that
    face each across it (N, 2); N > count // 2.

    Their mean is the middle, so that what changes linearly is exact. The last of an even number belongs to no pair: all
    but the middle make way for it, by 1 / (count - 1) of its distance. (Two are left as they are: nothing would be left
    of their distance.) Edges of four samples are then a fourth nearer to the filter's integral, of sixteen 8 %.
    """
    result = np.stack([facing, places], axis=1).reshape(-1, 2)[1 : count + 1]
    if count % 2 == 0 and count > 2:
        result[1:] -= result.sum(axis=0) / (count - 1)
    return result
