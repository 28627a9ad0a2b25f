"""Light that is estimated from what is known around."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.around import LightAround, LightAt, joined, matched
from pointsplat_addon.core.indirect.sites import sites

UP = np.array([0.0, 0.0, 1.0])


def known(
    position: np.ndarray, normal: np.ndarray, level: float, light: np.ndarray | float, smooth: bool = False
) -> LightAt:
    count = len(position)
    found = np.zeros((count, 8), np.float32)
    found[:, :3] = light
    found[:, 4:] = 0.25
    normals = np.broadcast_to(normal, (count, 3)).astype(np.float64)
    return LightAt(position, normals, np.full(count, level), found, np.full(count, smooth))


def floor(level: float, height: float = 0.0) -> np.ndarray:
    """(N, 3): sites in cells of 2^level, of a floor from -2 to 2."""
    at = np.arange(-2, 2, 2.0**level) + 2.0**level / 3
    place = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    place = np.column_stack([place, np.full(len(place), height)])
    return sites(place, np.broadcast_to(UP, place.shape), np.full(len(place), level)).position


def asked(count: int = 400, height: float = 0.0, reach: float = 1.5) -> np.ndarray:
    place = np.random.default_rng(1).uniform(-reach, reach, (count, 3))
    place[:, 2] = height
    return place


def estimated(around: LightAround, place: np.ndarray, level: float, normal: np.ndarray = UP) -> np.ndarray:
    normals = np.broadcast_to(normal, place.shape)
    return around.estimated(place, normals, np.full(len(place), level))


@pytest.mark.parametrize("level", [-3.0, -2.0])
def test_light_that_changes_evenly_is_told(level):
    """Worst: 2.4e-7, at any level that is asked for up to the one that is known."""
    at = floor(-2.0)
    light = 1 + at[:, :1] * 0.3 + at[:, 1:2] * 0.1
    place = asked()
    found = estimated(LightAround(known(at, UP, -2.0, light)), place, level)
    np.testing.assert_allclose(found[:, 0], 1 + place[:, 0] * 0.3 + place[:, 1] * 0.1, atol=1e-6)


def test_even_light_is_told_of_all_normals_and_far_away():
    rng = np.random.default_rng(2)
    normal = rng.normal(size=(500, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    light = known(rng.uniform(-1, 1, (300, 3)), normal[:300], -3.0, np.array([0.5, 1.0, 2.0]))
    found = LightAround(light).estimated(rng.uniform(-9, 9, (500, 3)), normal, np.full(500, -4.0))
    np.testing.assert_allclose(found[:, :3], np.broadcast_to([0.5, 1.0, 2.0], (500, 3)), rtol=1e-5)


def test_both_sides_of_a_wall_have_light_of_their_own():
    at = floor(-2.0)
    around = LightAround(joined([known(at, UP, -2.0, 1.0), known(at - 0.01 * UP, -UP, -2.0, 5.0)]))
    place = asked()
    np.testing.assert_allclose(estimated(around, place, -3.0)[:, 0], 1, rtol=1e-6)
    np.testing.assert_allclose(estimated(around, place, -3.0, -UP)[:, 0], 5, rtol=1e-6)


def test_of_what_is_known_finely_in_places_cells_count_each_once():
    """A corner with a thousand positions does not outweigh the floor, seen from far away. Worst: 1.19; the mean of all
    would be 1.77."""
    at, corner = floor(-2.0), floor(-5.0)
    corner = corner[(corner[:, 0] < -1.5) & (corner[:, 1] < -1.5)]
    light = joined([known(at, UP, -2.0, 1.0), known(corner, UP, -5.0, 2.0)])
    found = estimated(LightAround(light), asked(), 1.0)[:, 0]
    assert found.max() < 1.25


def test_what_is_known_roughly_counts_where_nothing_is_known_better():
    at = floor(-2.0)
    left = at[:, 0] < 0
    exact, rough = known(at[left], UP, -2.0, 1.0), known(at, UP, -2.0, 4.0)
    place = asked()
    found = estimated(LightAround(exact, rough), place, -4.0)[:, 0]
    np.testing.assert_allclose(found[place[:, 0] < -0.25], 1, rtol=1e-6)
    np.testing.assert_allclose(found[place[:, 0] > 0.5], 4, rtol=1e-6)
    scaled = matched(rough, exact)
    np.testing.assert_allclose(scaled.found[:, :3], 2, rtol=1e-6)  # at most half as bright


def test_where_no_lobe_is_known_light_from_all_sides_is_mirrored():
    at = floor(-2.0)
    for smooth, mirrored in ((False, [1, 1, 1, 0]), (True, [0.25, 0.25, 0.25, 0.25])):
        found = estimated(LightAround(known(at, UP, -2.0, 1.0, smooth)), asked(), -2.0)
        np.testing.assert_allclose(found[:, 4:], np.broadcast_to(mirrored, (400, 4)), rtol=1e-5)


@pytest.mark.parametrize("times", [2.0**-30, 1.0, 2.0**30])
def test_any_scale(times):
    """Worlds of other units have the same light, to the bit where they differ by powers of two."""
    at, exponent = floor(-2.0), np.log2(times)
    light = 1 + at[:, :1] * at[:, 1:2]
    one, other = (
        estimated(LightAround(known(at * by, UP, -2.0 + up, light)), asked() * by, -3.0 + up)
        for by, up in ((1.0, 0.0), (times, exponent))
    )
    np.testing.assert_array_equal(one, other)
