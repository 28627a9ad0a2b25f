"""Lattices of sub-samples."""

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import FEW, MANY, ONE, Lattice, lattice_for


@pytest.mark.parametrize("lattice", [ONE, FEW, MANY, Lattice(6, 1)])
def test_every_pixel_has_cells_of_its_own(lattice):
    width, height = 7, 5
    columns, rows = lattice.size((width, height))
    corner = lattice.corner((width, height))
    owners = np.zeros((rows, columns), int)
    y, x = (axis.reshape(-1, 1) for axis in np.indices((height, width)))
    column = corner[0] + lattice.p * x - lattice.q * y + lattice.offsets[:, 0]
    row = corner[1] + lattice.q * x + lattice.p * y + lattice.offsets[:, 1]
    np.add.at(owners, (row, column), 1)
    assert len(lattice.offsets) == lattice.count
    assert owners.max() == 1
    assert owners.sum() == width * height * lattice.count


@pytest.mark.parametrize("lattice", [FEW, MANY, Lattice(6, 1)])
def test_no_two_sub_samples_share_a_row_or_a_column(lattice):
    for axis in range(2):
        steps = np.sort(lattice.positions[:, axis] * lattice.count)
        np.testing.assert_allclose(steps, np.arange(lattice.count) - lattice.count // 2, atol=1e-9)


@pytest.mark.parametrize("lattice", [FEW, MANY])
def test_the_first_sub_sample_is_the_centre_and_the_mean_of_all(lattice):
    np.testing.assert_array_equal(lattice.positions[0], 0)
    np.testing.assert_allclose(lattice.positions.mean(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize(
    ("samples", "interactive", "lattice"),
    [(1, False, ONE), (1, True, ONE), (4, False, FEW), (5, False, FEW), (6, False, MANY), (16, True, FEW)],
)
def test_samples_are_rounded_up_to_a_lattice(samples, interactive, lattice):
    assert lattice_for(samples, interactive) == lattice
