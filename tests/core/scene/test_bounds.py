"""Boxes and balls hold what they are around, and are no larger than they have to be."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.bounds import bounding_box, box_corners, cloud_ball, mesh_centre, triangles_ball
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.mesh import Mesh


def points(count: int = 500, scale: float = 1.0) -> np.ndarray:
    return (scale * np.random.default_rng(1).normal(size=(count, 3))).astype(np.float32)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e15])
def test_a_cloud_s_ball_holds_its_points(scale):
    position = points(scale=scale)
    cloud = PointCloud(position, np.array([3.0, 4, 5]), radii=np.full((500, 1), 0.5, np.float32))
    centre, distance, radius = cloud_ball(cloud)
    away = np.linalg.norm(position.astype(float) + cloud.origin - centre, axis=1)
    assert away.max() <= distance * (1 + 1e-6) + 1e-14  # rounding of sums with the origin
    assert distance <= away.max() * (1 + 1e-4) + 1e-14
    assert radius == 0.5


def test_boxes_and_their_corners():
    position = points()
    low, high = bounding_box(position)
    np.testing.assert_array_equal([low, high], [position.min(axis=0), position.max(axis=0)])
    corners = box_corners(low, high)
    np.testing.assert_array_equal(bounding_box(corners), [low, high])
    assert len(np.unique(corners, axis=0)) == 8
    np.testing.assert_array_equal(bounding_box(position[:0]), np.zeros((2, 3)))


def test_a_mesh_s_ball_is_that_of_its_triangles():
    position = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [9, 9, 9]], np.float32)
    mesh = Mesh("m", "m", position, np.array([[0, 1, 2]], np.int32))
    centre, radius = triangles_ball(mesh)
    np.testing.assert_array_equal(centre, [1, 1, 0])
    assert radius == pytest.approx(2**0.5)
    np.testing.assert_array_equal(mesh_centre(mesh), [4.5, 4.5, 4.5])
