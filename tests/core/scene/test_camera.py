"""Cameras with coarser pixels."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera

PERSPECTIVE = np.array([[2.0, 0, 0.3, 0], [0, 3.0, -0.1, 0], [0, 0, -1.1, -0.2], [0, 0, -1, 0]])
PARALLEL = np.array([[0.2, 0, 0, 0.3], [0, 0.3, 0, -0.1], [0, 0, -0.1, 0], [0, 0, 0, 1.0]])


def pixel(camera, point):
    fx, fy, cx, cy = camera.pixel_from_view()
    d = -point[2] if camera.perspective else 1.0
    return np.array([cx + fx * point[0] / d, cy + fy * point[1] / d])


@pytest.mark.parametrize("clip_from_view", [PERSPECTIVE, PARALLEL])
@pytest.mark.parametrize("region", [None, (40, 7, 101, 60)])
@pytest.mark.parametrize("times", [1, 2, 3, 8])
def test_a_point_stays_where_it_is_in_the_window(clip_from_view, region, times):
    camera = Camera(np.eye(4), clip_from_view, (320, 200), region)
    coarse = camera.with_coarser_pixels(times)
    size, here = np.array(camera.window[2:]), np.array(coarse.window[2:])
    assert (np.abs(here * times - size) <= times / 2).all()
    assert coarse.perspective == camera.perspective
    for point in ([0.3, -0.2, -4.0], [-0.1, 0.4, -2.0]):
        np.testing.assert_allclose(pixel(coarse, point) / here, pixel(camera, point) / size, rtol=1e-12)


def test_no_window_is_too_small():
    camera = Camera(np.eye(4), PERSPECTIVE, (320, 200), (5, 5, 2, 1))
    assert camera.with_coarser_pixels(8).window == (0, 0, 1, 1)
