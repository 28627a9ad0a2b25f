"""Fields of many instances: what is drawn of them, by how much it differs from drawing all, and that it is steady."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Instances
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.renderer import Renderer
from scripts.common.tower import COLORS
from scripts.scenes import build, cameras, clouds, drawing, meshes
from scripts.scenes.case import Case
from scripts.scenes.store import STORE

BALL = replace(clouds.sphere_cloud(3000), radii=np.full((3000, 1), 0.05, np.float32))


def field(side: int, spacing: float = 6.0, name: str = "field of balls") -> Case:
    """side x side balls of radius 1 on the ground, of the default material, under a sun."""
    x, y = (a.ravel() * spacing for a in np.meshgrid(*[np.arange(side) - (side - 1) / 2] * 2))
    matrices = np.tile(np.eye(4), (side * side, 1, 1))
    matrices[:, 0, 3], matrices[:, 1, 3] = x, y
    case = Case(build.scene((build.points(name, BALL), build.moved()), lights=(build.sun(),)), cameras.camera())
    made = replace(case.scene, instances=Instances(np.zeros(len(x), np.int32), matrices), transparent=True)
    return replace(case, scene=made)


def seen_from(case: Case, distance: float, angle: float = 0.3, resolution: tuple[int, int] = (96, 72)) -> Case:
    eye = distance * np.array([np.sin(angle), -np.cos(angle), 0.8])
    camera = cameras.camera(eye, resolution=resolution, field_of_view=20.0, near=1.0, far=1e5)
    return replace(case, camera=camera)


def prepared(case: Case, store: Store | None = None):
    return prepare(case.scene, case.camera, case.settings, 16, Store() if store is None else store)


def picture(case: Case, samples: int = 16) -> np.ndarray:
    return drawing.render(case, frozenset({"combined"}), samples).pixels["combined"]


def test_forty_thousand_instances_are_one_point_set_and_a_range_each():
    case = seen_from(field(200), 3000.0)
    found = prepared(case)
    assert len(found.point_sets) == 1
    assert found.total == 40_000 * 3000
    assert len(found.cut.count) == len(np.unique(found.cut.instance))
    assert (np.diff(found.cut.instance) > 0).all()
    (points,) = found.point_sets.values()
    assert (found.cut.first + found.cut.count <= len(points)).all()
    assert found.cut.splats < 40_000 * 40


def test_the_device_gets_as_many_draws_for_forty_thousand_as_for_forty():
    calls = []
    for side in (7, 200):
        device = NullDevice()
        renderer = Renderer(device, STORE)
        case = seen_from(field(side), 3000.0)
        renderer.render(case.scene, Request(case.camera, case.settings, frozenset({"combined"}), 1))
        calls.append(len(device.calls))
        renderer.release()
    assert calls[0] == calls[1]


def test_a_camera_that_moves_uploads_tables_only():
    device = NullDevice()
    renderer, case = Renderer(device, STORE), field(60)
    for angle in (0.30, 0.31):
        view = seen_from(case, 900.0, angle)
        before = set(device.alive)
        renderer.render(view.scene, Request(view.camera, view.settings, frozenset({"combined"}), 1))
    kept = {t for t in before if getattr(t, "format", "") == "RGBA32F"}
    assert kept <= device.alive  # pages stay


def test_broken_instances_spoil_no_other():
    case = field(200)
    view = seen_from(case, 3000.0)
    rng = np.random.default_rng(4)
    matrices = case.scene.instances.world_from_object.copy()
    broken = rng.permutation(40_000)[:4000].reshape(4, -1)
    matrices[broken[0], 0, 3] = np.nan
    matrices[broken[1], :3, :3] = 0
    matrices[broken[2], 2, 2] = np.inf
    matrices[broken[3], 0, 0] = -1  # mirrored: drawn as any other
    spoilt = replace(
        view, scene=replace(view.scene, instances=replace(case.scene.instances, world_from_object=matrices))
    )
    whole, found = prepared(view), prepared(spoilt)
    assert not np.isin(found.cut.instance, broken[:3]).any()
    left = np.setdiff1d(whole.cut.instance, broken[:3])
    np.testing.assert_array_equal(found.cut.instance, left)
    assert np.isfinite(found.largest)
    assert np.isfinite(picture(spoilt, 1)).all()


def mean_of(case: Case, finer: int = 1) -> tuple[float, np.ndarray]:
    """Covered pixels of the case's picture, and the mean colour there; from a picture of `finer` times the pixels."""
    width, height = case.camera.resolution
    larger = replace(case, camera=replace(case.camera, resolution=(finer * width, finer * height)))
    image = picture(larger, 4 if finer > 1 else 64)
    alpha = float(image[..., 3].sum())
    return alpha / finer**2, image[..., :3].sum((0, 1)) / alpha


