"""Numbers as the shaders unpack them, in float64."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.render.device.packing import OCT_STEPS


def unpack_normal(code: np.ndarray) -> np.ndarray:
    """Returns unit vectors (N, 3) float64 of codes (N,): the reference for ps_unpack_normal."""
    row = np.floor(np.asarray(code, np.float64) / 4096)
    x, y = (code - 4096 * row) / OCT_STEPS * 2 - 1, row / OCT_STEPS * 2 - 1
    z = 1 - np.abs(x) - np.abs(y)
    sign_x, sign_y = np.where(x >= 0, 1, -1), np.where(y >= 0, 1, -1)
    n = np.stack([np.where(z < 0, (1 - np.abs(y)) * sign_x, x), np.where(z < 0, (1 - np.abs(x)) * sign_y, y), z], 1)
    return n / np.linalg.norm(n, axis=1, keepdims=True)
