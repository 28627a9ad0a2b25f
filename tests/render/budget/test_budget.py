"""Budgets: pictures take the time that they may, or are as exact as they must be; without one nothing changes."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.splat.blur import NODE_SIZE
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.budget import budgeted, error
from pointsplat_addon.render.budget.pacing import MOST_SAMPLES, Pacer
from pointsplat_addon.render.budget.viewport import Moving, Refining
from pointsplat_addon.render.frame import translucent
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.frame.sample_positions import offsets
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import cameras, drawing
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.store import STORE
from scripts.studies import defocus_pictures

COMBINED = frozenset({"combined"})
# ms: what comes once, a sample, and both per splat; splats at the tolerance of one pixel; the budget.
DEVICES = {
    "one sample needs a coarser cut": (1.0, 1.0, 0.0, 1e-4, 1e6, 16.0),
    "and so does what comes once": (3.0, 4.0, 1e-6, 1e-5, 4e6, 33.0),
    "splats cost all": (0.5, 1.0, 0.0, 1e-5, 1e7, 16.0),
    "two samples fit or nearly so": (1.0, 2.0, 0.0, 1e-4, 1e5, 16.0),
    "between one sample and two": (10.0, 5.0, 1e-5, 6.5e-5, 1e6, 100.0),
    "many samples": (100.0, 20.0, 1e-4, 1e-4, 1e5, 1000.0),
}


def paced(once, each, once_splat, each_splat, splats, allowed, *, seed, motion, noise=0.1, first=5.0) -> np.ndarray:
    """(25,) times over the budget of a camera that moves by a part `motion` a frame; the first compiles and caches."""
    random, pacer, found, near = np.random.default_rng(seed), Pacer(), [], 1.0
    for step in range(25):
        near *= 1 + motion * np.sin(step / 3)
        choice = pacer.choose(allowed, 1.0)
        cut = splats * near / choice.tolerance**2
        slow = first if step == 0 else 1.0
        before = (once + once_splat * cut) * random.uniform(1 - noise, 1 + noise) * slow
        sample = (each + each_splat * cut) * random.uniform(1 - noise, 1 + noise) * slow
        count = choice.samples if step else 1  # as InTime does
        pacer.measured(choice.tolerance, int(cut), before, sample)
        found.append(before + count * sample)
    return np.array(found) / allowed


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("motion", [0.0, 0.05, 0.1])
def test_after_three_pictures_they_take_the_time_that_they_may(name, motion):
    for seed in range(5):
        for first in (1.0, 5.0):
            times = paced(*DEVICES[name], seed=seed, motion=motion, first=first)
            assert abs(np.median(times[3:23]) - 1) < 0.2  # of the budget; measured 0.057
            assert times[3:23].max() < 2.5  # measured 1.47


def test_where_nothing_coarser_helps_the_best_that_fits_is_drawn():
    """A sample takes 10 of 16 ms whatever the cut: two never fit."""
    times = paced(0.5, 9.5, 0.0, 1e-8, 1e5, 16.0, seed=0, motion=0.0)
    assert 0.5 < np.median(times[3:]) < 0.75  # measured 0.63


def test_a_scene_that_grows_is_drawn_coarser_at_once():
    pacer = Pacer()
    for _ in range(4):
        pacer.measured(1.0, 10_000, 1.0, 10.0)
    assert pacer.choose(12.0, 1.0).tolerance == 1.0
    pacer.measured(1.0, 1_000_000, 1.0, 1000.0)
    pacer.measured(1.0, 1_000_000, 1.0, 1000.0)
    assert pacer.choose(12.0, 1.0).tolerance > 2.0


class Ticking:
    """A clock that knows what each draw of a device takes: one millisecond."""

    def __init__(self, device: NullDevice) -> None:
        self.device = device

    def __call__(self) -> float:
        return len(self.device.calls) / 1000


def asked(name: str, samples: int = 8, **settings) -> tuple[Scene, Request]:
    case = CASES[name]()
    return case.scene, replace(case.request(COMBINED, samples), settings=replace(case.settings, **settings))


@pytest.mark.parametrize("aperture", [None, Aperture(0.1, 3.5)])
@pytest.mark.parametrize("milliseconds", [40.0, 200.0])
def test_a_picture_stops_in_time(milliseconds, aperture):
    """The first one too, of which nothing is known."""
    device = NullDevice()
    renderer, clock = Renderer(device, STORE), Ticking(device)
    scene, request = asked("mixed", budget="TIME", time_budget=milliseconds)
    request, times = replace(request, camera=replace(request.camera, aperture=aperture)), []
    for _ in range(4):
        before = len(device.calls)
        result = budgeted.render_within_budget(renderer, scene, request, lambda *_: None, lambda: False, clock)
        times.append(len(device.calls) - before)
        assert result.report["estimate"]["seconds"] == pytest.approx(times[-1] / 1000)
    # Whole samples: 0.075 at most, of 40 draws, and 0.005, of 200.
    assert (np.abs(np.array(times) / milliseconds - 1) < 0.2).all()


def test_a_view_that_moves_keeps_its_time():
    device = NullDevice()
    renderer, clock = Renderer(device, STORE), Ticking(device)
    scene, request = asked("mixed", 16, budget="TIME", time_budget=100.0)
    request, times = replace(request, interactive=True), []
    for step in range(6):
        moved = replace(request, camera=cameras.camera(eye=(0.1 * step, -4, 0)))
        keeper, before = Moving(renderer, scene, moved, clock), len(device.calls)
        drawn = renderer.start(scene, keeper.request)
        assert not keeper.sample(drawn)
        drawn.release()
        times.append(len(device.calls) - before)
    assert (np.abs(np.array(times[3:]) / 100 - 1) < 0.2).all()  # measured 0.02


def test_a_viewport_that_stands_still_ends_below_its_error():
    scene, request = asked("mixed", budget="ERROR", error_budget=0.02)
    keeper = Refining(replace(request, interactive=True))
    drawn = drawing.opengl().start(scene, keeper.request)
    while keeper.sample(drawn):
        pass
    assert drawn.complete
    assert 5 <= drawn.done < 65  # measured 9
    drawn.release()


def long(*names: str) -> list:
    """Parameters of tests that run with --long alone."""
    return [pytest.param(name, marks=pytest.mark.long) for name in names]


# "empty", "unlit" and "in_smoke", below 1e-5, have no error to compare; "many_towers" takes too long.
SLOW = ("panes", "tinted_panes", "panes_of_functions", "split_mesh", "textured", "tinted_smoke", "in_fog")
ONE_SAMPLE = ("captured_alone", "captured_in_smoke", "captured_trained")  # is all that these take: nothing compares
SHOWN = (
    *(name for name in CASES if name not in {"empty", "unlit", "in_smoke", "many_towers", *ONE_SAMPLE, *SLOW}),
    *long(*SLOW),
)
# Those whose ratios are the least and the largest come first. The rest are alike, and take minutes.
LENSES = (
    "cube", "instances", "mixed", "textured",
    *long(
        "emission", "foliage", "holdout", "lights", "moving", "panes", "parallel", "smoke", "sphere", "strands",
        "tinted_smoke", "wide_balls",
    ),
)  # fmt: skip
SAMPLED = ("smoke", *long("cube", "foliage", "mixed"))
LAMPS = ("strands", *long("foliage", "mixed", "smoke", "tinted_smoke"))
CONVERGED = 513  # samples


def ratios(case: Case, monkeypatch: pytest.MonkeyPatch, limits=(0.03, 0.01, 0.003)) -> list[float]:
    """The estimate, for each budget, over the distance from the same technique at so many samples, all translucent
    splats lit for each of them, and cuts of a quarter of the size."""
    STORE.clear()
    request = case.request(COMBINED, 16)
    found = []
    for limit in limits:
        asked = replace(request, settings=replace(case.settings, technique="AUTO", budget="ERROR", error_budget=limit))
        found.append(drawing.opengl().render(case.scene, asked))
        report = found[-1].report
        # More samples than MOST_SAMPLES are not drawn.
        assert report["estimate"]["rmse"] <= limit or report["samples"] == MOST_SAMPLES
    (technique,) = {result.report["technique"]["name"] for result in found}
    tolerance = case.settings.tolerance / 4
    settings = replace(case.settings, technique=technique, tolerance=tolerance, use_adaptive_sampling=False)
    monkeypatch.setattr(translucent, "LIGHTINGS", CONVERGED)
    best = Request(case.camera, settings, COMBINED, CONVERGED, node=NODE_SIZE / 4)
    truth = drawing.opengl().render(case.scene, best).pixels["combined"]
    estimates = [result.report["estimate"]["rmse"] for result in found]
    distances = [error.rms_difference(result.pixels["combined"], truth) for result in found]
    return [e / d for e, d in zip(estimates, distances, strict=True)]


def through_lens(case: Case) -> Case:
    aperture = Aperture(0.15, 4.0) if case.camera.perspective else Aperture(0.3, 10.0)
    return replace(case, camera=replace(case.camera, aperture=aperture))


def under_wide_lamps(case: Case) -> Case:
    """With shadows."""
    lights = tuple(replace(x, radius=max(x.radius, 0.15 if x.kind == "SUN" else 0.4)) for x in case.scene.lights)
    settings = replace(case.settings, use_shadows=True, shadow_resolution=256)
    return replace(case, scene=replace(case.scene, lights=lights), settings=settings)


@pytest.mark.parametrize("name", SHOWN)
def test_the_estimate_is_within_a_factor_of_two(name, monkeypatch):
    found = ratios(CASES[name](), monkeypatch)
    assert all(0.5 < ratio < 2.0 for ratio in found)  # measured 0.53 (panes) and 1.87 (captured)


@pytest.mark.parametrize("name", LENSES)
def test_the_estimate_sees_what_is_out_of_focus(name, monkeypatch):
    found = ratios(through_lens(CASES[name]()), monkeypatch)
    assert all(0.5 < ratio < 2.0 for ratio in found)  # measured 0.62 (cube) and 1.30 (instances)


@pytest.mark.parametrize("name", SAMPLED)
def test_the_estimate_holds_for_samples_through_the_lens(name, monkeypatch):
    case = through_lens(CASES[name]())
    found = ratios(replace(case, settings=replace(case.settings, dof_method="LENS_SAMPLES")), monkeypatch)
    assert all(0.5 < ratio < 2.0 for ratio in found)  # measured 0.54 and 1.87 (smoke)


@pytest.mark.parametrize("name", LAMPS)
def test_the_estimate_sees_the_shadows_of_wide_lamps(name, monkeypatch):
    found = ratios(under_wide_lamps(CASES[name]()), monkeypatch)
    assert all(0.5 < ratio < 2.0 for ratio in found)  # measured 0.62 (strands) and 1.28 (smoke)


def test_an_error_that_is_one_number_is_not_taken_for_less(monkeypatch):
    """A camera in smoke under one wide lamp: all of the picture is too bright or too dark, and now and then right."""
    assert min(ratios(under_wide_lamps(CASES["in_smoke"]()), monkeypatch)) > 0.5  # measured 0.82


@pytest.mark.parametrize("number", range(4))
def test_the_estimate_holds_for_scenes_that_its_factors_were_not_fitted_to(number, monkeypatch):
    """The pictures of docs/notes/depth_of_field.md, at a quarter of their size."""
    made = (defocus_pictures.floor, lambda: defocus_pictures.shell(False), lambda: defocus_pictures.shell(True),
            defocus_pictures.strands)  # fmt: skip
    scene, camera = made[number]()
    width, height = camera.resolution
    case = Case(scene, replace(camera, resolution=(width // 4, height // 4)))
    found = ratios(case, monkeypatch, (0.03, 0.005))
    assert all(0.5 < ratio < 2.0 for ratio in found)  # measured 0.60 (strands) and 1.23 (balls)


def test_what_no_sample_met_is_told_from_steps_beside_a_pixel():
    """Nothing of an even slope; of a step what an edge covers at most unseen, less with more samples."""
    across = np.arange(8.0)
    slope = np.repeat(np.broadcast_to(0.1 * across, (6, 8))[..., None], 3, axis=-1)
    assert error.missed_edge_error(slope, 5).max() < 1e-30
    step = np.repeat(np.broadcast_to((across > 3) * 0.5, (6, 8))[..., None], 3, axis=-1)
    found = error.missed_edge_error(step, 5)
    np.testing.assert_allclose(found[:, 3:5], (0.5 * error.MOST_UNSEEN) ** 2)
    assert not np.delete(found, (3, 4), axis=1).any()
    counts = np.full((6, 8, 1), 5.0)
    counts[3:] = 129.0
    few, many = error.missed_edge_error(step, counts)[[0, 5], 3]
    assert many == pytest.approx((0.5 * error.UNSEEN / 129) ** 2)
    assert many < few


def test_of_what_is_out_of_focus_no_edge_is_missed():
    """Only samples can miss one: nothing where they decide nothing, up to the pixels beside what they do."""
    step = np.repeat(np.broadcast_to((np.arange(8.0) > 3) * 0.5, (6, 8))[..., None], 3, axis=-1)
    everywhere = error.missed_edge_error(step, 5)
    sharp = np.zeros((6, 8, 1))
    sharp[0, 4] = 0.5
    found = error.missed_edge_error(step, 5, sharp)
    np.testing.assert_allclose(found[:2, 3:5], 0.25 * everywhere[:2, 3:5])
    assert not found[2:].any()
    np.testing.assert_array_equal(error.missed_edge_error(step, 5, np.ones((6, 8, 1))), everywhere)


def test_where_samples_alone_would_do_the_cut_gets_finer():
    """Of what all samples leave and what the cut does, each is less than the error may be, and both are more."""
    case = through_lens(CASES["emission"]())
    STORE.clear()
    settings = replace(case.settings, technique="AUTO", budget="ERROR", error_budget=0.003, filter_size=0.75)
    report = drawing.opengl().render(case.scene, replace(case.request(COMBINED, 16), settings=settings)).report
    assert report["estimate"]["rmse"] <= 0.003  # measured 0.0026; 0.0034 with the first cut
    assert report["points"]["cut"] > 10_000  # 87,435; the first cut has 2,410


def test_an_edge_leaves_a_pixel_that_no_sample_met_it_in_as_little_as_is_taken():
    """Half-planes in all directions, at all places where the first samples miss them."""
    every = offsets(4097)
    for count in (5, 9, 17, 33, 65, 129):
        covered = []
        for turn in np.linspace(0, 2 * np.pi, 72, endpoint=False):
            along = every @ np.array([np.cos(turn), np.sin(turn)])
            places = np.linspace(0, 2, 201)  # pixels, to beyond the filter
            share = 1 - np.searchsorted(np.sort(along), places) / len(every)
            covered.append(share[places > along[:count].max()])
        used = min(error.MOST_UNSEEN, error.UNSEEN / count)
        assert 0.6 < np.sqrt((np.concatenate(covered) ** 2).mean()) / used < 1.2  # measured 0.68 (17) and 1.03 (65)


def test_tiles_with_edges_go_on_where_an_error_is_asked_for():
    """Edges along the pixels' sides, which the first samples all miss: the tile would end, and be wrong."""
    scene, request = asked("moving", budget="ERROR", error_budget=0.003)
    result = drawing.opengl().render(scene, request)
    exact = replace(request, settings=replace(request.settings, budget="NONE", use_adaptive_sampling=False))
    truth = drawing.opengl().render(scene, replace(exact, samples=CONVERGED)).pixels["combined"]
    assert (
        error.rms_difference(result.pixels["combined"], truth) < 0.003
    )  # measured 0.0012; 0.0045 where tiles just end


