"""A picture of the world that is out of focus: the grid, and its disk."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lens.backdrop import DISK_TEXELS, FINEST, backdrop_grid
from pointsplat_addon.core.light import environment
from pointsplat_addon.core.scene.camera import Aperture
from scripts.scenes.cameras import camera
from tests.reference.backdrop import TAPS, blur_backdrop, disk_weights, sharp_backdrop
from tests.reference.defocus import PIXEL

SEEN = camera(resolution=(96, 64))


def through(radius: float, ratio: float = 1.0, focus: float = 4.0):
    return replace(SEEN, aperture=Aperture(radius, focus, ratio=ratio))


@pytest.mark.parametrize("ratio", [1.0, 0.4])
@pytest.mark.parametrize("radius", [0.02, 0.1, 0.5, 3.0, 1e4])
def test_the_grid_holds_the_picture_and_never_more_texels_than_four_a_pixel_and_the_disk(radius, ratio):
    grid = backdrop_grid(through(radius, ratio), 4096)
    for pixels, step, disk, size, larger in zip((96, 64), grid.step, grid.radius, grid.size, grid.larger, strict=True):
        assert step >= FINEST
        assert disk <= DISK_TEXELS
        # The centres of the first and the last texel lie outside the first and the last pixel's.
        assert -0.5 * step <= 0.5
        assert (size - 1.5) * step >= pixels - 0.5
        assert larger <= pixels / FINEST + 2 * DISK_TEXELS + 8
    assert grid.margin >= max(grid.radius) + 0.5


def test_a_picture_as_large_as_a_texture_may_be_fits_one():
    grid = backdrop_grid(through(0.02), 96)
    assert max(grid.larger) <= 96


@pytest.mark.parametrize(("radius", "ratio"), [(0.2, 1.0), (0.2, 0.5), (1.0, 1.0), (0.06, 1.0), (0.03, 1.0)])
def test_the_disk_has_the_moments_of_the_circle_of_confusion(radius, ratio):
    seen = through(radius, ratio)
    grid = backdrop_grid(seen, 4096)
    disk = disk_weights(grid)
    row = np.arange(-grid.margin, grid.margin + 1)
    fx, fy = SEEN.pixel_from_view()[:2]
    for axis, wanted in ((0, fx * radius / 4 / ratio), (1, fy * radius / 4)):
        found = (disk.sum(axis=axis) * row**2).sum() / disk.sum() + np.var(TAPS)
        # In texels, which are pixels where the disk is small: what is left of the variance is a pixel's own.
        rest = found - (wanted / grid.step[axis]) ** 2 / 4
        assert abs(rest - PIXEL) < 0.1  # measured 0.056


def test_a_world_of_one_colour_stays_so():
    atlas = environment.build_atlas(np.full((32, 64, 3), 0.5, np.float32))
    grid = backdrop_grid(through(0.5), 4096)
    picture = blur_backdrop(sharp_backdrop(atlas, grid, SEEN, np.eye(3)), grid)
    assert picture.shape == (grid.size[1], grid.size[0], 3)
    assert np.abs(picture - 0.5).max() < 1e-6  # measured 6e-8


@pytest.mark.parametrize(("tilt", "allowed"), [(0.0, 0.12), (1.2, 0.15)])  # measured 0.075 and 0.096
@pytest.mark.parametrize("radius", [0.1, 0.5, 2.0])
def test_a_small_sun_keeps_its_light_wherever_it_lies_among_texels(radius, tilt, allowed):
    """A single texel of a large picture, on the horizon and 21 degrees beside the zenith."""
    along, up = np.array([0.0, np.cos(tilt), -np.sin(tilt)]), np.array([0.0, np.sin(tilt), np.cos(tilt)])
    image_from_world = np.stack([along, np.array([-1.0, 0.0, 0.0]), up])
    directions = environment.texel_directions(1024, 512)
    view = image_from_world @ np.array([0.0, 1.0, 0.0])
    row, column = np.unravel_index((directions @ view).argmax(), (512, 1024))
    grid = backdrop_grid(through(radius), 4096)
    solid_angle = np.cos((row + 0.5) / 512 * np.pi - np.pi / 2) * 2 * np.pi**2 / 1024 / 512
    for shift in (0, 3, 6):
        image = np.zeros((512, 1024, 3), np.float32)
        image[row, (column + shift) % 1024] = 1e4
        atlas = environment.build_atlas(image)
        found = sharp_backdrop(atlas, grid, SEEN, image_from_world)[..., 0].sum() * np.prod(grid.step)
        cosine = directions[row, (column + shift) % 1024] @ view
        light = 1e4 * solid_angle * np.abs(np.prod(SEEN.pixel_from_view()[:2])) / cosine**3
        assert abs(found / light - 1) < allowed
