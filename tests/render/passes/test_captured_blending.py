"""Captured splats blended in display values, as training did, against the formula in float64."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, captured_sphere, one_splat, random_splats
from scripts.scenes.clouds import smoke_cloud
from tests.reference import captured as reference

SIZE = (96, 72)
EYE = camera((0, -6, 0), resolution=SIZE, field_of_view=50)
WORLD = np.array([0.02, 0.3, 1.7])
TABLE = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.array([[0.2, 0.5, 0.8]]))
LINEAR = "Captured splats are blended in linear light, not as trained: "


def drawn(*things, eye=EYE, samples=1, trained=True, renderer=None, tolerance=1.0, **more):
    """Combined (H, W, 4) float64, and the report."""
    made = build.scene(*things, lights=(), table=TABLE, **{"world": World(WORLD), "transparent": True, **more})
    blending = "TRAINED" if trained else "LINEAR"
    table = Settings(use_shadows=False, captured_blending=blending, tolerance=tolerance)
    request = Request(eye, table, frozenset({"combined"}), samples)
    result = (renderer or drawing.opengl()).render(made, request)
    return result.pixels["combined"].astype(np.float64), result.report


@pytest.mark.parametrize("transparent", [True, False])
@pytest.mark.parametrize("passes", [frozenset({"combined"}), frozenset({"combined", "depth", "mist"})])
def test_display_values_are_blended_over_those_of_the_world(transparent, passes):
    """Also where Depth asks for splats, so that their picture is not kept."""
    splats = random_splats(700, 8)
    name = f"trained {transparent} {len(passes)}"
    made = build.scene((captured(name, splats), SHEARED), (captured(name, splats), moved()), lights=(),
                       world=World(WORLD), transparent=transparent)  # fmt: skip
    request = Request(EYE, Settings(use_shadows=False, captured_blending="TRAINED"), passes, 16)
    result = drawing.opengl().render(made, request)
    found = result.pixels["combined"].astype(np.float64)
    assert not result.report["warnings"]
    shown = reference.picture([(splats, SHEARED), (splats, moved())], EYE, trained=True)
    expected = reference.linear_over(shown, None if transparent else WORLD)
    assert reference.psnr(found, expected) > 80  # measured 130
    assert np.abs(found - expected).max() < 0.02  # measured 5e-6; where rounding decides whether alpha reaches 1/255


def test_an_empty_film_has_what_a_display_shows_under_its_alpha():
    """Two splats before each other: a file of straight display values has their mean over alpha."""
    near, far = one_splat((0, -1, 0), 1.0, 0.5, (0.9, 0.1, 0.4)), one_splat((0, 1, 0), 1.0, 0.5, (0.1, 0.8, 0.2))
    things = [(captured(f"trained {y}", splat), moved()) for y, splat in enumerate((near, far))]
    eye = camera((0, -60, 0), resolution=(33, 33), field_of_view=0.5)
    found = drawn(*things, eye=eye)[0][16, 16]
    assert found[3] == pytest.approx(0.75, abs=1e-3)
    shown = (0.5 * np.array([0.9, 0.1, 0.4]) + 0.25 * np.array([0.1, 0.8, 0.2])) / 0.75
    assert reference.display_from_linear(found[:3] / found[3]) == pytest.approx(shown, abs=1e-3)


def test_a_holdout_cuts_its_hole_into_them():
    distant, close = one_splat((0, 1, 0), 0.5), one_splat((0, -1, 0), 0.2)
    far, near = captured("trained far", distant), captured("trained near", close)
    found, report = drawn((far, moved()), (near, moved()), holdout=[False, True])
    assert not report["warnings"]
    behind, splat = (reference.picture([(made, moved())], EYE, trained=True) for made in (distant, close))
    expected = reference.linear_over(behind * (1 - splat[..., 3:]))
    assert np.abs(found - expected).max() < 1e-5


def test_the_same_view_again_shows_the_picture_of_before():
    """Over another world, too; the other way of blending has a picture of its own."""
    splats, renderer = random_splats(500), drawing.opengl()
    thing = captured("trained again", splats), moved()
    shown, linear = (reference.picture([(splats, moved())], EYE, trained=trained) for trained in (True, False))
    for value, trained, again in ((0.1, True, False), (0.9, True, True), (0.9, False, False), (0.4, True, False)):
        world = np.full(3, value)
        found, report = drawn(thing, trained=trained, renderer=renderer, world=World(world), transparent=False)
        assert ("captured" not in {entry["name"] for entry in report["passes"]}) == again
        expected = reference.linear_over(shown, world) if trained else linear + (1 - linear[..., 3:]) * [*world, 1]
        assert reference.psnr(found, expected) > 80  # measured 96 and more


def test_nodes_are_blended_in_display_values():
    """With colours that are means of these."""
    splats, renderer = captured_sphere(40_000), drawing.opengl()
    eye = camera((0, -3, 0.4), resolution=(14, 14), field_of_view=45)
    thing = captured("trained far sphere", splats), moved()
    _, (found, report) = (drawn(thing, eye=eye, renderer=renderer, tolerance=1.01) for _ in range(2))
    assert report["points"]["cut"] < 0.15 * len(splats)
    shown = reference.picture([(splats, moved())], eye, trained=True)
    assert reference.psnr(found, reference.linear_over(shown)) > 45  # measured 48.4


def test_the_viewport_blends_them_as_final_renders_do():
    splats, renderer = random_splats(500), drawing.opengl()
    made = build.scene((captured("trained viewport", splats), moved()), lights=(), world=World(WORLD))
    request = Request(EYE, Settings(captured_blending="TRAINED"), frozenset({"combined"}), 16, interactive=True)
    frame = renderer.start(made, request)
    try:
        while frame.sample():
            pass
        found = frame.mean().astype(np.float64)
    finally:
        frame.release()
    shown = reference.picture([(splats, moved())], EYE, trained=True)
    assert reference.psnr(found, reference.linear_over(shown, WORLD)) > 80


# Where it does not hold


def cases():
    splats = captured("trained among", random_splats(200)), moved()
    relit = replace(captured("trained relit", random_splats(200)), lighting="RELIT"), moved()
    quad = build.mesh(meshes.plane_mesh("quad among trained", 0.8), "POLYGONS"), moved()
    smoke = build.points("smoke among trained", smoke_cloud()), moved()
    lens = replace(EYE, aperture=Aperture(0.1, 6.0))
    return {
        "something opaque is in view": ((splats, quad), EYE),
        "something else that is translucent is in view": ((splats, smoke), EYE),
        "some are shadow receivers or relit": ((splats, relit), EYE),
        "the camera has depth of field": ((splats,), lens),
    }


@pytest.mark.parametrize("why", cases())
@pytest.mark.parametrize("samples", [1, 4])
def test_among_other_things_they_are_blended_in_linear_light_and_it_is_said_why(why, samples):
    things, eye = cases()[why]
    found, report = drawn(*things, eye=eye, samples=samples)
    expected, silent = drawn(*things, eye=eye, samples=samples, trained=False)
    np.testing.assert_array_equal(found, expected)
    assert [warning for warning in report["warnings"] if "blended" in warning] == [LINEAR + why]
    assert not any("blended" in warning for warning in silent["warnings"])


def test_nothing_is_said_where_there_are_none():
    quad = build.mesh(meshes.plane_mesh("quad without trained", 0.8), "POLYGONS"), moved()
    assert not drawn(quad)[1]["warnings"]
    behind = captured("trained behind", random_splats(200)), moved()
    assert not drawn(behind, eye=camera((0, -6, 0), (0, -12, 0)))[1]["warnings"]
