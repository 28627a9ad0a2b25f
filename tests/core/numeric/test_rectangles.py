"""Maxima over rectangles are those of all their cells."""

import numpy as np
import pytest

from pointsplat_addon.core.numeric.rectangles import RectangleMaxima


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (37, 53)])
def test_they_are_those_of_all_cells(shape):
    rng = np.random.default_rng(1)
    grid = rng.random(shape)
    grid[rng.random(shape) < 0.01] = np.inf
    sides = np.array(shape[::-1])
    low = (rng.random((500, 2)) * sides).astype(int)
    high = low + 1 + (rng.random((500, 2)) * (sides - low)).astype(int)
    expected = [grid[y:end_y, x:end_x].max() for (x, y), (end_x, end_y) in zip(low, high, strict=True)]
    np.testing.assert_array_equal(RectangleMaxima(grid)(low, high), expected)


def test_none_are_asked_for():
    none = np.empty((0, 2), int)
    assert RectangleMaxima(np.ones((3, 4)))(none, none).shape == (0,)
