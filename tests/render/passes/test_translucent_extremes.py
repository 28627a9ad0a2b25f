"""Odd media, lamps and instances, through the whole of rendering: what they are wrong in stays theirs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.kernel import PEAK
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, clouds, drawing, meshes
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from tests.support.transmittance import voxels

COMBINED = frozenset({"combined"})

SIZE = (64, 48)
EYE = camera((0, -6, 1.5), (0, 0, 0), resolution=SIZE)
GREY = np.full(3, 0.6, np.float32)


def lamp(position=(0.0, -1.0, 3.0), radius=0.0, kind="POINT", strength=60.0):
    return Light(kind, np.full(3, strength), np.array(position, float), np.array([0.0, 0, -1]), radius=radius)


def balls(position, radius: float | None = 0.3, extinction: float | list[float] = 1.0, **more):
    position = np.asarray(position, np.float32).reshape(-1, 3)
    count = len(position)
    radii = None if radius is None else np.broadcast_to(np.float32(radius), (count,))[:, None].copy()
    strength = np.broadcast_to(np.asarray(extinction, np.float32), (count,)).copy()
    return PointCloud(position, radii=radii, extinction=strength, color=np.tile(GREY, (count, 1)), **more)


def draw(made, eye_camera=EYE, shadows=True, samples=1):
    settings = Settings(technique="IMAGE_SPACE", use_shadows=shadows, shadow_resolution=128)
    result = drawing.opengl().render(made, Request(eye_camera, settings, COMBINED, samples))
    found = result.pixels["combined"].astype(np.float64)
    assert np.isfinite(found).all()
    assert found.min() >= 0
    assert found[..., 3].max() <= 1 + 1e-5
    return found


def room(*things, lights=None, **more):
    """A post on the left, of points, and a floor, of polygons; what is odd stands on the right."""
    level = np.eye(4)
    level[1:3, 1:3] = [[0, -1], [1, 0]]
    level[2, 3] = -1.2
    floor = build.mesh(meshes.plane_mesh("room's floor", 3.0), "POLYGONS")
    post = build.mesh(meshes.cube_mesh("room's post", 0.3), "POINTS")
    given = (lamp(),) if lights is None else lights
    return build.scene((floor, level), (post, moved((-1.5, 0, -0.5))), *things, lights=given, world=World(), **more)


def left(picture):
    """What of the room lies in neither the picture nor the shadow of things that stand on the right."""
    return picture[:, : SIZE[0] // 3, :3]


def assert_room_is_right(*things, lights=None, rtol=2e-3, **more):
    """The room's left is as without these things; the whole picture."""
    found = draw(room(*things, lights=lights, **more))
    expected = left(draw(room(lights=lights)))
    assert expected.max() > 0.1
    apart = np.abs(left(found) - expected)
    # But for what the shadow of one nearly opaque ball, as blurred as its cells are wide, reaches: a single pixel.
    assert np.mean(apart > rtol * (expected + expected.max())) < 5e-3  # measured 1e-3
    assert apart.max() < 0.05 * expected.max()  # measured 2.1 %
    return found


RIGHT = moved((1.3, 0, 0))
FOG = balls(np.random.default_rng(1).uniform(-0.4, 0.4, (60, 3)), 0.2)


# Extinction and extent


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e38])
@pytest.mark.parametrize("channels", [1, 3])
def test_odd_extinction_leaves_the_rest_of_the_scene(odd, channels):
    strength = np.ones((len(FOG), channels), np.float32)
    strength[::2, 0] = odd
    cloud = replace(FOG, extinction=strength[:, 0].copy() if channels == 1 else strength)
    assert_room_is_right((points(f"odd {odd} {channels}", cloud), RIGHT))


@pytest.mark.parametrize("attribute", ["position", "radii", "color", "emission"])
@pytest.mark.parametrize("odd", [np.nan, np.inf, -1e30])
def test_points_that_are_odd_in_anything_leave_the_rest(attribute, odd):
    cloud = replace(FOG, emission=np.ones((len(FOG), 3), np.float32))
    values = cloud.arrays()[attribute].copy()
    values[::3] = odd
    assert_room_is_right((points(f"odd {attribute} {odd}", replace(cloud, **{attribute: values})), RIGHT))


