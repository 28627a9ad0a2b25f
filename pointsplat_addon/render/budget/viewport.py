"""Budgets in a viewport: pictures while the view moves, and one that is refined while it stands still."""

from __future__ import annotations

import time
from dataclasses import replace

from ...core.scene.scene import Scene
from ..device.protocol import wait
from ..frame.frame import Frame
from ..plan.request import Request
from .budgeted import _chosen, _threshold
from .pacing import MOST_SAMPLES
from .protocol import SampleRenderer, Seconds
from .watch import BelowError, InTime

FRAME_SECONDS = 0.1  # that a picture takes at most while the view moves, unless it was too coarse
# How coarse it is, from the finest: how many pixels of a view that stands still one of its own takes each way, and its
# tolerance in pixels of a view that stands still, times that of the settings.
STEPS = ((1, 1.0), (1, 2.0), (1, 4.0), (2, 4.0), (4, 4.0), (4, 6.0), (4, 8.0))
FIRST = 2  # of these: with a sixteenth of the points
MORE_PAGES = 0.25  # of those of a picture have to come before another one is drawn, or all that are to come
LONGEST_PAUSE = 2.0  # seconds, after which fewer pages are enough, where that is longer than drawing takes
LEAST_PAUSE = 0.3  # seconds between two pictures of a still view for which pages come
COMPILING = 0.5  # of the time of the first picture: it compiles shaders
PIXELS_AS_PAGES = 64  # that take as long as the pixels of a picture of fewer
HASTY_PIXELS = (
    2  # how many pixels one of such a picture takes each way, where fine ones would take longer than LEAST_PAUSE
)
# Times that a picture was faster than it need be where the next finer one is drawn: four times as many pixels, or up to
# eight times as many nodes of what is solid.
SPARE, SPARE_OF_NODES = 5.0, 10.0


class Pace:
    """How coarse the pictures of a view that moves are, so that each is drawn in time."""

    def __init__(self) -> None:
        self._step = FIRST
        self._compiled = False

    @property
    def times(self) -> int:
        """How many pixels of a view that stands still one of the picture takes each way."""
        return STEPS[self._step][0]

    @property
    def tolerance(self) -> float:
        """In pixels of the picture, times that of the settings."""
        times, tolerance = STEPS[self._step]
        return tolerance / times

    def measured(self, seconds: float) -> None:
        """Takes in how long a picture took, from its planning to its last pixel."""
        if not self._compiled:
            # The first picture compiled shaders and filled caches.
            self._compiled = True
        elif seconds > FRAME_SECONDS:
            self._step = min(self._step + 1, len(STEPS) - 1)
        elif seconds * (SPARE if self._step > FIRST else SPARE_OF_NODES) < FRAME_SECONDS:
            self._step = max(self._step - 1, 0)


class Arrivals:
    """When a still view is drawn again for which pages of scans come, and how finely."""

    def __init__(self) -> None:
        self.pixels = HASTY_PIXELS  # how many pixels of the view one of a picture takes each way while pages come
        self.forget()

    def forget(self) -> None:
        """Begins anew: nothing has been drawn of the scene."""
        self.begun = False  # whether a picture was
        self._at, self._took = 0.0, 0.0  # when the last one was begun, and what drawing it took, seconds
        self._ended, self._there = 0.0, 0  # when it was done, and how many pages had come until then
        self._again = 0.0  # what drawing it once more would take, at most

    def drawn(self, at: float, seconds: float, hasty: bool, there: int) -> None:
        """Takes in that a picture was begun at a time and took so long. `hasty`: one of which pages are to come;
        `there`: pages that have come since the program began."""
        self._ended, self._there, self._again = at + seconds, there, seconds
        if self.begun:
            if hasty:
                fine = seconds * self.pixels**2  # at most
                self.pixels = HASTY_PIXELS if fine > LEAST_PAUSE else 1
        else:
            self._again *= 1 - COMPILING
            seconds = 0.0  # it compiled shaders, which others need not
        self.begun, self._at, self._took = True, at, seconds

    def are_enough(self, now: float, pages: int, arrived: int, missing: int, there: int) -> bool:
        """Whether another picture is drawn while pages come. `pages`: of the last one; `arrived`: since that was begun;
        `missing`: that are still to come; `there`: see `drawn`. As much time goes to pages as to drawing what is there,
        and pictures are those of ever more pages; none is drawn where all will have come before it is done, at the rate
        at which they come while nothing is drawn."""
        since, idle, came = now - self._at, now - self._ended, there - self._there
        more = arrived > MORE_PAGES * pages or (arrived > 0 and since > LONGEST_PAUSE)
        if not (more and since > 2 * self._took + LEAST_PAUSE and idle > LEAST_PAUSE):
            return False
        took = self._again * (pages + arrived) / max(pages, PIXELS_AS_PAGES)  # of the next picture, at most
        return missing * idle > took * came


class Moving:
    """Draws the pictures of a viewport while its view moves, each as good as there is time for."""

    def __init__(
        self, renderer: SampleRenderer, scene: Scene, request: Request, clock: Seconds = time.perf_counter
    ) -> None:
        """`request` has the tolerance and the samples of a picture that stands still."""
        settings = request.settings
        self._pacer, self._device = renderer.pacers.of(scene, request), renderer.device
        choice = self._pacer.choose(settings.time_budget, settings.tolerance, request.samples)
        self.request = _chosen(request, choice, request.samples)
        self._watch = InTime(settings.time_budget, self._pacer.after, clock, measure=False)

    def sample(self, frame: Frame) -> bool:
        """Draws all samples at once; returns False: there are no more."""
        watch = self._watch
        watch.ready(frame)
        frame.hurried = True
        while not frame.complete:
            frame.sample()
            wait(self._device)
            if watch.enough(frame):
                break
        frame.end()
        wait(self._device)
        watch.finished()
        self._pacer.measured(self.request.settings.tolerance, watch.splats, watch.prepared, watch.each, watch.after)
        return False


class Refining:
    """Refines the picture of a viewport that stands still until its error by samples is small enough, at a fixed
    cut."""

    def __init__(self, request: Request, clock: Seconds = time.perf_counter) -> None:
        settings = request.settings
        asked = replace(settings, adaptive_threshold=_threshold(settings))
        self.request = replace(request, settings=asked, samples=MOST_SAMPLES)
        self._watch = BelowError(settings.error_budget, lambda frame: (1.0, frame.mean()), clock)

    def sample(self, frame: Frame) -> bool:
        """Draws one sample; returns False when there were enough."""
        if frame.complete:
            return False
        frame.sample()
        if self._watch.enough(frame):
            frame.end()
        return not frame.complete
