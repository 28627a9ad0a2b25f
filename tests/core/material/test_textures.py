"""Pictures over splats: means of Gaussians, against closed forms."""

import numpy as np
import pytest

from pointsplat_addon.core.material.expression import SampleInputs, evaluate
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import input_nodes, math_nodes, texture_nodes
from pointsplat_addon.core.material.textures import MOST_ASPECT, SPREAD, Pyramid, footprint_axes

SIZE = 512


def pyramid(texels: np.ndarray) -> Pyramid:
    return Pyramid(lambda rows: texels[rows], (texels.shape[1], texels.shape[0]))


def picture(values: np.ndarray) -> Image:
    """Grey floats (H, W) as a picture."""
    return Image(np.repeat(values[..., None], 4, axis=2).astype(np.float32))


def inputs_with(uv: np.ndarray, footprint: np.ndarray, rough: bool = False) -> SampleInputs:
    """Samples at `uv` (N, 2) of splats with the half-diameters `footprint` (N, 2, 2)."""
    first, second = (SampleInputs(uv={"map": uv + footprint[:, k]}) for k in range(2))
    return SampleInputs(uv={"map": uv}, displaced=(first, second), rough=rough)


def shown(image: Image, uv: np.ndarray, footprint: np.ndarray, rough: bool = False, **node) -> np.ndarray:
    """(N,) of the first channel: the picture at splats whose half-diameters are `footprint` (N, 2, 2)."""
    inputs = inputs_with(uv.astype(np.float32), footprint.astype(np.float32), rough)
    return evaluate(texture_nodes.ImageTexture(input_nodes.UV("map"), image, **node), inputs)[:, 0]


@pytest.mark.parametrize("size", [(8, 8), (7, 13), (1, 5), (600, 513), (514, 3)])
def test_every_level_has_the_pictures_mean(size):
    texels = np.random.default_rng(1).random((size[1], size[0], 4)).astype(np.float32)
    levels = pyramid(texels).levels
    assert levels[-1].shape == (1, 1, 4)
    for level in levels:
        # measured 7e-7
        np.testing.assert_allclose(
            level.mean(axis=(0, 1), dtype=float), texels.mean(axis=(0, 1), dtype=float), rtol=3e-6
        )


def test_axes_are_those_of_the_covariance():
    rng = np.random.default_rng(2)
    footprint = rng.normal(0, 0.02, (1000, 2, 2))
    major, minor, along = footprint_axes(footprint, (300, 200))
    texels = footprint * [300, 200] * SPREAD
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", texels, texels))
    np.testing.assert_allclose(major, np.sqrt(values[:, 1]), rtol=1e-9)  # measured 4e-12
    widened = np.maximum(np.sqrt(np.maximum(values[:, 0], 0)), major / MOST_ASPECT)
    np.testing.assert_allclose(minor, widened, rtol=1e-6)  # measured 2e-9
    np.testing.assert_allclose(np.abs((along * vectors[:, :, 1]).sum(axis=1)), 1, atol=1e-9)  # measured 1e-12


@pytest.mark.parametrize(("aspect", "worst"), [(1.0, 0.12), (2.5, 0.09), (4.0, 0.13)])
def test_waves_fade_as_under_a_gaussian(aspect, worst):
    """A wave of `cycles` per picture under a Gaussian keeps exp(-2 (pi cycles sigma)^2) of its amplitude."""
    rng = np.random.default_rng(3)
    count = 400
    uv = rng.random((count, 2))
    across = rng.uniform(1, 24, count) / SIZE / SPREAD / 2  # half-axes for deviations of 0.5 to 12 texels
    angle = rng.uniform(0, np.pi, count)
    major = np.stack([np.cos(angle), np.sin(angle)], 1) * (aspect * across)[:, None]
    minor = np.stack([-np.sin(angle), np.cos(angle)], 1) * across[:, None]
    footprint = np.stack([major, minor], 1)
    errors = []
    for wave in ((1, 0), (0, 3), (5, 4), (12, -9), (30, 20)):
        phase = 2 * np.pi * (np.add.outer(wave[1] * (np.arange(SIZE) + 0.5), wave[0] * (np.arange(SIZE) + 0.5)) / SIZE)
        image = picture(np.cos(phase))
        spread = np.einsum("nki,i->nk", footprint * SPREAD, np.array(wave, float))
        kept = np.exp(-2 * np.pi**2 * (spread**2).sum(axis=1))
        truth = kept * np.cos(2 * np.pi * (uv @ np.array(wave, float)))
        errors.append(np.abs(shown(image, uv, footprint) - truth).max())
    # Of an amplitude of 1. Measured 0.103, 0.074 and 0.112, of waves near what a level can show.
    assert max(errors) < worst


