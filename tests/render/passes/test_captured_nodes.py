"""Captured splats from far away, drawn by nodes, against the published formula of all of them in float64."""

import time
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.captured import LOW_PASS
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.captured import MANY_SPLATS, count_captured
from pointsplat_addon.render.prepare.prepare import prepare
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, captured_sphere
from tests.reference import captured as reference

COUNT = 40_000
QUICK = 1.01  # pixels: a tolerance at which pictures need not be exact


def sphere(antialiased=False):
    return captured_sphere(COUNT, antialiased=antialiased)


def drawn(renderer, thing, eye, samples=1, others=(), tolerance=QUICK, **more):
    """Combined (H, W, 4) float64, and how many splats and nodes were drawn."""
    made = build.scene((thing, moved()), *others, lights=(), world=World(), transparent=True, **more)
    request = Request(eye, Settings(use_shadows=False, tolerance=tolerance), frozenset({"combined"}), samples)
    result = renderer.render(made, request)
    return result.pixels["combined"].astype(np.float64), result.report["points"]["cut"]


@pytest.mark.parametrize(("side", "share", "decibels"), [(14, 0.15, 49), (10, 0.07, 40)])  # measured 51.2, 42.7
def test_nodes_show_what_the_formula_shows_of_all_splats(side, share, decibels):
    """The first view draws all, as one without a tolerance does, and the second one nodes."""
    splats, renderer = sphere(), drawing.opengl()
    eye = camera((0, -3, 0.4), resolution=(side, side), field_of_view=45)
    thing = captured(f"far sphere {side}", splats)
    expected = reference.picture([(splats, moved())], eye)
    every, count = drawn(renderer, thing, eye)
    assert count == COUNT
    assert reference.psnr(every, expected) > 70
    found, count = drawn(renderer, thing, eye)
    assert count < share * COUNT
    assert reference.psnr(found, expected) > decibels
    found, count = drawn(renderer, thing, eye, tolerance=1.0)
    assert count == COUNT
    assert reference.psnr(found, expected) > 70  # measured 119.9 and more


@pytest.mark.parametrize(("side", "decibels", "more"), [(14, 27, 12), (10, 32, 18)])  # measured 28.8, 34.0; 14.7, 21.4
def test_nodes_of_antialiased_splats_are_as_right_as_many_pixels_of_all(side, decibels, more):
    """A picture of 32 by 32 pixels for each, filtered: splats that are too faint one by one to show in the small
    picture show together."""
    splats, renderer, fine = sphere(antialiased=True), drawing.opengl(), 32
    few, many = (camera((0, -3, 0.4), resolution=(n, n), field_of_view=45) for n in (side, fine * side))
    thing = captured(f"antialiased far sphere {side}", splats)
    expected = filtered(drawn(renderer, thing, many)[0], fine)
    every, nodes = (drawn(renderer, thing, few)[0] for _ in range(2))
    assert reference.psnr(nodes, expected) > decibels
    assert reference.psnr(nodes, expected) > reference.psnr(every, expected) + more


def filtered(picture, fine):
    """The means over a Gaussian of LOW_PASS pixels^2 about the centres of pixels, each of fine by fine ones."""
    at = np.arange(picture.shape[0]) + 0.5
    centre = (np.arange(picture.shape[0] // fine) + 0.5) * fine
    weight = np.exp(-0.5 * ((centre[:, None] - at) / fine) ** 2 / LOW_PASS)
    weight /= np.exp(-0.5 * ((np.arange(-8 * fine, 8 * fine) + 0.5) / fine) ** 2 / LOW_PASS).sum()
    return np.einsum("ya,abc,xb->yxc", weight, picture, weight, optimize=True)


def test_a_sheared_and_mirrored_instance_has_nodes_as_right():
    splats, renderer = sphere(), drawing.opengl()
    eye = camera((0, -3, 0.4), resolution=(14, 14), field_of_view=60)
    made = build.scene((captured("far sheared", splats), SHEARED), lights=(), world=World(), transparent=True)
    request = Request(eye, Settings(use_shadows=False, tolerance=QUICK), frozenset({"combined"}), 1)
    _, second = (renderer.render(made, request) for _ in range(2))
    assert second.report["points"]["cut"] < 0.3 * COUNT
    found = second.pixels["combined"].astype(np.float64)
    assert reference.psnr(found, reference.picture([(splats, SHEARED)], eye)) > 43  # measured 45.5


def test_a_quad_hides_nodes_behind_it():
    """The same with a quad through the middle: inside of its edges each side shows its own formula."""
    splats, renderer = sphere(), drawing.opengl()
    eye = camera((0, -3, 0), resolution=(14, 14), field_of_view=45)
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.array([[0.2, 0.5, 0.8]]))
    quad = build.mesh(meshes.plane_mesh("quad through nodes", 3.0), "POLYGONS"), moved()
    thing = captured("around a quad, far", splats)
    _, (found, count) = (drawn(renderer, thing, eye, 16, (quad,), table=table) for _ in range(2))
    assert count < 0.2 * COUNT
    before = reference.blend(reference.project(splats, moved(), eye), (14, 14), 3.0)
    expected = before + (1 - before[..., 3:]) * (0.2, 0.5, 0.8, 1.0)
    assert reference.psnr(found, expected) > 48  # measured 50.8


def test_nodes_stand_for_many_splats_while_a_view_moves():
    """And for none once it stands still."""
    splats, renderer = sphere(), drawing.opengl()
    made = build.scene((captured("moving sphere", splats), moved()), lights=(), world=World(), transparent=True)
    eye = camera((0, -3, 0.4), resolution=(14, 14), field_of_view=45)
    still = Request(eye, Settings(use_shadows=False), frozenset({"combined"}), 1, interactive=True)

    def count(request):
        frame = renderer.start(made, request)
        try:
            return frame.frame_plan.splats
        finally:
            frame.release()

    assert count(still) == COUNT
    assert not renderer.store.building
    assert count(replace(still, moving=True)) == COUNT
    while renderer.store.building:
        time.sleep(0.01)
    assert count(replace(still, moving=True)) < 0.15 * COUNT
    assert count(still) == COUNT


def test_nodes_stand_for_crowds_of_captures():
    """In pictures of any tolerance, from more splats on than can be drawn one by one."""
    crowd = MANY_SPLATS // COUNT
    splats, eye = captured("crowd", sphere()), camera((0, -40, 0), resolution=(120, 90))
    for count, by_nodes in ((crowd, False), (crowd + 1, True)):
        made = build.scene(*[(splats, moved((0.1 * i - 5, 0, 0))) for i in range(count)], lights=(), world=World())
        found = prepare(made, eye, Settings(), 1, Store())
        assert len(found.captured) == count
        assert bool(found.captured_nodes) == by_nodes
        if by_nodes:
            assert count_captured(made, found.captured, found.captured_nodes) < 0.15 * count * COUNT


def test_a_near_view_draws_all_splats():
    """And has no nodes, before and after a far one."""
    splats, renderer = sphere(), drawing.opengl()
    thing = captured("near sphere", splats)
    near, far = (camera((0, -3, 0.4), resolution=(n, n), field_of_view=45) for n in (200, 10))
    first, count = drawn(renderer, thing, near)
    assert count == COUNT
    drawn(renderer, thing, far)
    assert drawn(renderer, thing, far)[1] < count
    again, count = drawn(renderer, thing, near)
    assert count == COUNT
    np.testing.assert_array_equal(first, again)
