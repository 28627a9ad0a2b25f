"""Positions of samples within a pixel, and the sample counts after which a picture is checked."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...core.numeric.lattice import Lattice
from ...core.numeric.sequences import R2, centred_pairs

FILTER_WIDTH = 1.5  # pixels: Cycles' default


@lru_cache(maxsize=8)
def _blackman_harris(width: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the filter's cumulative distribution and the offsets where it is tabulated, in pixels from the centre."""
    x = np.linspace(-0.5, 0.5, 2049)
    t = 2 * np.pi * (x + 0.5)
    weight = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    cumulative = np.concatenate([[0.0], np.cumsum((weight[1:] + weight[:-1]) / 2)])
    return cumulative / cumulative[-1], x * width


@lru_cache(maxsize=64)
def offsets(count: int, width: float = FILTER_WIDTH) -> np.ndarray:
    """Returns sample positions (count, 2) float64, pixels from the centre, distributed by the Blackman-Harris filter.

    The first is the centre; then follow pairs that are symmetric about it, the first of each pair from a rank-1
    sequence. Any number of first samples fills the pixel evenly, and the mean of all is its centre (except for count
    2): a colour that is linear over a pixel is exact at once, and edges are a third closer to the filter's integral
    than with the sequence alone.
    """
    first = (0.5 + np.arange(count // 2 + 1)[:, None] * R2) % 1.0
    cumulative, x = _blackman_harris(width)
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
