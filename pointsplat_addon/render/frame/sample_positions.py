"""Positions of samples within a pixel, and the sample counts after which a picture is checked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...core.numeric.lattice import Lattice
from ...core.numeric.pixel_filter import FILTER_SIZE, blackman_harris
from ...core.numeric.sequences import R2, centred_pairs


@lru_cache(maxsize=8)
def _distribution(filter_size: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the filter's cumulative distribution and the offsets where it is tabulated, in pixels from the centre."""
    x = np.linspace(-filter_size, filter_size, 2049)
    weight = blackman_harris(x, filter_size)
    cumulative = np.concatenate([[0.0], np.cumsum((weight[1:] + weight[:-1]) / 2)])
    return cumulative / cumulative[-1], x


@lru_cache(maxsize=64)
def offsets(count: int, filter_size: float = FILTER_SIZE) -> np.ndarray:
    """Returns sample positions (count, 2) float64, pixels from the centre, distributed by the pixel filter.

    The first is the centre; then follow pairs that are symmetric about it, the first of each pair from a rank-1
    sequence. Any number of first samples fills the pixel evenly, and the mean of all is its centre (except for count
    2): a colour that is linear over a pixel is exact at once, and edges are a third closer to the filter's integral
    than with the sequence alone.
    """
    first = (0.5 + np.arange(count // 2 + 1)[:, None] * R2) % 1.0
    cumulative, x = _distribution(filter_size)
    result = centred_pairs(np.interp(first, cumulative, x), np.interp(1.0 - first, cumulative, x), count)
    result.setflags(write=False)
    return result


@lru_cache(maxsize=64)
def lattice_offsets(count: int, lattice: Lattice) -> np.ndarray:
    """Returns by how much each of `count` lattices of sub-samples is moved, (count, 2) float64 pixels.

    They are moved within one cell, so that all of them together fill the pixel evenly.
    """
    first = (0.5 + np.arange(count // 2 + 1)[:, None] * R2) % 1.0 - 0.5
    result = lattice.pixels(centred_pairs(first, -first, count))
    result.setflags(write=False)
    return result


def is_checkpoint(samples: int) -> bool:
    """Tells whether a picture is checked after so many samples: 1, 3, 5, 9, 17 ..., the centre and whole pairs."""
    return samples == 1 or (samples > 2 and not (samples - 1) & (samples - 2))
