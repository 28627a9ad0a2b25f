"""Adaptive sampling: tiles that are done show what they would with all samples, and the others never notice."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.frame.report import report
from pointsplat_addon.render.frame.sample_positions import offsets
from pointsplat_addon.render.passes.output.adaptive import FIRST_CHECK, LEAST_SAMPLES, dilated
from pointsplat_addon.render.passes.tiles import TILE
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, drawing
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.store import STORE

SAMPLES = 24
COMBINED = frozenset({"combined"})
# Scenes of points, polygons, balls, a window into a larger picture, and none that is translucent.
NAMES = ("mixed", "plain_sphere", "wide_balls", "region", "parallel", "environment", "cube")


def large(name: str) -> Case:
    """A test scene in a picture of many tiles."""
    case = CASES[name]()
    width, height = (4 * side for side in case.camera.resolution)
    region = case.camera.region
    return replace(
        case,
        camera=replace(
            case.camera, resolution=(width, height), region=None if region is None else tuple(4 * x for x in region)
        ),
    )


def drawn(case: Case, **settings) -> tuple[np.ndarray, np.ndarray]:
    """The picture, and how many samples each of its pixels has."""
    request = replace(case.request(COMBINED, SAMPLES), settings=replace(case.settings, **settings))
    frame = Frame(drawing.opengl(), case.scene, request)
    while frame.sample():
        pass
    combined = frame.pixels()["combined"]
    count = np.full((*combined.shape[:2], 1), SAMPLES, np.float32)
    if frame.adaptive is not None:
        count = np.asarray(frame.counts())
    frame.release()
    return combined, count[..., 0]


@pytest.mark.parametrize("name", NAMES)
def test_what_still_takes_samples_does_not_see_that_the_rest_is_done(name):
    """Pixels gather from around them: from tiles that are not shaded any more, but still drawn that far."""
    case = large(name)
    full, _ = drawn(case, use_adaptive_sampling=False)
    saved, count = drawn(case)
    assert (count < SAMPLES).mean() > 0.2  # measured 0.38 to 0.73: there is something to leave out
    assert (count == SAMPLES).mean() > 0.02  # measured 0.27 to 0.62
    whole = count == SAMPLES
    # Measured 0 in all of them: sums of the same numbers in the same order.
    assert np.abs(full - saved)[whole].max() == 0.0


@pytest.mark.parametrize("name", NAMES)
def test_what_is_left_out_would_not_be_seen(name):
    case = large(name)
    full, _ = drawn(case, use_adaptive_sampling=False)
    saved, count = drawn(case)
    shown, truth = (np.clip(p, 0.0, 1.0) ** (1 / 2.2) for p in (saved, full))
    difference = np.abs(shown - truth)[count < SAMPLES]
    assert np.sqrt((difference**2).mean()) < 0.001  # of 1; measured 0.0004 at most
    assert np.percentile(difference, 99.9) < 2 / 255  # measured 1.25 / 255


def test_the_threshold_bounds_the_error():
    case = large("mixed")
    full, _ = drawn(case, use_adaptive_sampling=False)
    errors, means = [], []
    for threshold in (0.08, 0.02, 0.005, 0.0):
        picture, count = drawn(case, adaptive_threshold=threshold)
        errors.append(np.sqrt(((picture - full) ** 2).mean()))
        means.append(count.mean())
    assert errors == sorted(errors, reverse=True)
    assert means == sorted(means)
    assert errors[-1] < 1e-6  # tiles whose pixels are equal in all samples; measured 6e-8


def test_a_picture_of_one_colour_ends_at_the_first_check():
    case = replace(CASES["empty"](), camera=cameras.camera(resolution=(64, 48)))
    case = replace(case, scene=replace(case.scene, world=CASES["environment"]().scene.world))
    case = replace(
        case, scene=replace(case.scene, world=replace(case.scene.world, image=np.ones((4, 8, 3), np.float32)))
    )
    frame = Frame(drawing.opengl(), case.scene, case.request(COMBINED, SAMPLES))
    while frame.sample():
        pass
    assert frame.done == FIRST_CHECK
    assert frame.complete
    np.testing.assert_allclose(frame.pixels()["combined"], 1.0, atol=1e-5)  # measured 0
    skipped = {entry["name"]: entry["because"] for entry in report(frame, 0.0)["skipped"]}
    assert f"{FIRST_CHECK:.1f} of {SAMPLES}" in skipped["samples"]
    frame.release()


@pytest.mark.parametrize(
    ("case", "passes", "samples", "settings"),
    [
        ("mixed", COMBINED, SAMPLES, {"use_adaptive_sampling": False}),
        ("mixed", COMBINED, LEAST_SAMPLES - 1, {}),
        ("mixed", COMBINED | {"crypto_object"}, SAMPLES, {}),
        ("smoke", COMBINED, SAMPLES, {}),
    ],
)
def test_where_all_samples_are_needed_nothing_asks(case, passes, samples, settings):
    case = CASES[case]()
    case = replace(case, settings=replace(case.settings, **settings))
    device = NullDevice()
    told = Renderer(device, STORE).render(case.scene, case.request(passes, samples)).report
    assert not {"converge", "keep", "mark"} & set(device.names)
    assert any(entry["name"] == "adapt" for entry in told["skipped"])


def test_blocks_of_points_that_no_tile_needs_are_not_projected():
    """Rows of a plane, of which only the rim still changes: with a narrow filter not of all rows."""
    cloud = build.points("tiles plane", clouds.plane_cloud(300))
    settings = Settings(technique="IMAGE_SPACE", use_shadows=False, filter_size=0.75)
    case = Case(build.scene((cloud, np.eye(4))), cameras.camera(eye=(0, -1, 4), resolution=(256, 256)), settings)
    frame = Frame(drawing.opengl(), case.scene, case.request(COMBINED, SAMPLES))
    before = sum(draw.count for draw in frame.uploads.points.draws)
    while frame.sample():
        pass
    after = sum(draw.count for draw in frame.uploads.points.draws)
    assert 0 < after < before
    frame.release()


def test_dilation_reaches_as_far_in_all_directions():
    mask = np.zeros((7, 9), bool)
    mask[3, 4] = True
    for by in (0, 1, 2):
        y, x = np.nonzero(dilated(mask, by))
        assert (y.min(), y.max(), x.min(), x.max()) == (3 - by, 3 + by, 4 - by, 4 + by)
        assert len(y) == (2 * by + 1) ** 2


def test_odd_numbers_of_samples_lie_around_the_centre():
    for count in (1, 3, FIRST_CHECK, 9, 17):
        assert np.abs(offsets(count).mean(axis=0)).max() < 1e-12  # measured 4e-16


def test_tiles_are_as_wide_as_they_say():
    case = large("mixed")
    frame = Frame(drawing.opengl(), case.scene, case.request(COMBINED, SAMPLES))
    assert frame.adaptive is not None
    width, height = frame.view.window[2:]
    assert frame.adaptive.counts.shape == (-(-height // TILE), -(-width // TILE))
    assert frame.adaptive.samples(3).shape == (height, width, 1)
    frame.release()
