"""Eye-dome lighting: a step in depth in closed form, random depths against float64, and whole pictures."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.passes.output.eye_dome import DARKNESS, EyeDome
from scripts.scenes import cameras, solid_cases
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render
from tests.reference.eye_dome import eye_dome

pytest.importorskip("moderngl")
POLYGON = -1e30  # the centre's last channel: something is there
BACKGROUND = 1e10


def drawn(depth: np.ndarray, radius: int, strength: float, parallel: float | None = None) -> np.ndarray:
    """(H, W, 4) of a picture of (1, 2, 4, 0.5) with depths (H, W), NaN where nothing is."""
    device = opengl().device
    high, wide = depth.shape
    centre = np.zeros((high, wide, 4), np.float32)
    centre[..., 0], centre[..., 3] = np.nan_to_num(depth), np.where(np.isnan(depth), 0, POLYGON)
    dome = EyeDome(device, (wide, high))
    picture = np.tile(np.array([1, 2, 4, 0.5], np.float32), (high, wide, 1))
    combined, centres = (device.texture((wide, high), "RGBA32F", array) for array in (picture, centre))
    dome.draw(combined, centres, cameras.camera(parallel=parallel), radius, strength)
    found = device.read(dome.lit)
    for item in (dome, combined, centres):
        item.release()
    return found


@pytest.mark.parametrize("radius", [1, 3])
def test_a_step_in_depth_darkens_what_lies_behind_it(radius):
    """Of the neighbours of a pixel behind the step, three lie before it, one if only the farthest column reaches it."""
    near, far, edge = 5.0, 5.05, 10
    depth = np.full((21, 20), near)
    depth[:, edge:] = far
    found = drawn(depth, radius, 1.0)[10]
    each = DARKNESS / 8 * np.log2(far / near)
    diagonal = round(radius / np.sqrt(2))
    expected = np.ones(20)
    for column in range(edge, 20):
        reach = column - edge + 1  # pixels to the nearest column before the step
        expected[column] = np.exp(-each * ((radius >= reach) + 2 * (diagonal >= reach)))
    np.testing.assert_allclose(found[:, 0], expected, rtol=2e-5)  # measured 4e-6
    np.testing.assert_allclose(found, found[:, :1] * [1, 2, 4, 0] + [0, 0, 0, 0.5], rtol=1e-6)


def test_a_step_looks_alike_from_near_and_far():
    depth = np.where(np.arange(16) < 8, 1.0, 1.02) * np.ones((16, 1))
    np.testing.assert_allclose(drawn(1000 * depth, 1, 1.0), drawn(depth, 1, 1.0), rtol=1e-4)  # measured 2e-5


@pytest.mark.parametrize("parallel", [None, 6.0])
@pytest.mark.parametrize(("radius", "strength"), [(1, 1.0), (2, 0.3), (7, 0.05)])
def test_random_depths_with_holes_are_as_in_float64(radius, strength, parallel):
    random = np.random.default_rng(2)
    depth = random.uniform(2, 2.2, (40, 50))
    depth[random.random(depth.shape) < 0.3] = np.nan
    found = drawn(depth, radius, strength, parallel)
    expected = eye_dome(depth.astype(np.float32).astype(np.float64), radius, strength, parallel)
    np.testing.assert_allclose(found[..., 0], expected, rtol=2e-5, atol=1e-6)  # measured 6e-6


def dark(case: Case, **settings) -> Case:
    return replace(case, settings=replace(case.settings, technique="VISIBILITY", use_eye_dome=True, **settings))


@pytest.mark.parametrize("make", [solid_cases.wide_balls, solid_cases.cube, solid_cases.parallel, solid_cases.region])
@pytest.mark.parametrize("passes", [frozenset({"combined"}), frozenset({"combined", "depth"})])
def test_pictures_are_multiplied_by_what_their_depths_say(make, passes):
    case = make()
    plain = replace(case, settings=replace(case.settings, technique="VISIBILITY"))
    before = render(plain, frozenset({"combined", "depth"})).pixels
    found = render(dark(case), passes).pixels["combined"]
    depth = before["depth"][..., 0].astype(np.float64)
    depth[depth >= BACKGROUND / 2] = np.nan
    parallel = None if case.camera.perspective else 2 / case.camera.clip_from_view[0, 0]
    factor = eye_dome(depth, 1, 1.0, parallel)
    inner = np.s_[1:-1, 1:-1]  # at its border a picture knows depths beyond it
    expected = before["combined"] * np.stack([factor, factor, factor, np.ones_like(factor)], axis=2)
    np.testing.assert_allclose(found[inner], expected[inner], rtol=1e-3, atol=1e-5)
    assert (factor < 0.9).any()


def test_a_border_shows_the_same_pixels_as_the_full_frame():
    case = dark(solid_cases.wide_balls(), eye_dome_radius=3)
    full = render(case, frozenset({"combined"})).pixels["combined"]
    x, y, width, height = 9, 7, 25, 18
    part = render(replace(case, camera=replace(case.camera, region=(x, y, width, height))), frozenset({"combined"}))
    np.testing.assert_allclose(part.pixels["combined"], full[y : y + height, x : x + width], atol=1e-5)


def test_where_it_cannot_be_the_picture_is_drawn_and_the_reason_given():
    case = solid_cases.cube()
    for changed, reason in (
        (replace(case, settings=replace(case.settings, use_eye_dome=True)), "IMAGE_SPACE"),
        (dark(replace(case, camera=replace(case.camera, aperture=Aperture(0.4, 1.0)))), "out of focus"),
    ):
        found = render(changed, frozenset({"combined"}))
        assert [w for w in found.report["warnings"] if "Eye-dome lighting is left out" in w and reason in w]
        without = replace(changed, settings=replace(changed.settings, use_eye_dome=False))
        np.testing.assert_allclose(
            found.pixels["combined"], render(without, frozenset({"combined"})).pixels["combined"], atol=1e-6
        )


def test_it_is_off_by_default():
    assert not Settings().use_eye_dome
    assert "eye dome" in {entry["name"] for entry in render(solid_cases.cube()).report["skipped"]}


def test_each_sample_of_a_viewport_is_presented_with_it():
    case = dark(solid_cases.wide_balls())
    frame = opengl().start(case.scene, replace(case.request(frozenset({"combined"}), 40), interactive=True))
    whole = render(case, frozenset({"combined"}), samples=40).pixels["combined"]
    while frame.sample():
        assert np.abs(frame.mean() - whole).mean() < 0.03
    frame.release()
