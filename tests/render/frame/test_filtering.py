"""Sample positions follow Cycles' filter; identities are ranked as the Cryptomatte specification says."""

import numpy as np
import pytest

from pointsplat_addon.core.numeric.pixel_filter import FILTER_SIZE
from pointsplat_addon.render.frame.cryptomatte import cryptomatte
from pointsplat_addon.render.frame.sample_positions import offsets


def blackman_harris(x):
    """The window over [-1/2, 1/2], with Harris' coefficients."""
    t = 2 * np.pi * (x + 0.5)
    return 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)


def test_the_first_sample_is_the_pixels_centre():
    assert np.abs(offsets(16)[0]).max() < 1e-12  # measured 3.6e-16


@pytest.mark.parametrize("count", [1, 3, 4, 5, 6, 16, 64, 257])
def test_all_samples_together_lie_around_the_centre(count):
    """Else pictures of different numbers of samples would not lie on one another. Two are an exception."""
    assert np.abs(offsets(count).mean(axis=0)).max() < 1e-15  # measured 4.8e-16 of three


@pytest.mark.parametrize(("count", "bound"), [(4, 0.09), (8, 0.057), (16, 0.037)])
def test_edges_are_near_the_filters_integral(count, bound):
    """Half-planes at all angles. With the last of an even number where the sequence has it: 0.114, 0.058, 0.039."""
    rng = np.random.default_rng(0)
    angle, edge = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(-FILTER_SIZE, FILTER_SIZE, 4000)
    normal = np.array([np.cos(angle), np.sin(angle)])
    few, many = ((offsets(n) @ normal < edge).mean(axis=0) for n in (count, 8193))
    assert np.sqrt(((few - many) ** 2).mean()) < bound  # measured 0.0841, 0.0558, 0.0358


def test_samples_are_distributed_as_the_filter():
    x = (np.arange(100000) + 0.5) / 100000 - 0.5
    weight = blackman_harris(x)
    cumulative = np.cumsum(weight) / weight.sum()
    for column in offsets(4096).T:
        assert np.abs(column).max() <= FILTER_SIZE
        rank = np.interp(np.sort(column), x * 2 * FILTER_SIZE, cumulative)
        # Kolmogorov and Smirnov's distance; random samples would have about 0.01
        assert np.abs(rank - (np.arange(4096) + 0.5) / 4096).max() < 2e-3  # measured 9.2e-4


@pytest.mark.parametrize("count", [16, 64, 256])
def test_the_plane_is_filled_evenly(count):
    """No square of the unit square, a quarter wide, has far more samples than its share."""
    x = np.linspace(-0.5, 0.5, 4097)
    cumulative = np.concatenate([[0], np.cumsum(blackman_harris((x[1:] + x[:-1]) / 2))])
    uniform = np.interp(offsets(count), x * 2 * FILTER_SIZE, cumulative / cumulative[-1])
    cells = np.histogram2d(*uniform.T, bins=4, range=[[0, 1], [0, 1]])[0]
    assert np.abs(cells - count / 16).max() <= 3  # measured 1, 2 and 3 of 16, 64 and 256


def test_nobody_can_change_the_cached_positions():
    with pytest.raises(ValueError, match="read-only"):
        offsets(16)[0] = 1


def ranked(hashes, levels):
    """{identity: coverage} of each pixel, from the pictures."""
    pictures = cryptomatte(hashes, levels)
    rows = np.concatenate([p.reshape(-1, 2, 2) for p in pictures], axis=1)
    return rows[..., 0].copy().view(np.uint32), rows[..., 1]


def test_ranks_hold_identities_by_bits_and_falling_coverage():
    a, b, c = 0x7F7FFFFF, 0x00000001, 0xBF800000
    hashes = np.array([a, b, a, c, a, b, 0, a], np.uint32)[:, None, None]
    identity, coverage = ranked(hashes, 6)
    assert identity[0].tolist() == [a, b, c, 0, 0, 0]
    assert coverage[0].tolist() == [4 / 8, 2 / 8, 1 / 8, 0, 0, 0]


@pytest.mark.parametrize("levels", [1, 2, 3, 6])
def test_two_ranks_a_picture(levels):
    pictures = cryptomatte(np.ones((3, 5, 7), np.uint32), levels)
    assert [p.shape for p in pictures] == [(5, 7, 4)] * ((levels + 1) // 2)


def test_coverages_are_the_counts_of_random_identities():
    rng = np.random.default_rng(0)
    table = np.append(rng.integers(1, 2**32, 4, dtype=np.uint64).astype(np.uint32), np.uint32(0))
    index = rng.integers(0, 5, (12, 6, 5))
    identity, coverage = ranked(table[index], 6)
    identity, coverage = identity.reshape(6, 5, -1), coverage.reshape(6, 5, -1)
    for row, key in enumerate(table[:4]):
        expected = (index == row).sum(axis=0) / 12
        found = np.where(identity == key, coverage, 0).sum(axis=2)
        np.testing.assert_allclose(found, expected, atol=1e-7)  # measured 3e-8
    np.testing.assert_allclose(coverage.sum(axis=2), (index < 4).sum(axis=0) / 12, atol=1e-6)  # measured 6e-8
    assert (np.diff(coverage, axis=2) <= 0).all()


def test_identities_beyond_the_last_rank_are_left_out():
    identity, coverage = ranked(np.arange(1, 9, dtype=np.uint32)[:, None, None], 4)
    assert len(set(identity[0].tolist())) == 4
    assert coverage[0].tolist() == [1 / 8] * 4