def test_extinction_of_a_million_beside_a_millionth():
    """The one is opaque, and the other is not there."""
    cloud = replace(balls([[-0.4, 0, 0], [0.4, 0, 0]], 0.2, [1e6, 1e-6]), color=np.zeros((2, 3), np.float32))
    found = assert_room_is_right((points("far apart", cloud), RIGHT))
    none = draw(room())
    thick = np.abs(found - none)[:, : SIZE[0] * 7 // 10, :3]
    assert thick.max() > 0.05
    bare = build.scene((points("far apart", cloud), moved()), lights=(), world=World(np.ones(3)))
    seen = draw(bare, camera((0, -6, 0), resolution=SIZE))
    columns = [round(SIZE[0] / 2 + at / 6 * SIZE[0] / 2 / np.tan(np.radians(20))) for at in (-0.4, 0.4)]
    assert seen[SIZE[1] // 2, columns[0], 0] < 1e-6
    assert seen[SIZE[1] // 2, columns[1], 0] == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("shadows", [False, True])
def test_one_point_has_the_optical_depth_of_its_ball(shadows):
    radius, strength = 0.5, 1.5
    made = build.scene(
        (points("one", balls([[0, 0, 0]], radius, strength)), moved()), lights=(lamp(),), world=World(),
        transparent=True,
    )  # fmt: skip
    found = draw(made, camera((0, -6, 0), resolution=(65, 49)), shadows)
    depth = PEAK * 16 / 3 * (radius / 2) * strength  # of a kernel with a standard deviation of half the radius
    assert found[24, 32, 3] == pytest.approx(1 - np.exp(-depth), rel=2e-3)
    assert found[24, 32, :3].min() > 0


@pytest.mark.parametrize("count", [2, 50, 4000])
def test_points_in_one_place_add_up(count):
    """Their optical depths do, as those of one point of all their extinction."""
    many, one = balls(np.zeros((count, 3)), 0.5, 2.0 / count), balls(np.zeros((1, 3)), 0.5, 2.0)
    pictures = [
        draw(build.scene((points(f"together {len(c)} {count}", c), moved()), lights=(), world=World(np.ones(3))))
        for c in (many, one)
    ]
    np.testing.assert_allclose(*pictures, rtol=2e-3)


@pytest.mark.parametrize("radius", [0.0, None])
@pytest.mark.parametrize("shell", [False, True])
def test_splats_without_extent_take_nothing(radius, shell):
    cloud = replace(FOG, radii=None if radius is None else np.zeros((len(FOG), 1), np.float32))
    if shell:
        cloud = replace(
            cloud, extinction=None, opacity=np.full(len(FOG), 0.5, np.float32),
            normal=np.tile(np.array([0, -1, 0], np.float32), (len(FOG), 1)),
        )  # fmt: skip
    found = assert_room_is_right((points(f"no extent {radius} {shell}", cloud), RIGHT))
    if radius == 0.0:
        np.testing.assert_allclose(found, draw(room()), atol=2e-3 * found.max())


@pytest.mark.parametrize("opacity", [0.0, 1.0, np.nan, -1.0, 2.0, np.inf])
def test_opacities_at_and_beyond_their_ends(opacity):
    """Nothing at 0 and less; opaque at 1 and more; what is no number takes nothing."""
    cloud = clouds.plane_cloud(12, 0.8, color=np.tile(GREY, (144, 1)), opacity=np.full(144, opacity, np.float32))
    thing = points(f"opacity {opacity}", cloud), RIGHT
    assert_room_is_right(thing)
    found = draw(build.scene((thing[0], moved()), lights=(), world=World(np.ones(3))), samples=2)
    middle = found[20:28, 28:36, 0]
    if opacity <= 0 or not np.isfinite(opacity):
        np.testing.assert_allclose(middle, 1, atol=1e-6)
    else:
        assert middle.max() < 0.7  # lit by the white world


def test_a_medium_around_the_camera():
    inside = camera((0, -6, 1.5), (0, 0, 0), resolution=SIZE, near=1e-3)
    black, grey = (
        draw(room((points(f"haze {c}", voxels(16, 16, 10, 0.05, color=(c, c, c))), moved())), inside, c > 0)
        for c in (0.0, 0.5)
    )
    clear = draw(room(), inside, False)
    lit = clear[..., 0] > 0.05
    through = black[lit] / clear[lit]
    # The room is 4 to 10 units away, and voxels of 1.6 blur that by about their size.
    assert np.exp(-0.05 * 12) < through[:, 0].min()  # measured 0.573
    assert through[:, 0].max() < np.exp(-0.05 * 4)
    assert grey.mean() > black.mean()


@pytest.mark.parametrize("edge", [1e-6, 1e4])
def test_voxels_of_any_size_with_shadows(edge):
    """In object units, and the lamp and the camera with them: the picture is the same."""

    def seen(size):
        fog = voxels(4 * size, 4 * size, 4, 0.5 / size, color=(0.7, 0.7, 0.7))
        eye = camera(
            (0, -12 * size, 3 * size), (0, 0, 0), resolution=SIZE, near=1e-2 * size, far=1e3 * size
        )  # fmt: skip
        light = lamp((3 * size, -4 * size, 6 * size), strength=60 * size**2)
        made = build.scene((points(f"voxels of {size}", fog), moved()), lights=(light,), world=World(GREY * 0.5))
        return draw(made, eye)

    np.testing.assert_allclose(seen(edge), seen(1.0), rtol=1e-2, atol=1e-3)


# Lamps


@pytest.mark.parametrize("kind", ["POINT", "SPOT", "AREA"])
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_a_lamp_exactly_on_a_point(kind, radius):
    cloud = balls([[0, 0, 0.5], [0.5, 0, -0.3], [0.2, 0.1, 0.2]], 0.3)
    light = lamp((0, 0, 0.5), radius, kind)
    if kind == "AREA":
        light = replace(light, axis_u=np.array([0.1, 0, 0]), axis_v=np.array([0, 0.1, 0]))
    if kind == "SPOT":
        light = replace(light, spot_cos=0.5, spot_blend=0.2)
    found = draw(room((points("at the lamp", cloud), moved()), lights=(light,)))
    assert found[..., :3].max() > 0


def test_a_lamp_on_a_point_loses_half_of_the_points_depth():
    """Its floor is darkened by the half of the ball that is below it."""
    radius, strength = 0.5, 1.0
    light = lamp((0, 0, 0.5))
    one = points(
        "round the lamp",
        balls(
            [[0, 0, 0.5]],
            radius,
            strength,
        ),
    )
    low = camera((0.0, -2.5, -0.9), (0, 0, -1.2), field_of_view=8, resolution=(16, 12))
    lit, clear = (draw(room((one, moved()), lights=(light,)), low, shadows) for shadows in (True, False))
    depth = PEAK * 16 / 3 * (radius / 2) * strength / 2
    found = -np.log(lit[..., :3].mean() / clear[..., :3].mean())
    assert found == pytest.approx(depth, rel=0.04)  # measured 1.8 %


def test_a_lamp_inside_of_smoke():
    smoke = voxels(2, 2, 8, 0.7, color=(0.8, 0.8, 0.8))
    light = lamp((0.013, 0.02, 0.01))
    found = draw(room((points("smoke round a lamp", smoke), moved()), lights=(light,)))
    clear = draw(room(lights=(light,)))
    corner = found[:6, :6, :3].mean() / clear[:6, :6, :3].mean()
    # To a corner of the picture it goes through more than 1 and less than 1.8 units; some is scattered on the way.
    assert np.exp(-0.7 * 1.8) < corner < np.exp(-0.7)  # measured 0.446


# Instances


SHEAR = np.array([[1, 0.8, 0, 1.3], [0, 1, 0.5, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
ODD_INSTANCES = {
    "no size": moved((1.3, 0, 0), 0.0),
    "flat": moved((1.3, 0, 0), (1, 1, 0)),
    "a line": moved((1.3, 0, 0), (1, 0, 0)),
    "mirrored": moved((1.3, 0, 0), (-1, 1, 1)),
    "sheared": SHEAR,
    "tiny": moved((1.3, 0, 0), 1e-20),
    "nowhere": moved((np.nan, 0, 0)),
    "far away": moved((1e30, 0, 0)),
    "infinite": moved((1.3, 0, 0), np.inf),
}


@pytest.mark.parametrize("name", ODD_INSTANCES)
@pytest.mark.parametrize("kind", ["medium", "shell"])
def test_odd_instances_leave_the_rest(name, kind):
    plane = clouds.plane_cloud(8, 0.5, color=np.tile(GREY, (64, 1)), opacity=np.full(64, 0.5, np.float32))
    thing = points(f"instance of {kind}", FOG if kind == "medium" else plane)
    assert_room_is_right((thing, ODD_INSTANCES[name]))


def test_a_mirrored_medium_is_the_mirror_of_its_picture():
    cloud = balls([[0.3, 0, 0], [0.5, 0.2, 0.3]], 0.3, [1.0, 2.0])
    eye = camera((0, -6, 0), resolution=SIZE)
    plain, mirrored = (
        draw(build.scene((points("handed", cloud), moved(scale=(x, 1, 1))), lights=(), world=World(np.ones(3))), eye)
        for x in (1, -1)
    )
    np.testing.assert_allclose(mirrored, plain[:, ::-1], atol=1e-5)


def test_shearing_a_medium_shears_its_picture():
    """Across the view: as far as splats slide, the column of matter along the rays stays what it is."""
    shear = np.eye(4)
    shear[0, 2] = 0.5
    fog = points("slab to shear", voxels(1.6, 0.5, 8, 2.0))
    eye = camera((0, -30, 0), field_of_view=0.6, resolution=(16, 12))
    for matrix in (np.eye(4), shear):
        found = draw(build.scene((fog, matrix), lights=(), world=World(np.ones(3))), eye, samples=4)
        assert found[..., 0].mean() == pytest.approx(np.exp(-1.0), rel=5e-3)


@pytest.mark.parametrize("opaque", [False, True])
def test_a_translucent_holdout_of_odd_things_is_finite(opaque):
    cloud = balls(np.zeros((5, 3)), 0.4, [1e6, np.nan, 1e-6, 0.0, 1.0])
    made = build.scene(
        (points("odd hole", cloud), moved()), *([(build.mesh(meshes.plane_mesh("behind it", 1.0)), moved((0, 1, 0)))]
        if opaque else []), transparent=True, holdout=[True, *([False] if opaque else [])],
    )  # fmt: skip
    found = draw(made)
    assert found[SIZE[1] // 2, SIZE[0] // 2].max() < 1e-6
