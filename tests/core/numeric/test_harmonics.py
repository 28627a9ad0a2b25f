"""Real spherical harmonics are orthonormal, are those of the published code in order and sign, and turn."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import lpmv

from pointsplat_addon.core.numeric.harmonics import MOST_DEGREE, harmonics, turning


def sphere():
    """Directions and weights that integrate products of two functions of degree 4 exactly."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angle = np.arange(16) * math.tau / 16
    z, phi = (array.ravel() for array in np.meshgrid(nodes, angle, indexing="ij"))
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1), np.repeat(weights, 16) * math.tau / 16


def test_they_are_orthonormal():
    direction, weight = sphere()
    found = harmonics(direction, MOST_DEGREE)
    np.testing.assert_allclose(found.T @ (found * weight[:, None]), np.eye(25), atol=1e-13)  # measured 1.8e-15


def test_they_are_associated_legendre_functions_with_the_phase_of_condon_and_shortley():
    direction, _ = sphere()
    x, y, z = direction.T
    phi = np.arctan2(y, x)
    found = harmonics(direction, MOST_DEGREE)
    for degree in range(MOST_DEGREE + 1):
        for order in range(-degree, degree + 1):
            m = abs(order)
            share = math.factorial(degree - m) / math.factorial(degree + m)
            norm = math.sqrt((2 * degree + 1) / (4 * math.pi) * share)
            wave = 1 if m == 0 else math.sqrt(2) * (np.cos(m * phi) if order > 0 else np.sin(m * phi))
            expected = norm * lpmv(m, degree, z) * wave
            column = found[:, degree * degree + degree + order]
            np.testing.assert_allclose(column, expected, atol=1e-13)  # measured 2.2e-15


@pytest.mark.parametrize("degree", range(MOST_DEGREE + 1))
@pytest.mark.parametrize("mirror", [1, -1])
def test_a_turned_function_has_the_value_of_what_is_turned_to_a_direction(degree, mirror):
    matrix = mirror * Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix()
    found = turning(matrix, degree)
    np.testing.assert_allclose(found @ found.T, np.eye(2 * degree + 1), atol=1e-12)  # measured 7.1e-15
    direction, _ = sphere()
    own = slice(degree**2, (degree + 1) ** 2)
    coefficients = np.random.default_rng(degree).standard_normal(2 * degree + 1)
    turned = harmonics(direction @ matrix.T, 4)[:, own] @ (found @ coefficients)
    np.testing.assert_allclose(turned, harmonics(direction, 4)[:, own] @ coefficients, atol=1e-12)  # measured 5e-15
