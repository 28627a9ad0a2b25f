"""scripts/benchmarks/beside_cycles: its figures are what they say, and its landscape is as dense as it says."""

import numpy as np
import pytest

from scripts.benchmarks.beside_cycles import figures, landscape


def test_noise_of_the_truth_is_no_error():
    """A picture that is 0.1 too bright is off by 0.1, though each of the truth's pictures is off by 0.3."""
    rng = np.random.default_rng(0)
    first, second = 0.3 * rng.standard_normal((2, 400, 400, 3))
    # measured: 0.0996; the standard deviation of the mean product, 1.4e-4, is 7e-4 of its root
    assert figures.rmse(np.full(first.shape, 0.1), first, second) == pytest.approx(0.1, abs=2e-3)


def test_noise_of_the_picture_is_error():
    rng = np.random.default_rng(2)
    picture, first, second = np.array([[[[0.2]]], [[[0.05]]], [[[0.05]]]]) * rng.standard_normal((3, 400, 400, 3))
    # measured: 0.2000
    assert figures.rmse(picture, first, second) == pytest.approx(0.2, abs=1e-3)


def test_time_of_equal_error_lies_on_a_power_law():
    rows = [{"rmse": 0.4 * n**-0.5, "seconds": 0.25 * n} for n in (1, 4, 16)]
    assert figures.equal_time(0.4 * 8**-0.5, rows) == pytest.approx(2.0)
    assert figures.equal_time(0.5, rows) is None
    assert figures.equal_time(0.05, rows) is None


def test_time_is_the_median_and_a_failure_is_told():
    runs = [{"seconds": s, "processor": 2 * s, "second": s, "second_processor": s} for s in (3.0, 1.0, 2.0)]
    assert figures.median(runs)["processor"] == 4.0
    assert figures.median([*runs, {"failed": "no memory"}]) == {"failed": "no memory"}


def test_landscape_has_one_point_in_each_square_of_its_spacing():
    position, color, spacing = landscape.landscape(40_000)
    assert position.shape == color.shape == (40_000, 3)
    assert color.min() >= 0
    assert color.max() <= 1
    rng = np.random.default_rng(0)
    boxes = landscape.boxes(rng)
    anywhere = rng.uniform(-landscape.WIDE / 2, landscape.WIDE / 2, (100_000, 1, 2))
    bare = ~np.any(np.all(np.abs(anywhere - boxes.middle) < boxes.half, axis=2), axis=1)
    on_ground = np.abs(position[:, 2] - landscape.ground(position[:, 0], position[:, 1])) < 1e-3
    # measured: 0.967; the 2 to 4 % of points that are too many are left out
    density = np.count_nonzero(on_ground) * spacing**2 / (bare.mean() * landscape.WIDE**2)
    assert density == pytest.approx(1.0, abs=0.05)