def test_a_cut_is_compared_without_touching_what_the_picture_uses():
    """Another frame sorts translucent splats and lights them, and this one goes on with its own."""
    case = under_wide_lamps(CASES["panes"]())
    scene, request = case.scene, case.request(COMBINED, 9)
    renderer = drawing.opengl()
    STORE.clear()
    alone = renderer.render(scene, request).pixels["combined"]
    STORE.clear()
    drawn = Frame(renderer, scene, request)
    try:
        while drawn.sample():
            finer = replace(request, settings=replace(request.settings, tolerance=request.settings.tolerance / 2))
            if drawn.done == 3:
                assert drawn.other(finer, 3) is not None
        np.testing.assert_array_equal(drawn.pixels()["combined"], alone)
    finally:
        drawn.release()


def test_what_is_exact_takes_no_more_samples():
    for name in ("empty", "unlit"):
        scene, request = asked(name, budget="ERROR", error_budget=0.001)
        report = drawing.opengl().render(scene, request).report
        assert report["estimate"]["rmse"] == 0.0
        assert report["points"]["drawn"] <= 5 * report["points"]["cut"]


def test_without_a_budget_nothing_changes():
    """Neither picture nor passes, whatever the budgets are."""
    calls, pictures = [], []
    for limit in (1.0, 0.5):
        scene, request = asked("mixed", budget="NONE", time_budget=limit, error_budget=limit)
        device = NullDevice()
        report = Renderer(device, STORE).render(scene, request).report
        assert "estimate" not in report
        calls.append([(call.interface.name, call.count) for call in device.calls])
        assert sum(name == "shade" for name, _ in calls[-1]) == 8
        pictures.append(drawing.opengl().render(scene, request).pixels["combined"])
    assert calls[0] == calls[1]
    np.testing.assert_array_equal(*pictures)


def test_the_default_is_no_budget():
    assert Settings(technique="IMAGE_SPACE").budget == "NONE"


def test_a_cancelled_picture_ends():
    scene, request = asked("mixed", budget="ERROR", error_budget=0.001)
    asks = iter(range(100))
    result = drawing.opengl().render(scene, request, cancelled=lambda: next(asks) > 3)
    assert result.cancelled
