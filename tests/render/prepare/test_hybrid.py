"""Meshes that are points in some parts and triangles in others look like triangles alone, and cost less."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pointsplat_addon.core.lod.cost import Costs
from pointsplat_addon.core.surface.density import PART
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.budget.calibrate import calibrate
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import eroded
from scripts.scenes import build, clouds, drawing, meshes
from scripts.scenes.case import Case
from scripts.scenes.changes import levels
from tests.support.divided_meshes import COSTS, SETTINGS, SHAPES, scene


def prepared(name: str):
    return prepare(scene(name), SHAPES[name]()[1], SETTINGS, 1, Store(), costs=COSTS)


@cache
def picture(name: str, primitive: str, samples: int, technique: str = SETTINGS.technique) -> np.ndarray:
    renderer = drawing.opengl()
    before, renderer.costs = renderer.costs, COSTS
    try:
        # A narrow filter: samples at the rims of silhouettes are as near to them as where the limits were measured.
        settings = replace(SETTINGS, technique=technique, filter_size=0.75)
        request = Request(SHAPES[name]()[1], settings, frozenset({"combined", "depth"}), samples)
        pixels = renderer.render(scene(name, primitive), request).pixels
    finally:
        renderer.costs = before
    return np.concatenate([levels(pixels["combined"]), pixels["depth"]], axis=2)


@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_that_reaches_from_near_to_far_is_split(name):
    found = prepared(name)
    parts = -(-len(SHAPES[name]()[0].triangles) // PART)
    assert found.polygons.tolist() == [0]
    assert 0.02 * parts < len(found.parts[0]) < 0.98 * parts
    assert 1000 < found.cut.splats < found.total


@pytest.mark.parametrize("samples", [1, 17])
@pytest.mark.parametrize("name", SHAPES)
def test_where_points_and_triangles_meet_no_seam_is_seen(name, samples):
    mixed, truth = picture(name, "AUTO", samples), picture(name, "POLYGONS", samples)
    inside = eroded(truth[..., 3] < 1e9)
    difference = np.abs(mixed - truth)[..., :3].max(axis=2)[inside]
    # Where a splat's depth is rounded otherwise than a triangle's, it is one.
    apart = np.abs(mixed[..., 3] / truth[..., 3] - 1)[inside]
    points, polygons = apart > 1e-6, apart <= 1e-6
    assert np.count_nonzero(points) > 200
    assert np.count_nonzero(polygons) > 1000
    assert np.percentile(difference[polygons], 99) < 1  # of 255
    if name != "two_materials":  # whose stripes are thinner than a pixel where they are points
        # Distant hills' own edges are silhouettes, and the only pixels that differ more: measured 4 of 9500.
        assert np.count_nonzero(difference > 4) <= (8 if name == "bumps" and samples == 1 else 0)


@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.parametrize("name", ["plane", "bumps", "shuffled"])
def test_where_points_and_triangles_meet_no_seam_is_seen_under_ewa(name, samples):
    """Triangles look as they do alone, and pixels at the seam differ no more than those of splats among themselves:
    EWA blends hills that are smaller than a pixel, of which one sample of triangles shows one."""
    mixed, truth = picture(name, "AUTO", samples, "EWA"), picture(name, "POLYGONS", samples, "EWA")
    inside = eroded(truth[..., 3] < 1e9)
    difference = np.abs(mixed - truth)[..., :3].max(axis=2)
    points = np.abs(mixed[..., 3] / truth[..., 3] - 1) > 1e-6
    seam = inside & ~eroded(points) & ~eroded(~points)
    triangles, splats = inside & ~points, inside & points & ~seam
    assert np.count_nonzero(seam) > 200
    assert np.count_nonzero(splats) > 200
    assert difference[triangles].max() < 2  # of 255, measured 1.02
    # Measured 4.7 against 12.8 of bumps at one sample, 0.4 against 1.6 at 16, and below 0.007 of planes.
    assert np.percentile(difference[seam], 99) < np.percentile(difference[splats], 99) + 0.1
    if name != "bumps":
        assert difference[inside].max() < 0.05  # measured 0.007


def test_nothing_is_drawn_of_parts_that_are_out_of_view():
    found = prepared("plane")
    # Much of the plane lies beside the picture.
    assert len(found.parts[0]) * PART + found.cut.splats < 0.75 * len(SHAPES["plane"]()[0].triangles)


def test_the_same_figures_give_the_same_picture():
    first = picture("bumps", "AUTO", 1)
    picture.cache_clear()
    assert np.array_equal(first, picture("bumps", "AUTO", 1))


def test_few_triangles_are_not_worth_the_passes_over_all_pixels():
    case = Case(scene("bumps"), replace(SHAPES["bumps"]()[1], region=None), SETTINGS)
    found = prepare(case.scene, case.camera, SETTINGS, 1, Store(), costs=replace(COSTS, pixel=1e6))
    assert found.cut.splats == 0
    assert found.polygons.tolist() == [0]


def test_points_beside_a_cloud_need_no_passes_of_their_own():
    mesh, camera = SHAPES["bumps"]()
    beside = build.points("beside", clouds.sphere_cloud(100))
    both = build.scene((build.mesh(mesh), build.moved()), (beside, build.moved((3, 0, 0))))
    found = prepare(both, camera, SETTINGS, 1, Store(), costs=replace(COSTS, pixel=1e6))
    assert found.cut.splats > 1000


def test_leaves_beside_are_polygons_and_make_no_points_cheaper():
    mesh, camera = SHAPES["bumps"]()
    position = np.random.default_rng(0).normal(0, 0.3, (600, 3)).astype(np.float32)
    leaves = meshes.flat_mesh("leaves", position, np.arange(600, dtype=np.int32).reshape(-1, 3))
    both = build.scene((build.mesh(mesh), build.moved()), (build.mesh(leaves), build.moved((0, 0, 0.5))))
    found = prepare(both, camera, SETTINGS, 1, Store(), costs=replace(COSTS, pixel=1e6))
    assert found.cut.splats == 0
    assert found.polygons.tolist() == [0, 1]


@pytest.mark.parametrize(("interactive", "samples", "points"), [(True, 1, True), (False, 4, False), (False, 64, True)])
def test_points_of_a_final_picture_have_to_pay_for_being_sampled(interactive, samples, points):
    camera = SHAPES["bumps"]()[1]
    costs = replace(Costs(), pixel=1e-3)
    found = prepare(scene("bumps"), camera, SETTINGS, samples, Store(), interactive=interactive, costs=costs)
    assert (found.cut.splats > 1000) == points


def test_what_is_kept_from_pictures_before_changes_no_choice():
    camera = SHAPES["bumps"]()[1]
    store, costs = Store(), replace(Costs(), pixel=1e-3)
    assert prepare(scene("bumps"), camera, SETTINGS, 4, store, interactive=True, costs=costs).cut.splats > 1000
    assert prepare(scene("bumps"), camera, SETTINGS, 4, store, costs=costs).cut.splats == 0


def test_a_device_can_be_calibrated():
    costs = calibrate(drawing.opengl())
    assert costs.valid()
    assert costs.triangle > 1  # nanoseconds: no device that runs this test draws a billion a second


def test_a_device_is_calibrated_in_image_space_where_its_costs_decide():
    device = NullDevice()
    calibrate(Renderer(device, Store()))
    names = {interface.name for interface in device.interfaces}
    assert {"project", "resolve", "push"} <= names
    assert not names & {"group", "spread"}
