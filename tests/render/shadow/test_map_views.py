"""Views from lights without size: what they see, and where their texels lie."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
# Lights may have no views; those that are asked for have some.
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.bounds import box_corners
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.render.shadow import map_views
from pointsplat_addon.render.shadow.light_points import NARROW, views_of_light
from pointsplat_addon.render.shadow.map_views import MARGIN, CastingBoxes, MapView, angular_reach, light_views, placed
from pointsplat_addon.render.shadow.maps import ShadowMaps

RNG = np.random.default_rng(3)
DOWN = np.array([0.0, 0.0, -1.0])
SUN = Light("SUN", np.ones(3), np.zeros(3), np.array([0.36, 0.48, -0.8]))
ABOVE = Light("POINT", np.ones(3), np.array([1.0, -2.0, 9.0]), DOWN)
AMONG = Light("POINT", np.ones(3), np.array([0.1, 0.2, 0.3]), DOWN)
SPOT = Light("SPOT", np.ones(3), np.array([0.0, 0.0, 3.0]), DOWN, spot_cos=float(np.cos(0.3)))


def boxes(count: int = 20, radius: float = np.inf) -> CastingBoxes:
    """Cubes of a tenth about the origin."""
    low = RNG.uniform(-2, 2, (count, 3))
    return CastingBoxes(np.stack([box_corners(one, one + 0.1) for one in low]), np.full(count, radius))


CASTERS = boxes()


def texels(view: MapView, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where points (N, 3) in the world lie in a view, (N, 2) texels, and their depth."""
    local = (points - view.origin) @ view.axes.T
    place = local[:, :2] if view.parallel else local[:, :2] / local[:, 2:]
    return (place - view.low) / view.step, local[:, 2]


@pytest.mark.parametrize("light", [SUN, ABOVE, AMONG, SPOT], ids=["sun", "above", "among", "spot"])
def test_a_view_is_the_picture_of_its_camera(light):
    for view in light_views(light, boxes(), 256).views:
        points = RNG.uniform(-2, 2, (100, 3))
        expected, depth = texels(view, points)
        camera = view.camera
        seen = points @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
        fx, fy, cx, cy = camera.pixel_from_view()
        scale = 1.0 if view.parallel else 1 / -seen[:, 2:]
        np.testing.assert_allclose(seen[:, :2] * scale * [fx, fy] + [cx, cy], expected, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(-seen[:, 2], depth, atol=1e-9)
        assert np.isclose(np.linalg.det(camera.view_from_world[:3, :3]), 1.0)


@pytest.mark.parametrize("light", [SUN, ABOVE], ids=["sun", "above"])
def test_one_view_holds_all_casters_and_a_margin(light):
    casters = boxes()
    found = light_views(light, casters, 256)
    [view] = found.views
    place, depth = texels(view, casters.corners.reshape(-1, 3))
    size = np.array(view.size)
    assert (place >= MARGIN - 1e-6).all()
    assert (place <= size - MARGIN + 1e-6).all()
    assert (depth > view.near).all()
    assert (depth < view.far).all()
    assert place.min(axis=0).max() < MARGIN + 1  # and no more
    assert (size - place.max(axis=0)).min() < MARGIN + 1


def test_a_light_among_casters_sees_them_through_the_faces_of_a_cube():
    casters = boxes(200)
    found = light_views(AMONG, casters, 256)
    assert found.kind == "CUBE"
    points = casters.corners.reshape(-1, 3)
    offset = points - AMONG.position
    axis = np.abs(offset).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(offset, axis[:, None], axis=1)[:, 0] < 0)
    for i, view in enumerate(found.views):
        place, depth = texels(view, points[face == i])
        assert (depth > 0).all()
        assert ((place >= 0) & (place <= view.size)).all()


def test_a_face_without_casters_has_no_view():
    corners = boxes().corners
    corners[..., 2] = np.abs(corners[..., 2]) * 0.01 - 1.0  # a layer below the light, wider than a cone
    casters = CastingBoxes(corners, np.full(len(corners), np.inf))
    views = light_views(replace(AMONG, position=np.zeros(3)), casters, 64).views
    assert views[4] is None
    assert views[5] is not None


