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
            _wait(self._device)
            if watch.enough(frame):
                break
        frame.end()
        _wait(self._device)
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


def _wait(device: Device) -> None:
    """Waits until the device has finished its work: reading a texture does so on every device."""
    texel = device.texture((1, 1), "R32F", np.zeros(1, np.float32))
    device.read(texel)
    texel.release()
