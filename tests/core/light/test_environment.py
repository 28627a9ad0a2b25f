"""The prefiltered environment against exact integrals."""

import numpy as np
import pytest

from pointsplat_addon.core.light import environment
from tests.reference import environment_lookup


def random_directions(count):
    v = np.random.default_rng(1).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_directions_follow_blenders_layout_and_invert():
    # The middle of the picture is +X, its quarter to the left of the middle +Y, the top row up.
    uv = environment.uv_from_direction(np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]))
    assert uv[0] == pytest.approx([0.5, 0.5])
    assert uv[1] == pytest.approx([0.25, 0.5])
    assert uv[2, 1] == 1
    directions = random_directions(100)
    back = environment.direction_from_uv(environment.uv_from_direction(directions))
    assert np.abs(back - directions).max() < 1e-12  # measured 8e-16


def test_constant_picture_is_constant_at_every_level():
    atlas = environment.build_atlas(np.full((37, 91, 3), 0.5, np.float32))
    directions = random_directions(500)
    for roughness in (0.0, 0.1, 0.5, 0.77, 1.0):
        got = environment_lookup.radiance(atlas, directions, np.full(500, roughness))
        assert np.abs(got - 0.5).max() < 1e-6  # measured 6e-8
    assert np.abs(environment_lookup.mean_radiance(atlas, directions) - 0.5).max() < 1e-6


@pytest.fixture(scope="module")
def linear_sky():
    """Radiance 1 + z, whose filtered versions are 1 + k z."""
    z = environment.texel_directions(512, 256)[..., 2:]
    return environment.build_atlas((1 + z).astype(np.float32).repeat(3, 2))


def test_irradiance_of_a_linear_sky(linear_sky):
    normal = random_directions(1000)
    got = environment_lookup.mean_radiance(linear_sky, normal)[:, 0]
    assert np.abs(got - (1 + 2 / 3 * normal[:, 2])).max() < 0.003  # measured 0.0012


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.5, 0.8, 1.0])
def test_reflection_of_a_linear_sky(linear_sky, roughness):
    u = (np.arange(20_000) + 0.5) / 20_000
    alpha2 = roughness**4
    cos_light = 2 * (1 - u) / (1 + (alpha2 - 1) * u) - 1
    weight = np.maximum(cos_light, 0)
    k = (weight * cos_light).sum() / weight.sum()
    direction = random_directions(1000)
    got = environment_lookup.radiance(linear_sky, direction, np.full(1000, roughness))[:, 0]
    assert np.abs(got - (1 + k * direction[:, 2])).max() < 0.015  # measured 0.0076


@pytest.mark.parametrize("size", [(16, 32), (300, 700), (1100, 2500)])
def test_all_light_is_kept(size):
    """A small bright window gives the same irradiance whatever the picture's size."""
    direction = environment.texel_directions(size[1], size[0])
    window = (direction @ [0.6, 0.0, 0.8] > np.cos(0.5)).astype(np.float32)[..., None]
    atlas = environment.build_atlas(window.repeat(3, 2))
    solid_angle = np.cos((np.arange(size[0]) + 0.5) / size[0] * np.pi - np.pi / 2) * 2 * np.pi**2 / size[0] / size[1]
    normal = random_directions(20)
    lit = direction[window[..., 0] > 0]
    weight = np.broadcast_to(solid_angle[:, None], size)[window[..., 0] > 0]
    want = (np.maximum(normal @ lit.T, 0) * weight).sum(1) / np.pi
    got = environment_lookup.mean_radiance(atlas, normal)[:, 0]
    assert np.abs(got - want).max() < 0.02 * want.max()  # measured 0.011 (32 texels), 0.0024


def test_bad_texels_do_not_spread():
    image = np.ones((32, 64, 3), np.float32)
    image[3, 4], image[5, 6, 0], image[7, 8] = np.nan, np.inf, -np.inf
    assert np.isfinite(environment.build_atlas(image)).all()


@pytest.mark.parametrize("size", [(37, 91), (128, 256), (900, 1800), (1500, 3000)])
def test_pictures_keep_their_texels(size):
    image = np.random.default_rng(3).uniform(0, 2, (*size, 3)).astype(np.float32)
    atlas = environment.build_atlas(image, widest=environment.WIDEST)
    np.testing.assert_array_equal(environment.atlas_level(atlas, 0), image)
    direction = environment.texel_directions(size[1], size[0]).reshape(-1, 3)[:: size[1] // 7]
    seen = environment_lookup.radiance(atlas, direction, np.zeros(len(direction)))
    assert np.abs(seen - image.reshape(-1, 3)[:: size[1] // 7]).max() < 1e-10  # measured 1.2e-12


def test_cameras_that_tell_more_texels_apart_get_them():
    assert environment.widest_image(2 * np.pi / 2400) == environment.WIDTHS[-1]
    assert environment.widest_image(2 * np.pi / 2500) == environment.WIDEST
    image = np.zeros((2048, 4096, 3), np.float32)
    image[:, ::2] = 1.0
    for widest in (2048, 4096):
        level = environment.atlas_level(environment.build_atlas(image, widest=widest), 0)
        assert level.shape == (widest // 2, widest, 3)
        assert level.mean() == 0.5
        assert level.std() == (0.5 if widest == 4096 else 0.0)


def test_large_pictures_are_averaged_down_to_the_largest_width():
    atlas = environment.build_atlas(np.ones((1300, 2600, 3), np.float32))
    assert atlas.shape == (1024 + 2 * environment.TILE[1], 2048, 4)
    assert environment.atlas_level(atlas, 0).shape == (1024, 2048, 3)
