"""Radii in pixels of a view against the projection of a ball, in perspective and parallel views."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.splat.pixel_radii import with_pixel_radii
from scripts.scenes.cameras import camera

PIXELS = 2.5


def scene_of(cloud: PointCloud, matrices: np.ndarray, **settings) -> Scene:
    geometry = Geometry("cloud", "Cloud", cloud=cloud, pixel_radius=PIXELS, **settings)
    return Scene((geometry,), Instances(np.zeros(len(matrices), np.int32), matrices), default_materials())


def points(count: int = 100, **attributes) -> PointCloud:
    position = np.random.default_rng(3).uniform(-1, 1, (count, 3)).astype(np.float32)
    return PointCloud(position, radii=np.full((count, 1), 0.01, np.float32), **attributes)


def moved(scale: float, offset: tuple[float, float, float]) -> np.ndarray:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = offset
    return matrix


@pytest.mark.parametrize("parallel", [None, 6.0])
def test_a_ball_is_as_wide_in_the_picture_wherever_it_is(parallel: float | None) -> None:
    view = camera(eye=(0, -4, 0), resolution=(640, 360), parallel=parallel)
    matrices = np.stack([moved(1, (0, 0, 0)), moved(3, (0, 20, 0)), moved(0.1, (1, 5, 1))])
    cloud = replace(points(), origin=np.array([0.5, 0.25, -0.5]))
    found = with_pixel_radii(scene_of(cloud, matrices), view)
    assert len(found.geometries) == 3
    for matrix, row in zip(matrices, found.instances.geometry, strict=True):
        sized = found.geometries[row].cloud
        assert sized is not None
        assert sized.radii is not None
        world = (cloud.position + cloud.origin) @ matrix[:3, :3].T + matrix[:3, 3]
        depth = -(world @ view.view_from_world[2, :3] + view.view_from_world[2, 3])
        focal = view.pixel_from_view()[0]
        width = sized.radii[:, 0] * matrix[0, 0] * focal / (1.0 if parallel else depth)
        np.testing.assert_allclose(width, PIXELS, rtol=2e-6)  # measured 5e-7


def test_instances_that_see_the_same_radii_share_them() -> None:
    matrices = np.stack([moved(1, (0, 0, 0)), moved(1, (3, 0, 1)), moved(2, (0, 0, 0))])
    found = with_pixel_radii(scene_of(points(), matrices), camera(parallel=5.0))
    assert found.instances.geometry.tolist() == [0, 0, 1]
    found = with_pixel_radii(scene_of(points(), matrices), camera(eye=(1, -4, 2)))
    assert sorted(found.instances.geometry.tolist()) == [0, 1, 2]


def test_a_scene_without_such_radii_is_the_same_object() -> None:
    scene = scene_of(points(), np.eye(4)[None])
    scene = replace(scene, geometries=(replace(scene.geometries[0], pixel_radius=0.0),))
    assert with_pixel_radii(scene, camera()) is scene


def test_keys_tell_views_apart_and_are_those_of_equal_views() -> None:
    scene = scene_of(points(), np.eye(4)[None])
    keys = [with_pixel_radii(scene, camera(eye=eye)).geometries[0].key for eye in ((0, -4, 0), (0, -4, 0), (0, -5, 0))]
    assert keys[0] == keys[1]
    assert keys[0] != keys[2]


def test_what_lies_behind_the_camera_has_a_radius() -> None:
    found = with_pixel_radii(scene_of(points(), np.eye(4)[None]), camera(eye=(0, 0, 0), target=(0, 1, 0)))
    cloud = found.geometries[0].cloud
    assert cloud is not None
    assert cloud.radii is not None
    assert cloud.radii.min() > 0


def test_ellipses_are_limited_and_keep_their_form() -> None:
    count = 50
    radii = np.linspace(0.001, 0.2, 2 * count, dtype=np.float32).reshape(count, 2)[:, ::-1].copy()
    cloud = replace(
        points(count),
        radii=radii,
        normal=np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
        axis=np.tile(np.array([1, 0, 0], np.float32), (count, 1)),
    )
    view = camera()
    found = with_pixel_radii(scene_of(cloud, np.eye(4)[None]), view).geometries[0].cloud
    balls = with_pixel_radii(scene_of(points(count), np.eye(4)[None]), view).geometries[0].cloud
    assert found is not None
    assert balls is not None
    assert found.radii is not None
    assert balls.radii is not None
    np.testing.assert_array_equal(found.radii, np.minimum(radii, balls.radii))


def test_translucent_points_keep_their_alpha_and_media_their_extinction() -> None:
    count = 20
    extinction = np.full(count, 8.0, np.float32)
    cloud = points(count, extinction=extinction, emission=np.ones((count, 3), np.float32))
    view = camera()
    found = with_pixel_radii(scene_of(cloud, np.eye(4)[None]), view).geometries[0].cloud
    assert found is not None
    assert found.radii is not None
    assert found.extinction is not None
    assert found.emission is not None
    np.testing.assert_allclose(found.extinction * found.radii[:, 0], 8.0 * 0.01, rtol=1e-6)
    np.testing.assert_allclose(found.emission * found.radii, 0.01, rtol=1e-6)
    medium = with_pixel_radii(scene_of(cloud, np.eye(4)[None], extinction=8.0), view).geometries[0].cloud
    assert medium is not None
    assert medium.extinction is extinction
