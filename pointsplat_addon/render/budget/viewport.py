"""Budgets in a viewport: pictures while the view moves, and one that is refined while it stands still."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ...core.scene.scene import Scene
from ..device.protocol import Device
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


def wait(device: Device) -> None:
    """Waits until the device has finished its work: reading a texture does so on every device."""
    texel = device.texture((1, 1), "R32F", np.zeros(1, np.float32))
    device.read(texel)
    texel.release()
