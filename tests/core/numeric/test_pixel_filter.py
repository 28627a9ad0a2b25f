"""The pixel filter, and what is left of a neighbour's weight where both hold means over pixels."""

import numpy as np
import pytest

from pointsplat_addon.core.numeric.pixel_filter import blackman_harris, edge_share, filter_reach


def edge_error(size: float, share: float) -> float:
    """RMS error of a pixel that an edge passes at any distance, from the filter's integral up to there."""
    steps, reach = 200, filter_reach(size)
    x = (np.arange(-(reach + 1) * steps, (reach + 1) * steps) + 0.5) / steps
    window = blackman_harris(x, size) / blackman_harris(x, size).sum()
    pixel = np.floor(x + 0.5).astype(int) + reach + 1
    weights = np.bincount(pixel, window)
    weights = (1 - share) * weights + share * (np.arange(len(weights)) == reach + 1)
    return float(np.sqrt(np.square(np.cumsum(weights[pixel]) / steps - np.cumsum(window)).mean()))


@pytest.mark.parametrize("size", [1.25, 1.5, 2.0, 3.0])
def test_the_share_that_moves_is_the_best_for_edges(size):
    best = edge_share(size)
    for other in (0.9 * best, 1.1 * best):
        assert edge_error(size, best) < edge_error(size, other)


def test_the_default_filter_blurs_edges_half_as_much():
    assert edge_share(1.5) == pytest.approx(0.431, abs=0.001)
    assert edge_error(1.5, 0.0) == pytest.approx(0.0308, abs=2e-4)
    assert edge_error(1.5, edge_share(1.5)) == pytest.approx(0.0171, abs=2e-4)


@pytest.mark.parametrize("size", [0.01, 0.5])
def test_nothing_moves_where_a_pixel_takes_nothing_of_its_neighbours(size):
    assert edge_share(size) == 0
