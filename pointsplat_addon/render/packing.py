"""Numbers as the shaders read them: pages of 4,096-wide float textures, directions in 24 bits.

Integers are kept as floats below 2^24, which float32 holds exactly. shaders/lib/pack.glsl unpacks.
"""

from __future__ import annotations

import numpy as np

PAGE_WIDTH = 4096
OCT_STEPS = 4095
NO_NORMAL = -1.0  # code of a splat without a normal: a ball
_ROWS = 1 << 18  # rows that are converted together, so that scratch arrays stay in the cache


def pack_normal(normal: np.ndarray) -> np.ndarray:
    """Octahedral code (Meyer et al. 2010), 12 bits each way, of unit vectors (N, 3): (N,) float32.

    The decoded direction is within 0.06 degrees.
    """
    code = np.empty(len(normal), np.float32)
    for start in range(0, len(normal), _ROWS):
        x, y, z = normal[start : start + _ROWS].astype(np.float32).T
        size = np.abs(x) + np.abs(y) + np.abs(z)
        size[size == 0] = 1
        x, y = x / size, y / size
        folded_x = (1 - np.abs(y)) * np.where(x >= 0, np.float32(1), np.float32(-1))
        folded_y = (1 - np.abs(x)) * np.where(y >= 0, np.float32(1), np.float32(-1))
        down = z < 0
        x, y = np.where(down, folded_x, x), np.where(down, folded_y, y)
        column = np.rint((x * 0.5 + 0.5) * OCT_STEPS)
        row = np.rint((y * 0.5 + 0.5) * OCT_STEPS)
        code[start : start + _ROWS] = row * 4096 + column
    return code


def unpack_normal(code: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) float64 of codes (N,): the reference for ps_unpack_normal."""
    row = np.floor(np.asarray(code, np.float64) / 4096)
    x, y = (code - 4096 * row) / OCT_STEPS * 2 - 1, row / OCT_STEPS * 2 - 1
    z = 1 - np.abs(x) - np.abs(y)
    sign_x, sign_y = np.where(x >= 0, 1, -1), np.where(y >= 0, 1, -1)
    n = np.stack([np.where(z < 0, (1 - np.abs(y)) * sign_x, x), np.where(z < 0, (1 - np.abs(x)) * sign_y, y), z], 1)
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def paged(values: np.ndarray, channels: int) -> tuple[tuple[int, int], np.ndarray]:
    """Rows (N, C <= channels) laid out as a texture: its (width, height) and flat float32 data, zero padded.

    A page of fewer than 4,096 rows is one row high and as wide as a page all the same: shaders shift and mask.
    """
    height = max(1, -(-len(values) // PAGE_WIDTH))
    flat = values.reshape(len(values), values[:1].size if len(values) else channels)
    if flat.shape[1] == channels and len(values) == height * PAGE_WIDTH:
        return (PAGE_WIDTH, height), np.ascontiguousarray(flat, np.float32).reshape(-1)
    data = np.zeros((height * PAGE_WIDTH, channels), np.float32)
    data[: len(values), : flat.shape[1]] = flat
    return (PAGE_WIDTH, height), data.reshape(-1)