@pytest.mark.parametrize(
    ("distance", "spacing", "alpha_limit", "color_limit"),
    # Balls of 4, 0.7 and 0.28 pixels. Measured: 0.1 %, 0.8 % and 1.7 % in alpha, 1.4 %, 4.3 % and 4.7 % in colour.
    [(100, 6.0, 0.02, 0.03), (600, 6.0, 0.02, 0.05), (1500, 6.0, 0.03, 0.07)],
)
def test_the_mean_of_a_far_field_is_that_of_a_near_one(distance, spacing, alpha_limit, color_limit):
    case = seen_from(field(24, spacing), float(distance))
    alpha, color = mean_of(case)
    wanted, true = mean_of(case, 16)
    assert abs(alpha / wanted - 1) < alpha_limit
    np.testing.assert_allclose(color, true, rtol=color_limit)


def bodies(name: str, primitive: str, tolerance: float, against: bool) -> Case:
    """64 towers or boxes at random places and turns, 16 pixels high, from above at 36 degrees in parallel. As many
    splats as of a body of 16 pixels over the tolerance, so that samples of pixels do not count."""
    side, of = 8, meshes.small_tower("towers at random") if name == "towers" else meshes.cube_mesh("boxes at random")
    rng = np.random.default_rng(5)
    tall = float(np.ptp(of.position[:, 2]))
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(side) - (side - 1) / 2] * 2))
    gap = tall if name == "towers" else 2 * tall
    turn, matrix = rng.uniform(0, 2 * np.pi, side**2), np.tile(np.eye(4), (side**2, 1, 1))
    matrix[:, 0, 0] = matrix[:, 1, 1] = np.cos(turn)
    matrix[:, 1, 0] = np.sin(turn)
    matrix[:, 0, 1] = -np.sin(turn)
    matrix[:, :2, 3] = (np.stack([x, y], axis=1) + rng.uniform(-0.2, 0.2, (side**2, 2))) * gap
    width, angle = (side + 2) * gap, np.radians(36)
    size = round(16 * width / tall)
    eye = 20 * tall * np.array([0, -np.cos(angle), np.sin(angle)])
    camera = cameras.camera(eye, (0, 0, 0), (size, size), parallel=width, near=tall, far=60 * tall)
    light = build.sun(direction=(0.3, -0.7 if against else 0.7, -0.6))
    table = build.materials(4, base_color=np.array(COLORS, np.float32))
    made = build.scene((build.mesh(of, primitive), build.moved()), lights=(light,), table=table)
    made = replace(made, instances=Instances(np.zeros(side**2, np.int32), matrix), transparent=True)
    # Narrow, so that samples at the rims of the field count as they did where the limits were measured.
    settings = Settings(technique="IMAGE_SPACE", tolerance=tolerance, use_shadows=False, filter_size=0.75)
    return Case(made, camera, settings)


@cache
def polygons_of(name: str, against: bool) -> tuple[float, np.ndarray]:
    return mean_of(bodies(name, "POLYGONS", 1.0, against))


@pytest.mark.parametrize(
    ("name", "height", "area_limit", "color_limit"),
    [
        ("towers", 8, 0.02, 0.07),  # measured 1.008 and 0.945 in the worst channel
        ("towers", 2, 0.02, 0.11),  # 1.007, 0.910
        ("towers", 0.5, 0.07, 0.14),  # 1.056, 1.121
        ("boxes", 8, 0.02, 0.03),  # 0.994, 0.983
        ("boxes", 2, 0.04, 0.04),  # 0.967, 0.972
        ("boxes", 0.5, 0.08, 0.10),  # 0.936, 0.921
    ],
)
@pytest.mark.parametrize("against", [False, True])
def test_a_far_field_of_bodies_with_edges_has_their_area_and_colour(name, height, area_limit, color_limit, against):
    """With the light and against it, where the sides that are lit are seen at a flat angle."""
    alpha, color = mean_of(bodies(name, "POINTS", 16 / height, against))
    wanted, true = polygons_of(name, against)
    assert abs(alpha / wanted - 1) < area_limit
    np.testing.assert_allclose(color, true, rtol=color_limit)


def test_sizes_of_those_that_stay_make_up_for_those_that_do_not():
    """The projected area of all that is drawn, against that of all instances."""
    for distance in (6000.0, 20_000.0, 60_000.0):
        case = seen_from(field(200, 2.5), distance)
        found = prepared(case)
        true = case.camera.view_from_world @ case.scene.instances.world_from_object
        drawn = found.cut.instance
        area = (found.view_from_object[drawn, 0, :3] ** 2).sum() / (true[:, 0, :3] ** 2).sum()
        share = len(drawn) / len(true)
        # Evenly spread numbers: 1 % measured of the fewest, where 0.2 % stay.
        assert abs(area - 1) < 0.03
    assert share < 0.05


def test_instances_come_and_go_at_no_size_as_the_camera_moves():
    case, store = field(60), Store()
    sizes = []
    for step in range(12):
        view = seen_from(case, 6000.0 * 0.99**step, 0.3 + 0.01 * step)
        found = prepared(view, store)
        size = np.zeros(3600)
        size[found.cut.instance] = np.linalg.norm(found.view_from_object[found.cut.instance, 0, :3], axis=1)
        sizes.append(size)
    sizes = np.array(sizes)
    comes = (sizes[1:] > 0) != (sizes[:-1] > 0)
    assert comes.any()
    # As an area: 0.05 measured, of the largest.
    assert np.maximum(sizes[1:], sizes[:-1])[comes].max() ** 2 < 0.1 * sizes.max() ** 2
    assert np.abs(np.diff(sizes**2, axis=0)).max() < 0.1 * sizes.max() ** 2


