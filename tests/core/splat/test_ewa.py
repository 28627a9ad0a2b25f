"""The resampling kernel: its mass, the Jacobian in it, and what covers a surface."""

import numpy as np
import pytest

from pointsplat_addon.core.splat.ewa import CELL_SHARE, low_pass
from tests.reference.ewa import CUTOFF, KEPT_MASS, WITHIN, coverage, projected_covariance, resampling_weights


def pixels(count: int) -> np.ndarray:
    """(count^2, 2) centres of the pixels of a square picture."""
    x, y = np.meshgrid(np.arange(count) + 0.5, np.arange(count) + 0.5)
    return np.stack([x.ravel(), y.ravel()], axis=1)


@pytest.mark.parametrize("v", [1.0, 0.25])
@pytest.mark.parametrize("radii", [(0.05, 0.05), (1.0, 1.0), (6.0, 0.8), (8.0, 8.0)])
def test_a_kernels_sum_over_the_pixels_is_the_pixels_that_the_splat_stands_for(v, radii):
    angle = np.radians(25)
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * radii
    moments = (axes @ axes.T / 4)[None]
    centres = np.random.default_rng(0).uniform(31.5, 32.5, (200, 2))
    for centre in centres:
        total = resampling_weights(pixels(64), centre[None], moments, v).sum()
        expected = CELL_SHARE * np.pi * radii[0] * radii[1]
        # The kernel ends with a step of exp(-CUTOFF / 2) = 8 %, over which pixel centres hop.
        assert abs(total / expected - 1) < (0.03 if v == 1.0 else 0.09)  # measured 0.0229 and 0.0743


def test_a_kernel_ends_where_so_much_of_it_is_kept():
    inside = 1 - np.exp(-CUTOFF / 2)
    assert pytest.approx(inside, abs=1e-15) == KEPT_MASS
    x = np.linspace(-12, 12, 2401)
    place = np.stack(np.meshgrid(x, x), -1).reshape(-1, 2)
    one = resampling_weights(place, np.zeros((1, 2)), 4 * np.eye(2)[None], 0.5)
    integral = one.sum() * (x[1] - x[0]) ** 2
    assert integral == pytest.approx(CELL_SHARE * 16 * np.pi, rel=1e-3)  # radius 4; measured 3e-5


@pytest.mark.parametrize(("v", "ripple"), [(1, 0.05), (1 / 4, 0.09), (1 / 16, 0.13), (low_pass(16), 0.30)])
def test_kernels_of_disks_around_the_cells_of_a_lattice_sum_to_one(v, ripple):
    """A pixel a cell; the step at the kernels' end, and at many samples what their gaps let through."""
    centre = pixels(24)
    moments = np.tile(np.eye(2) / 8, (len(centre), 1, 1))  # r^2 / 4 of a disk around a unit square
    places = np.random.default_rng(0).uniform(10, 14, (4000, 2))
    total = WITHIN * resampling_weights(places, centre, moments, v).sum(axis=1)
    assert np.abs(total - 1).max() < ripple  # measured 0.0407, 0.0742, 0.1136, 0.2940
    assert abs(total.mean() - 1) < 5e-3  # measured 0.0040


def test_the_low_pass_falls_with_the_samples_and_never_vanishes():
    values = [low_pass(n) for n in (1, 2, 4, 16, 4096)]
    assert values[0] == 1.0
    assert values[2] == 1 / 8
    assert values[3] == 1 / 64
    assert (np.diff(values) < 0).all()
    assert 0 < values[-1] < 1e-3


@pytest.mark.parametrize("perspective", [True, False])
def test_the_jacobian_is_the_derivative_of_the_projection(perspective):
    rng = np.random.default_rng(1)
    centre = rng.uniform([-2, -2, -9], [2, 2, -3], (50, 3))
    a, b = rng.normal(size=(2, 50, 3))
    focal = 300.0, 280.0

    def project(p):
        return np.asarray(focal) * p[:, :2] / (-p[:, 2:] if perspective else 1)

    step = 1e-6
    da, db = ((project(centre + step * axis) - project(centre - step * axis)) / (2 * step) for axis in (a, b))
    expected = (da[:, :, None] * da[:, None, :] + db[:, :, None] * db[:, None, :]) / 4
    found = projected_covariance(centre, a, b, focal, perspective)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()  # measured 4e-10


def test_coverage_is_at_most_whole_and_takes_sums_beside_a_surface_as_they_are():
    total = np.array([0.0, 0.3, 0.8, 3.0])
    np.testing.assert_allclose(coverage(total, np.zeros(4, bool)), [0, 0.3, 0.8, 1])
    np.testing.assert_allclose(coverage(total, np.ones(4, bool)), [0, 0.3 * np.sqrt(2), 1, 1])
