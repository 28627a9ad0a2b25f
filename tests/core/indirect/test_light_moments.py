"""What moments of the light from all sides tell of irradiance and of lobes, against integrals over directions."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.moments import MOMENTS, irradiance, irradiance_of_relief, lobes


def sphere(count: int) -> np.ndarray:
    """Directions (N, 3) of equal solid angles."""
    number = np.arange(count) + 0.5
    height, turn = 1 - 2 * number / count, np.pi * (1 + 5**0.5) * number
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


DIRECTIONS = sphere(200_000)
NORMALS = sphere(200)


def moments(surfaces: np.ndarray, sky: np.ndarray, shows: np.ndarray) -> np.ndarray:
    """(1, 24) of radiance (N, 3) of surfaces and of the sky, and of where it is open, (N,), in DIRECTIONS."""
    x, y, z = DIRECTIONS.T
    second = np.stack([x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y])
    basis = np.vstack([np.ones_like(x), x, y, z])
    seen = surfaces + sky
    parts = (basis @ seen).ravel(), second @ seen.mean(axis=1), surfaces.sum(axis=0), basis @ shows
    found = np.concatenate(parts) * 4 * np.pi / len(DIRECTIONS)
    assert len(found) == MOMENTS
    return found[None]


def exact(seen: np.ndarray) -> np.ndarray:
    """(200, 3): irradiance over pi on NORMALS of radiance (N, 3)."""
    cosine = np.maximum(NORMALS @ DIRECTIONS.T, 0)
    return cosine @ seen * 4 / len(DIRECTIONS)


def test_even_light_and_a_half_sky_are_exact():
    """The hemisphere has no moment of second order, and what is beyond lights nothing evenly. Found: off by 1.3e-5."""
    up = (DIRECTIONS[:, 2] > 0)[:, None] * np.array([1.0, 2.0, 3.0])
    for seen in (np.ones_like(up), up):
        row = np.repeat(moments(np.zeros_like(seen), seen, np.ones(len(seen))), len(NORMALS), axis=0)
        np.testing.assert_allclose(irradiance(row, NORMALS), exact(seen), atol=5e-5 * seen.max())


@pytest.mark.parametrize("towards", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.48, -0.64, 0.6)])
def test_a_small_light_is_as_bright_as_two_orders_tell(towards):
    """Worst of all lights: off by up to 1/16 of what it sends straight on (Ramamoorthi and Hanrahan 2001: the third
    order is nothing, the fourth -1/24 of pi). Found: 0.0684 below and beside, at the most."""
    seen = (DIRECTIONS @ np.array(towards) > 0.99)[:, None] * np.ones(3)
    row = np.repeat(moments(seen, np.zeros_like(seen), np.zeros(len(seen))), len(NORMALS), axis=0)
    straight = exact(seen).max()
    found = irradiance(row, NORMALS)
    assert np.abs(found - exact(seen)).max() < 0.08 * straight
    assert (found >= 0).all()


@pytest.mark.parametrize("sharpness", [0.5, 4.0, 24.0])
def test_lobes_see_an_even_sky_beside_a_wall(sharpness):
    """Half of all directions shows a wall of one colour, the other an even sky of another: an edge, which two orders
    blur. Worst of all directions, share of the sky and light of the wall: 0.0006 and 0.0004, 0.042 and 0.11, 0.21 and
    0.39 (of 0.6)."""
    wall, sky = np.array([0.2, 0.4, 0.6]), np.array([2.0, 1.0, 0.5])
    above = DIRECTIONS[:, 0] > 0
    row = moments(~above[:, None] * wall, above[:, None] * sky, above.astype(float))
    row = np.repeat(row, len(NORMALS), axis=0)
    weight = np.exp(sharpness * (NORMALS @ DIRECTIONS.T - 1))
    share = weight @ above / weight.sum(axis=1)
    found = lobes(row, NORMALS, np.full(len(NORMALS), sharpness))
    of_sky, of_wall = {0.5: (0.001, 0.001), 4.0: (0.05, 0.13), 24.0: (0.24, 0.43)}[sharpness]
    assert np.abs(found[:, 3] - share).max() < of_sky
    assert np.abs(found[:, :3] - (1 - share)[:, None] * wall).max() < of_wall


def of_relief(seen: np.ndarray, normal: np.ndarray, returned: float) -> np.ndarray:
    """(N, 3): irradiance over pi of relief on a level plane, at normals (N, 3), by radiance (M, 3) in DIRECTIONS."""
    row = np.repeat(moments(np.zeros_like(seen), seen, np.ones(len(seen))), len(normal), axis=0)
    plane = np.broadcast_to(np.array([0.0, 0.0, 1.0]), normal.shape)
    return irradiance_of_relief(row, normal, plane, np.full((len(normal), 3), returned))


def test_relief_has_the_cosine_of_its_tilt_of_an_even_sky_and_the_rest_of_itself():
    """However much it sends on: between a white one and the sky all is as bright. Found: off by 3e-5."""
    above = NORMALS[NORMALS[:, 2] > 0]
    for sent in (0.0, 0.5, 1.0):
        seen = np.where(DIRECTIONS[:, 2:] > 0, 1.0, sent) * np.ones(3)
        expected = above[:, 2] + (1 - above[:, 2]) * sent
        np.testing.assert_allclose(of_relief(seen, above, sent)[:, 0], expected, atol=1e-4)


def test_relief_receives_on_average_what_falls_on_its_plane():
    """Ridges of two even slopes, lit from anywhere above them: by area they receive the plane's light times the cosine
    of the slopes, since what one hides from another it receives itself. Found: off by 2e-5 of it."""
    towards = np.array([0.3, 0.2, 0.93])
    seen = (DIRECTIONS @ towards / np.linalg.norm(towards) > 0.995)[:, None] * np.ones(3)
    plane = (DIRECTIONS[:, 2] @ seen * 4 / len(DIRECTIONS))[0]
    for steep in (0.2, 0.6, 1.0):
        slopes = np.array([[np.sin(steep), 0, np.cos(steep)], [-np.sin(steep), 0, np.cos(steep)]])
        found = of_relief(seen, slopes, 0.0)[:, 0].mean()
        assert abs(found / (np.cos(steep) * plane) - 1) < 1e-4
