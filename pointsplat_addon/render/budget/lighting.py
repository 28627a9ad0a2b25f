"""Indirect light in a viewport: it is gathered between redraws, once the view stands still."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from ...core.scene.scene import Scene
from ..device.clock import Cancelled
from ..frame.frame import Frame
from ..indirect.known_sites import Slices
from ..plan.request import Request
from .protocol import SampleRenderer, Seconds

LEAST_SECONDS = 0.05  # of gathering between two redraws


class Lighting:
    """Makes a picture with indirect light, a little between any two redraws of another that is shown until then.

    Gathering is put off after a moment, with the frame that asked for it, and the next frame finds what was gathered.
    Each gathers for about as long as beginning anew takes, so that at most half of the time is lost.
    """

    def __init__(
        self,
        renderer: SampleRenderer,
        scene: Scene,
        request: Request,
        sample: Callable[[Frame], bool] = Frame.sample,
        clock: Seconds = time.perf_counter,
    ) -> None:
        """`request`: its settings have indirect light. `sample`: draws one sample; returns False when there were
        enough."""
        self._renderer, self._scene, self._request = renderer, scene, request
        self._sample, self._clock = sample, clock
        self._seconds = LEAST_SECONDS
        self.frame: Frame | None = None
        self.done = False  # the frame is complete, or there is none, since nothing has indirect light

    def go_on(self) -> None:
        """Works for a moment. DeviceError, ShaderError: the picture cannot be drawn."""
        if self.done or self._renderer.store.building:
            return
        if self.frame is not None:
            self.done = not self._sample(self.frame)
            return
        slices, began = Slices(self._seconds), self._clock()
        frame = None
        try:
            frame = self._renderer.start(self._scene, self._request, slices)
            if frame.frame_plan.plan.indirect or frame.frame_plan.plan.gathers_media:
                self.done = not self._sample(frame)
                slices.seconds = math.inf
                self.frame, frame = frame, None
            else:
                self.done = True
        except Cancelled:
            self._seconds = max(self._clock() - began - slices.spent, LEAST_SECONDS)
        finally:
            if frame is not None:
                frame.release()

    def release(self) -> None:
        """Frees what is on the device."""
        if self.frame is not None:
            self.frame.release()
        self.frame = None