def test_a_fine_checkerboard_is_grey_from_afar():
    board = np.indices((SIZE, SIZE)).sum(axis=0) // 2 % 2
    uv = np.random.default_rng(4).random((500, 2))
    footprint = np.broadcast_to(np.eye(2) * 16 / SIZE, (500, 2, 2))
    found = shown(picture(board), uv, footprint)
    np.testing.assert_allclose(found, 0.5, atol=1e-3)  # measured 0
    alone = shown(picture(board), uv, np.zeros((500, 2, 2)))
    assert alone.std() > 0.3  # what no filter would show


@pytest.mark.parametrize("interpolation", ["Linear", "Closest", "Cubic"])
def test_magnified_pictures_are_interpolated_as_ever(interpolation):
    rng = np.random.default_rng(5)
    image = picture(rng.random((16, 16)))
    uv = rng.random((200, 2))
    footprint = np.broadcast_to(np.eye(2) * 0.5 / 16, (200, 2, 2))
    name = input_nodes.UV("map")
    plain = evaluate(
        texture_nodes.ImageTexture(name, image, interpolation), SampleInputs(uv={"map": uv.astype(np.float32)})
    )[:, 0]
    np.testing.assert_array_equal(shown(image, uv, footprint, interpolation=interpolation), plain)


def test_colours_are_decoded_before_they_are_averaged():
    """Half black, half white in sRGB codes: half of the light."""
    texels = np.zeros((64, 64, 4), np.uint8)
    texels[:, ::2] = 255
    uv = np.full((1, 2), 0.5)
    found = shown(Image(texels, srgb=True), uv, np.eye(2)[None] * 0.2)
    np.testing.assert_allclose(found, 0.5, atol=1e-6)  # measured 0


def test_footprints_go_through_the_mapping():
    """A picture that repeats ten times on the surface is filtered ten times as widely."""
    board = np.indices((64, 64))[1] // 8 % 2
    uv = np.random.default_rng(6).random((300, 2)).astype(np.float32)
    step = np.broadcast_to(np.eye(2, dtype=np.float32) * 0.02, (300, 2, 2))
    inputs = inputs_with(uv, step)
    spread = {}
    for scale in (1.0, 20.0):
        none = input_nodes.Constant((0.0, 0.0, 0.0))
        scaled = math_nodes.Mapping(input_nodes.UV("map"), none, none, input_nodes.Constant((scale, scale, scale)))
        spread[scale] = evaluate(texture_nodes.ImageTexture(scaled, picture(board)), inputs)[:, 0].std()
    assert spread[1.0] > 0.45  # measured 0.48
    assert spread[20.0] < 1e-3  # measured 3e-8


def test_what_is_not_finite_counts_as_a_point():
    image = picture(np.random.default_rng(7).random((16, 16)))
    uv = np.full((3, 2), 0.3)
    footprint = np.array([np.nan, np.inf, -np.inf])[:, None, None] * np.ones((3, 2, 2))
    with np.errstate(all="ignore"):
        found = shown(image, uv, footprint)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("across", [2.0, 5.5, 16.0])
def test_one_sample_is_as_wide_as_the_splat(across):
    """By the variance of white noise under a splat, over that of a texel: 1 / (4 pi s^2) of a Gaussian of the deviation
    s in texels. One sample of a level of about that size has 0.7 to 1.5 times that deviation."""
    noise = np.random.default_rng(8).normal(0, 1, (SIZE, SIZE))
    uv = np.random.default_rng(9).random((4000, 2))
    footprint = np.broadcast_to(np.eye(2) * across / SIZE, (4000, 2, 2))
    spread = SPREAD * across
    found = shown(picture(noise), uv, footprint, rough=True).std() * np.sqrt(4 * np.pi) * spread
    assert 1 / 1.5 < found < 1 / 0.7  # measured 0.95, 1.31 and 0.97


def test_long_splats_take_one_sample_of_their_area():
    board = np.indices((SIZE, SIZE)).sum(axis=0) // 2 % 2
    uv = np.random.default_rng(4).random((500, 2))
    footprint = np.broadcast_to(np.diag([64, 8]) / SIZE, (500, 2, 2))
    np.testing.assert_allclose(shown(picture(board), uv, footprint, rough=True), 0.5, atol=1e-6)  # measured 0


@pytest.mark.parametrize("interpolation", ["Linear", "Closest", "Cubic"])
def test_one_sample_of_what_is_magnified_is_as_ever(interpolation):
    image = picture(np.random.default_rng(5).random((16, 16)))
    uv = np.random.default_rng(6).random((200, 2))
    footprint = np.broadcast_to(np.eye(2) * 0.5 / 16, (200, 2, 2))
    fine, rough = (shown(image, uv, footprint, which, interpolation=interpolation) for which in (False, True))
    np.testing.assert_array_equal(fine, rough)
