"""Draws a picture within a budget: a time to keep, or an error to stay below (docs/notes/budgets.md).

TIME chooses how many samples a picture gets, and how coarse its cut is, from what earlier pictures of the scene took.
ERROR measures how far the mean of all samples still moves, and how far another cut lies from this one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ..frame.frame import Frame
from ..plan.request import Request, Result
from .pacing import MOST_SAMPLES, Choice
from .protocol import Progress, SampleRenderer, Seconds
from .watch import EARLY, BelowError, InTime

FINEST = 0.25  # times it: what ERROR ends at
RATIOS = (2.0, 4.0)  # of a tolerance to the finer one that it is compared with
TILES_PART = 0.25  # of the error budget: difference at which tiles end


def render_within_budget(
    renderer: SampleRenderer,
    scene: Scene,
    request: Request,
    progress: Progress,
    cancelled: Callable[[], bool],
    clock: Seconds = time.perf_counter,
) -> Result:
    """Draws a picture within its budget. Its report tells the "estimate": the error "rmse" and the "seconds" that it
    took."""
    began = clock()
    keep = render_in_time if request.settings.budget == "TIME" else render_below_error
    result, rmse = keep(renderer, scene, request, progress, cancelled, clock)
    if not result.report:
        return result
    seconds = clock() - began
    estimate = {"rmse": rmse if np.isfinite(rmse) else None, "seconds": seconds}
    return replace(result, report={**result.report, "seconds": seconds, "estimate": estimate})


def render_in_time(
    renderer: SampleRenderer,
    scene: Scene,
    request: Request,
    progress: Progress,
    cancelled: Callable[[], bool],
    clock: Seconds,
) -> tuple[Result, float]:
    """Draws a picture that takes as long as it may; returns it and its error by samples. To find the error of its cut
    would take more time."""
    settings, pacer = request.settings, renderer.pacers.of(scene, request)
    choice = pacer.choose(settings.time_budget, settings.tolerance)
    watch = InTime(settings.time_budget, pacer.after, clock)
    result = renderer.draw(scene, _chosen(request, choice, MOST_SAMPLES), progress, cancelled, watch)
    if watch.done:
        pacer.measured(choice.tolerance, watch.splats, watch.prepared, watch.each, watch.after)
    return result, watch.errors.rmse


def _chosen(request: Request, choice: Choice, most: int) -> Request:
    """Returns the request for a choice, with room for half as many samples more, where a picture turns out faster than
    those before: InTime ends it."""
    settings = replace(request.settings, tolerance=choice.tolerance)
    samples = min(choice.samples + -(-choice.samples // 2), most)
    return replace(request, settings=settings, samples=samples, coarse=choice.coarse)


def render_below_error(
    renderer: SampleRenderer,
    scene: Scene,
    request: Request,
    progress: Progress,
    cancelled: Callable[[], bool],
    clock: Seconds,
) -> tuple[Result, float]:
    """Draws a picture whose error is at most what it may be, within MOST_SAMPLES and FINEST; returns it and that error.

    After EARLY samples as many of a finer cut tell what the tolerance does. Where that is too much, the finer one is
    drawn instead; what it was sampled with is kept. So it is where all samples together leave too much, and the cut has
    a part in it.
    """
    settings = request.settings
    tolerance = settings.tolerance

    def at(value: float) -> Request:
        """Returns the request at a tolerance; what is out of focus is cut as much finer as what is in focus."""
        asked = replace(settings, tolerance=value, adaptive_threshold=_threshold(settings))
        node = request.node * value / settings.tolerance
        return replace(request, settings=asked, samples=MOST_SAMPLES, node=node)

    def finer(frame: Frame) -> tuple[float, np.ndarray]:
        """Returns the ratio and mean of the first finer cut that differs: finer samples of a mesh that are there
        already serve coarser cuts too."""
        for ratio in RATIOS:
            value = tolerance / ratio
            if value < FINEST * settings.tolerance * 0.999:
                break
            if (mean := frame.other(replace(at(value), passes=frozenset({"combined"})), EARLY)) is not None:
                return ratio, mean
        return 1.0, frame.mean()

    while True:
        watch = BelowError(settings.error_budget, finer, clock)
        result = renderer.draw(scene, at(tolerance), progress, cancelled, watch)
        if result.cancelled or not (watch.too_coarse or watch.too_much):
            return result, watch.rmse
        tolerance /= 2


def _threshold(settings: Settings) -> float:
    """Returns the threshold of adaptive sampling: tiles must not end before their error is well below the budget."""
    return min(settings.adaptive_threshold, TILES_PART * settings.error_budget)
