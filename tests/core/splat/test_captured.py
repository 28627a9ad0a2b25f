"""What the processor finds of captured splats before they are drawn."""

import numpy as np
import pytest

from pointsplat_addon.core.splat import captured
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, random_splats
from tests.reference import captured as reference

CAMERAS = {
    "perspective": camera((0, -3, 0), resolution=(60, 40), field_of_view=30),
    "shifted": camera((0, -3, 0), resolution=(60, 40), field_of_view=60, shift=(0.3, -0.2)),
    "among them": camera((0, -0.2, 0), resolution=(60, 40), field_of_view=90),
    "parallel": camera((0, -3, 1), resolution=(60, 40), parallel=2.0),
    "border": camera((0, -3, 0), resolution=(60, 40), field_of_view=30, region=(30, 5, 12, 9)),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_nothing_that_shows_is_left_out(name):
    splats, eye = random_splats(3000, 0, size=0.03), CAMERAS[name]
    view = eye.view_from_world @ SHEARED
    rows, depth = captured.seen(splats, captured.bounds_of_scales(splats), view, eye)
    every, of_all = captured.seen(splats, captured.bounds_of_scales(splats), view, eye, everywhere=True)
    shown = reference.project(splats, SHEARED, eye)
    reach = np.sqrt(2 * np.log(np.maximum(255 * shown.opacity, 1)))
    half = reach[:, None] * np.sqrt(np.einsum("nii->ni", shown.covariance))
    beside = np.abs(shown.centre - np.array(eye.window[2:]) / 2) > np.array(eye.window[2:]) / 2 + half
    inside = np.flatnonzero(~beside.any(axis=1) & (shown.opacity >= 1 / 255))
    there = np.flatnonzero(_in_depth(splats, view, eye))
    assert np.isin(there[inside], rows).all()
    assert set(rows) <= set(every)
    assert len(rows) < 5 * len(inside)  # measured at most 3.8, in the border of 12 x 9 pixels
    np.testing.assert_allclose(depth, of_all[np.searchsorted(every, rows)])


def _in_depth(splats, view, eye):
    depth = -(splats.position.astype(float) @ view[2, :3] + view[2, 3])
    return (depth > eye.nearest) & (depth < eye.far)


@pytest.mark.parametrize("name", ["perspective", "shifted"])
def test_limits_are_those_of_the_full_frame(name):
    """1.3 of the tangent of half the field, from the middle of the picture, for all parts of it."""
    eye = CAMERAS[name]
    fx, fy, cx, cy = eye.pixel_from_view()
    low, high = captured.slope_limits(eye).reshape(2, 2)
    np.testing.assert_allclose((low + high) / 2, [(30 - cx) / fx, (20 - cy) / fy])
    np.testing.assert_allclose((high - low) / 2, [1.3 * 30 / fx, 1.3 * 20 / fy])
    border = CAMERAS["border"]
    np.testing.assert_allclose(captured.slope_limits(border), captured.slope_limits(CAMERAS["perspective"]))


def test_the_eye_lies_where_its_view_is_zero():
    view = CAMERAS["perspective"].view_from_world @ SHEARED
    eye = captured.eye_in_object(view, perspective=True)
    np.testing.assert_allclose(view @ np.append(eye, 1), [0, 0, 0, 1], atol=1e-12)
    forward = captured.eye_in_object(view, perspective=False)
    seen = view[:3, :3] @ forward
    np.testing.assert_allclose(seen / np.linalg.norm(seen), [0, 0, -1], atol=1e-12)
    assert np.isfinite(captured.eye_in_object(np.diag([1.0, 0, 1, 1]), perspective=True)).all()
