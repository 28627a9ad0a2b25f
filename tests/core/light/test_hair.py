"""Hair seen as a whole against the model of Chiang et al. 2016 at thousands of offsets across its width."""

import numpy as np
import pytest

from tests.reference import hair as reference
from tests.reference.hair_lighting import Fibre, scattered_radiance

OFFSETS = 512
EYE = np.array([[0.0, -1.0, 0.0]])
TANGENT = np.array([[0.0, 0.0, 1.0]])


def both(theta: float, phi: np.ndarray, radial: float, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) radiance as PointSplat draws it and as the mean over all offsets, for lights at the azimuths phi (P,)."""
    fibre = Fibre(np.array([[0.5, 0.3, 0.15]]), np.array([0.3]), np.array([radial]), np.array([1.55]), np.array([tilt]))
    ours = []
    for p in phi:
        direction = np.array([[np.cos(theta) * np.sin(p), -np.cos(theta) * np.cos(p), np.sin(theta)]])
        ours.append(scattered_radiance(TANGENT, direction, EYE, fibre).sum(axis=0)[0])
    return np.array(ours), np.array([reference.scattered(theta, 0.0, p, fibre, OFFSETS) for p in phi])


THETAS = np.linspace(-1.2, 1.2, 13)


@pytest.mark.parametrize("tilt", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("radial", [0.3, 0.6])
def test_light_from_all_around_is_scattered_as_by_all_offsets(tilt, radial):
    phi = (np.arange(32) + 0.5) / 32 * 2 * np.pi - np.pi
    ours, truth = np.zeros(3), np.zeros(3)
    for theta in THETAS:
        here, there = both(theta, phi, radial, tilt)
        ours += here.sum(axis=0) * np.cos(theta)
        truth += there.sum(axis=0) * np.cos(theta)
    assert np.abs(ours / truth - 1).max() < 0.002  # measured 0.0009


@pytest.mark.parametrize("tilt", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("radial", [0.3, 0.6])
def test_light_from_one_side_is_scattered_nearly_as_by_all_offsets(tilt, radial):
    """Each lobe has one middle for the whole width, not one for each offset: that is what differs."""
    pairs = [both(theta, np.linspace(0, np.pi, 12), radial, tilt) for theta in THETAS]
    ours, truth = (np.stack(found) for found in zip(*pairs, strict=True))
    assert np.abs(ours - truth).max() < 0.05 * truth.max()  # measured 0.047