def test_an_orbit_is_as_steady_as_the_picture_of_all():
    """Change from frame to frame, at the 99th percentile of pixels and channels."""

    def changes(finer: int) -> float:
        frames = []
        for step in range(4):
            case = seen_from(field(24, 2.5), 400.0, 0.3 + 0.004 * step)
            case = replace(case, camera=replace(case.camera, resolution=(96 * finer, 72 * finer)))
            # Of the finer pictures, 64 pixels make one.
            frames.append(picture(case, 64 if finer == 1 else 4).reshape(72, finer, 96, finer, 4).mean(axis=(1, 3)))
        return float(np.quantile(np.abs(np.diff(np.stack(frames)[..., :3], axis=0)), 0.99))

    mine, theirs = changes(1), changes(8)
    # 7 / 255 more measured at 64 samples, 13 / 255 at 16: what the samples of pixels miss of balls of one pixel.
    assert mine < theirs + 10 / 255


def test_near_instances_are_polygons_and_far_ones_points():
    cube = meshes.cube_mesh("cubes near and far")
    places = [(0, 0, 0), *((2.0 * i, 300.0, 0.0) for i in range(-10, 10))]
    case = Case(build.scene(*((build.mesh(cube), build.moved(place)) for place in places)), cameras.camera(far=1000.0))
    geometry = case.scene.geometries[0]
    case = replace(
        case,
        scene=replace(
            case.scene,
            geometries=(geometry,),
            instances=replace(case.scene.instances, geometry=np.zeros(len(places), np.int32)),
        ),
    )
    found = prepared(case)
    np.testing.assert_array_equal(found.polygons, [0])
    assert len(np.unique(found.cut.instance)) == 20


def test_colours_of_materials_mix_in_coarse_nodes():
    """Half of the points red, half green: a far field is yellow, whatever its nodes' heaviest child is."""
    rng = np.random.default_rng(0)
    cloud = replace(BALL, material=rng.integers(0, 2, len(BALL)).astype(np.uint16))
    table = build.materials(2, base_color=np.array([[1, 0, 0], [0, 1, 0]], np.float32))
    case = field(10, name="field of two colours")
    geometry = build.points("field of two colours", cloud)
    case = seen_from(replace(case, scene=replace(case.scene, geometries=(geometry,), materials=table)), 1000.0)
    found = prepared(case)
    (points,) = found.point_sets.values()
    coarsest = points.cloud.take(slice(0, 8))
    assert coarsest.color is not None
    np.testing.assert_allclose(coarsest.color.mean(axis=0), [0.5, 0.5, 0], atol=0.03)  # 0.01 measured


@pytest.mark.parametrize("tolerance", [0.5, 4.0])
def test_the_tolerance_decides_how_much_is_drawn(tolerance):
    case = replace(
        seen_from(field(40), 300.0), settings=Settings(technique="IMAGE_SPACE", tolerance=tolerance, use_shadows=False)
    )
    one = prepared(replace(case, settings=Settings(technique="IMAGE_SPACE", use_shadows=False))).cut.splats
    assert (prepared(case).cut.splats > one) == (tolerance < 1)


def test_a_parallel_camera_sees_the_same_field():
    case = field(24, 2.5)
    camera: Camera = cameras.camera((0, -400, 320), resolution=(96, 72), parallel=200.0, near=1.0, far=1e4)
    found = prepared(replace(case, camera=camera))
    assert len(np.unique(found.cut.count)) == 1
    assert len(found.cut.instance) == 576


def test_bodies_of_twenty_pixels_are_closed():
    """What stood apart let far sides show between its splats, as dots."""
    found = []
    for primitive in ("POINTS", "POLYGONS"):
        ball = build.mesh(meshes.sphere_mesh("closed bodies", 120), primitive)
        placed = [(ball, build.moved((0.22 * (i % 5) - 0.44, 0.22 * (i // 5) - 0.44, 0.2), 0.08)) for i in range(25)]
        scene = build.scene(*placed, lights=[build.sun(3.0, (0.3, 0.2, -1.0))])
        camera = cameras.camera((0, -2.5, 2.5), resolution=(160, 120))
        case = Case(scene, camera, Settings(technique="IMAGE_SPACE", use_shadows=False))
        found.append(drawing.render(case, frozenset({"combined"}), 4).pixels["combined"][..., :3].astype(float))
    difference = np.abs(found[0] - found[1])
    assert np.sqrt((difference**2).mean()) < 0.01  # measured 0.0080; 0.0161 where they stood apart
    assert (difference.max(axis=2) > 0.2).sum() <= 4  # measured 2; 11 where they stood apart
