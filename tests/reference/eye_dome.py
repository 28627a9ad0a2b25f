"""Eye-dome lighting in float64: what a pixel's light is multiplied by."""

from __future__ import annotations

import numpy as np

DARKNESS = 120.0


def eye_dome(depth: np.ndarray, radius: int, strength: float, width: float | None = None) -> np.ndarray:
    """(H, W) factors of a picture's depths (H, W), NaN where nothing is. `width`: of a parallel view, world units."""
    high, wide = depth.shape
    sums = np.zeros(depth.shape)
    for i in range(8):
        x, y = radius * np.cos(np.pi * i / 4), radius * np.sin(np.pi * i / 4)
        x, y = (int(np.sign(v) * np.floor(abs(v) + 0.5)) for v in (x, y))
        rows = np.clip(np.arange(high) + y, 0, high - 1)
        columns = np.clip(np.arange(wide) + x, 0, wide - 1)
        nearer = depth[np.ix_(rows, columns)]
        step = np.maximum(depth - nearer, 0)
        sums += np.nan_to_num(np.log2(1 + step / (nearer if width is None else width)))
    return np.where(np.isnan(depth), 1.0, np.exp(-DARKNESS * strength * sums / 8))
