"""Indirect light in a viewport: it is gathered between redraws, once the view stands still."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ..device.clock import Cancelled
from ..frame.frame import Frame
from ..frame.indirect.kept import scene_content
from ..indirect.known_sites import Slices
from ..indirect.light import IndirectLight
from ..plan.request import Request
from .protocol import SampleRenderer, Seconds

LEAST_SECONDS = 0.05  # of gathering between two redraws


class KnownLight:
    """Indirect light that was brought into a view, for others of the same scene until theirs is there: what it is
    estimated from. Nothing of it depends on where the camera is."""

    def __init__(self, renderer: SampleRenderer, scene: Scene, settings: Settings, light: IndirectLight) -> None:
        """`scene`, `settings`: that a view shows."""
        self.light = light
        self._kept, self._scene, self._settings = renderer.kept, scene, settings
        self._content = scene_content(scene, renderer.store)
        self._used = self._kept.begin()
        if light.key is not None:
            self._used.add(light.key)

    def is_of(self, renderer: SampleRenderer, scene: Scene, settings: Settings) -> bool:
        """Whether it is the light of what a view shows, wherever its camera is."""
        key = self.light.key
        if settings != self._settings or renderer.kept is not self._kept or key is None or key not in self._kept:
            return False
        if scene is not self._scene:
            if scene_content(scene, renderer.store) != self._content:
                return False
            self._scene = scene
        return True

    def release(self) -> None:
        """Lets the device free it."""
        self._kept.end(self._used)


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
