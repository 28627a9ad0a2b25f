"""Pictures of expressions that vary with the direction, against the expressions."""

from __future__ import annotations

import numpy as np
import pytest

from pointsplat_addon.core.light import environment
from pointsplat_addon.core.light.world_picture import NARROWEST, WIDEST, picture_of, radiance_at
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import direction_nodes, input_nodes, math_nodes, texture_nodes
from pointsplat_addon.core.material.nodes.procedural import patterns

DIRECTION = input_nodes.Coordinates("position")
ZERO = input_nodes.Constant((0.0,))


def directions(count: int = 4000) -> np.ndarray:
    found = np.random.default_rng(7).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def shown(picture: np.ndarray, direction: np.ndarray) -> np.ndarray:
    return environment.bilinear(picture, environment.uv_from_direction(direction))


def test_smooth_expressions_have_small_pictures() -> None:
    square = math_nodes.VectorMath(DIRECTION, DIRECTION, DIRECTION, ZERO, "MULTIPLY")
    picture = picture_of(square)
    assert picture.shape[1] < 8 * NARROWEST
    error = np.abs(shown(picture, directions()) - directions() ** 2)
    assert error.max() < 0.002  # measured 0.0012


def test_edges_have_texels_of_their_own_size_and_are_smooth() -> None:
    checker = patterns.Checker(DIRECTION, input_nodes.Constant((3.3,)))
    picture = picture_of(checker)
    assert picture.shape == (WIDEST // 2, WIDEST, 3)
    assert set(np.unique(picture).tolist()) == {0.0, 0.25, 0.5, 0.75, 1.0}
    # The mean over the sphere beside that of many samples
    weight = np.cos(environment.texel_uv(WIDEST, WIDEST // 2)[..., 1] * np.pi - np.pi / 2)
    mean = (picture[..., 0] * weight).sum() / weight.sum()
    want = radiance_at(checker, directions(400_000))[:, 0]
    assert mean == pytest.approx(want.mean(), abs=4 * want.std() / np.sqrt(len(want)))


@pytest.mark.parametrize("direction", [(1.0, 0, 0), (0.3, 0.9, 0.1), (0, -1.0, 0), (0, 0, 1.0), (0.5, 0.5, -0.7)])
def test_a_mirror_ball_shows_what_it_reflects(direction: tuple[float, float, float]) -> None:
    """The ray along +Y that hits the ball where the picture shows a direction leaves in that direction."""
    unit = np.array([direction]) / np.linalg.norm(direction)
    node = direction_nodes.MirrorBall(DIRECTION)
    uv = radiance_at(node, unit)[0].astype(float)
    x, z = 2 * uv[0] - 1, 2 * uv[1] - 1
    normal = np.array([x, -np.sqrt(max(1 - x * x - z * z, 0)), z])
    ray = np.array([0.0, 1.0, 0.0])
    reflected = ray - 2 * (ray @ normal) * normal
    assert reflected == pytest.approx(unit[0], abs=1e-6)  # measured 1.4e-7


def test_pictures_of_images_have_their_texels() -> None:
    texels = np.random.default_rng(2).random((64, 128, 4)).astype(np.float32)
    image = texture_nodes.ImageTexture(direction_nodes.Equirectangular(DIRECTION), Image(texels))
    picture = picture_of(image)
    assert picture.shape[1] >= 128
    at = environment.texel_directions(128, 64)
    error = np.abs(radiance_at(image, at) - texels[..., :3])
    assert error.max() < 1e-5  # measured 5.4e-6
    # Between texels, around the seam, too, but for the poles, where Cycles repeats the picture
    near = directions()
    near = near[np.abs(near[:, 2]) < 0.99]
    error = np.abs(shown(picture, near) - radiance_at(image, near))
    assert error.max() < 0.04  # measured 0.028, of noise of the texels' size


def test_values_that_are_not_finite_are_black() -> None:
    infinite = math_nodes.VectorMath(DIRECTION, DIRECTION, DIRECTION, input_nodes.Constant((np.inf,)), "SCALE")
    assert np.isfinite(radiance_at(infinite, directions())).all()


def test_an_atlas_mirrors_one_picture_and_lights_by_another() -> None:
    diffuse, mirrored = np.full((8, 16, 3), 0.25, np.float32), np.full((4, 8, 3), 2.0, np.float32)
    atlas = environment.build_atlas(diffuse, mirrored)
    for level in range(len(environment.ROUGHNESS) + 1):
        np.testing.assert_allclose(environment.atlas_level(atlas, level), 2.0, rtol=1e-6)
    np.testing.assert_allclose(environment.atlas_level(atlas, len(environment.ROUGHNESS) + 1), 0.25, rtol=1e-6)
