"""The picture in the viewport: its own pixels, and wider ones between whose centres colours change evenly."""

import numpy as np
import pytest

from pointsplat_addon.render.passes.output import present
from scripts.scenes.drawing import opengl

pytest.importorskip("moderngl")
SIZE, CORNER, TIMES, SAMPLES = (5, 3), (2, 1), 4, 3  # of the picture, where it lies in its texture, width of its pixels


def presented(picture: np.ndarray, smooth: bool) -> np.ndarray:
    """Sums of SAMPLES samples as a viewport with TIMES as many pixels each way shows them."""
    device = opengl().device
    high, wide = picture.shape[:2]
    program, uniforms = present.present_program(False, smooth=smooth), present.present_block(False)
    record = uniforms.record(size=SIZE, corner=CORNER, sample_weight=1 / SAMPLES)
    target = device.target([device.texture((TIMES * SIZE[0], TIMES * SIZE[1]), "RGBA32F")])
    combined = device.texture((wide, high), "RGBA32F", picture)
    device.draw(program, target, uniforms=record, textures={"ps_combined": combined})
    return device.read(target.colors[0])


def between(values: np.ndarray, axis: int) -> np.ndarray:
    """Values at the centres of pixels, at those of TIMES as many along an axis; beyond the outer ones they stay."""
    count = values.shape[axis]
    at = np.clip((np.arange(TIMES * count) + 0.5) / TIMES - 0.5, 0, count - 1)
    low = np.minimum(at.astype(int), count - 2)
    part = (at - low).reshape([-1 if k == axis else 1 for k in range(values.ndim)])
    return values.take(low, axis) * (1 - part) + values.take(low + 1, axis) * part


@pytest.fixture
def picture() -> np.ndarray:
    """Random sums, with what does not belong to the picture around them."""
    picture = np.full((SIZE[1] + 2, SIZE[0] + 3, 4), 1e6, np.float32)
    own = np.random.default_rng(5).uniform(0, SAMPLES, (SIZE[1], SIZE[0], 4))
    picture[CORNER[1] : CORNER[1] + SIZE[1], CORNER[0] : CORNER[0] + SIZE[0]] = own
    return picture


def own(picture: np.ndarray) -> np.ndarray:
    within = picture[CORNER[1] : CORNER[1] + SIZE[1], CORNER[0] : CORNER[0] + SIZE[0]]
    return within.astype(np.float64) / SAMPLES


def test_pixels_that_are_wider_than_the_viewports_are_squares(picture):
    expected = own(picture).repeat(TIMES, 0).repeat(TIMES, 1)
    np.testing.assert_allclose(presented(picture, smooth=False), expected, rtol=0, atol=1e-6)  # measured: 6e-8


def test_between_the_centres_of_wider_pixels_colours_change_evenly(picture):
    expected = between(between(own(picture), 0), 1)
    np.testing.assert_allclose(presented(picture, smooth=True), expected, rtol=0, atol=2e-6)  # measured: 3e-7