def test_a_spot_sees_no_more_than_its_cone():
    casters = boxes(200)
    [view] = light_views(SPOT, casters, 256).views
    assert max(view.size) * view.step <= 2 * np.tan(0.3) + (2 * MARGIN + 1) * view.step


def test_small_splats_ask_for_finer_texels():
    coarse, fine = (light_views(SUN, replace(CASTERS, radius=np.full(20, r)), 256).views[0] for r in (1.0, 1e-6))
    assert max(coarse.size) == map_views.FINER * 256 + 2 * MARGIN
    assert max(fine.size) == map_views.FINEST * 256 + 2 * MARGIN
    wanted = max(coarse.size) * coarse.step / 256 / 2
    between = light_views(SUN, replace(CASTERS, radius=np.full(20, wanted)), 256).views[0]
    assert between.step <= wanted / 2


def test_maps_of_many_lights_share_a_texture_without_overlap():
    lights = [replace(AMONG, position=RNG.uniform(-1, 1, 3)) for _ in range(7)]
    views, (width, height) = placed([None, *(light_views(light, boxes(), 64) for light in lights)], 512)
    assert views[0] is None
    taken = np.zeros((height, width), int)
    for view in (view for one in views if one is not None for view in one.views if view is not None):
        x, y = view.corner
        taken[y : y + view.size[1], x : x + view.size[0]] += 1
    assert taken.max() == 1
    assert width <= 512
    assert taken.mean() > 0.5  # measured 0.79


def test_many_lights_have_fewer_texels_each():
    one = light_views(AMONG, boxes(), 1024)
    views, (width, height) = placed([one] * 300, 8192)
    total = sum(view.size[0] * view.size[1] for light in views for view in light.views)
    assert 0.75 * map_views.MOST_TEXELS < total <= map_views.MOST_TEXELS
    assert height * width < 1.2 * map_views.MOST_TEXELS


def test_records_take_points_of_the_picture_to_texels():
    casters = boxes(200)
    lights, size = placed([None, light_views(SUN, casters, 64), light_views(AMONG, casters, 64)], 512)
    maps = ShadowMaps(None, tuple(lights), size, ())
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    view_from_world = np.eye(4)
    view_from_world[:3, :3] = turn * np.linalg.det(turn)
    view_from_world[:3, 3] = 0.5, -2.0, 1.0
    records = maps.records(view_from_world)
    assert records[0, 3, 0] == 0
    point = np.array([0.3, -0.4, 0.1])
    seen = np.append(view_from_world[:3, :3] @ point + view_from_world[:3, 3], 1.0)
    [sun] = lights[1].views
    local = records[1, :3] @ seen
    expected = texels(sun, point[None])[0][0] + sun.corner
    np.testing.assert_allclose(records[1, 4, :2] + records[1, 4, 2] * local[:2], expected, rtol=1e-4)
    np.testing.assert_allclose(records[2, :3] @ seen, point - AMONG.position, atol=1e-5)


def test_lights_that_what_casts_sees_as_narrow_have_fewer_views():
    near, sharp = replace(AMONG, radius=0.3), replace(AMONG, radius=0.0)
    far = replace(near, position=np.array([0.0, 0.0, 100.0]))
    assert angular_reach(sharp, CASTERS) is None
    sun, apart, among = (angular_reach(light, CASTERS) for light in (replace(SUN, radius=0.01), far, near))
    assert sun is not None
    assert apart is not None
    assert among is not None
    assert abs(sun - 0.01) < 1e-6
    assert 0.3 / 103 < apart < NARROW < among
    counts = [[views_of_light(reach, drawn) for drawn in (100, 1 << 18, 1 << 24)] for reach in (0.009, 0.1)]
    assert counts == [[8, 4, 4], [32, 16, 4]]
