"""Where a camera sees surfaces: on them, in the picture, and the nearest."""

import numpy as np
import pytest

from pointsplat_addon.core.surface.seen import seen_places, sketch_of_points, sketch_of_triangles
from scripts.scenes import cameras, meshes

WALL = sketch_of_triangles(np.array([[-50, 0, -50], [50, 0, -50], [0, 0, 90]], float), np.array([[0, 1, 2]]))
BALL = meshes.sphere_mesh("ball that is seen", 48)
VIEWS = {
    "perspective": cameras.camera((0, -4, 0), resolution=(80, 60)),
    "parallel": cameras.camera((0, -4, 0), resolution=(80, 60), parallel=3.0),
    "a part": cameras.camera((0, -4, 0), resolution=(160, 120), region=(40, 30, 80, 60)),
}


@pytest.mark.parametrize("name", VIEWS)
def test_places_lie_on_the_nearest_surfaces_in_the_picture(name):
    """A ball of a radius of 0.5 before a wall of one triangle, 2 behind it."""
    camera = VIEWS[name]
    behind, small = np.eye(4), np.diag([0.5, 0.5, 0.5, 1.0])
    behind[1, 3] = 2.0
    ball = sketch_of_triangles(BALL.position, BALL.triangles)
    places, pixel, cell = seen_places(camera, [(WALL, behind[None]), (ball, small[None])])
    assert len(places) == 40 * 30
    wall = places[:, 1] > 1
    assert wall.any()
    assert not wall.all()
    np.testing.assert_allclose(places[wall, 1], 2.0, atol=1e-9)
    radius = np.linalg.norm(BALL.position, axis=1).max() * 0.5
    away = np.linalg.norm(places[~wall], axis=1)
    assert (away < radius * 1.0001).all()
    assert (away > radius * 0.98).all()
    assert (places[~wall, 1] < 0.1).all()  # on the side that faces the camera
    assert cell == 2.0
    fx, fy, cx, cy = camera.pixel_from_view()
    depth = places[:, 1] + 4
    scale = depth if camera.perspective else 1.0
    np.testing.assert_allclose(pixel, scale / fx if camera.perspective else 1 / fx)
    at = np.stack([places[:, 0] * fx / scale + cx, places[:, 2] * fy / scale + cy], axis=1)
    assert (at > 0).all()
    assert (at < [80, 60]).all()


def test_what_is_not_finite_is_not_seen():
    points = np.array([[0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 1]])
    places, _, _ = seen_places(VIEWS["perspective"], [(sketch_of_points(points), np.eye(4)[None])])
    np.testing.assert_allclose(places, [[0, 0, 0]], atol=1e-12)
    assert len(seen_places(VIEWS["perspective"], [])[0]) == 0
