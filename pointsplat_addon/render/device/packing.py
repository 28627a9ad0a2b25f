"""Numbers as the shaders read them: pages of 4,096-wide float textures, directions in 24 bits.

Integers are kept as floats below 2^24, which float32 holds exactly. shaders/lib/data/pack.glsl unpacks.
"""

from __future__ import annotations

import numpy as np

PAGE_WIDTH = 4096
OCT_STEPS = 4095
FACET_STEPS = 511  # of normals in 18 bits
FACET_SHARE = 512.0 * 512.0  # above these: a share in 63rds
NO_NORMAL = -1.0  # code of a splat without a normal: a ball


def octahedral(normal: np.ndarray, steps: int = OCT_STEPS) -> np.ndarray:
    """Returns octahedral codes (Meyer et al. 2010) of directions (N, 3), whatever their length: (N,) float32.

    In `steps` each way: at 12 bits the decoded direction is within 0.06 degrees; that of a zero vector is +Z. For as
    many directions as fit the processor's cache.
    """
    # One after another, coordinates are read much faster than as rows of a transposed array.
    x, y, z = (np.array(column, np.float32) for column in normal.T)
    with np.errstate(over="ignore"):
        size = np.abs(x) + np.abs(y) + np.abs(z)
    odd = ~((size > 0) & (size < np.inf))
    if odd.any():  # nor have infinite vectors a direction
        x[odd], y[odd], z[odd], size[odd] = 0, 0, 1, 1
    x /= size
    y /= size
    # The lower half is folded outwards.
    down = z < 0
    if down.any():
        folded_x, folded_y = np.copysign(1 - np.abs(y), x), np.copysign(1 - np.abs(x), y)
        x, y = np.where(down, folded_x, x), np.where(down, folded_y, y)
    return np.rint((y * 0.5 + 0.5) * steps) * (steps + 1) + np.rint((x * 0.5 + 0.5) * steps)


def paged(values: np.ndarray, channels: int) -> tuple[tuple[int, int], np.ndarray]:
    """Lays out rows (N, C <= channels) as a texture: returns its (width, height) and flat float32 data, zero padded.

    A page of fewer than 4,096 rows is one row high and as wide as a page all the same: shaders shift and mask.
    """
    height = max(1, -(-len(values) // PAGE_WIDTH))
    flat = values.reshape(len(values), values[:1].size if len(values) else channels)
    with np.errstate(over="ignore"):  # of instances that float32 cannot hold, which are not drawn
        if flat.shape[1] == channels and len(values) == height * PAGE_WIDTH:
            return (PAGE_WIDTH, height), np.ascontiguousarray(flat, np.float32).reshape(-1)
        data = np.zeros((height * PAGE_WIDTH, channels), np.float32)
        data[: len(values), : flat.shape[1]] = flat
    return (PAGE_WIDTH, height), data.reshape(-1)
