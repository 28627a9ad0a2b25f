"""Pictures that follow the first one of a view that stands still: with more sub-samples, with indirect light."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from ...core.scene.scene import Scene
from ..device.clock import Cancelled
from ..device.protocol import wait
from ..frame.frame import Frame
from ..indirect.known_sites import Slices
from ..indirect.light import IndirectLight
from ..plan.request import Request
from .protocol import SampleRenderer, Seconds

LEAST_SECONDS = 0.05  # of work between two redraws


class Following:
    """Makes a picture, a little between any two redraws of another that is shown until then.

    Drawing stops between tiles of a sample, and gathering between slices. Where it is put off before samples are drawn,
    so is the frame that asked for it, and the next one finds what was gathered. Each gathers for about as long as
    beginning anew takes, so that at most half of the time is lost.
    """

    def __init__(
        self,
        renderer: SampleRenderer,
        scene: Scene,
        request: Request,
        known: IndirectLight | None = None,
        sample: Callable[[Frame], bool] = Frame.sample_tile,
        clock: Seconds = time.perf_counter,
    ) -> None:
        """`known`: indirect light is estimated from it. `sample`: draws more of a frame; returns False when there was
        enough."""
        self._renderer, self._scene, self._request, self._known = renderer, scene, request, known
        self._sample, self._clock = sample, clock
        self.gathers = request.settings.use_indirect and known is None  # indirect light
        self._seconds = LEAST_SECONDS  # of gathering before a frame is put off
        self._worked = 0.0  # seconds, for the frame
        self._slices = Slices()
        self.frame: Frame | None = None
        self.done = False  # the frame is complete, or there is none, since nothing has the indirect light that it adds

    def go_on(self) -> None:
        """Works for a moment. DeviceError, ShaderError: the picture cannot be drawn."""
        began, self._slices.spent = self._clock(), 0.0
        while not self.done and not (self.gathers and self._renderer.store.building):
            before = self._clock()
            put_off = not self._work()
            now = self._clock()
            self._worked += now - before
            if put_off:
                self._seconds = max(self._worked - self._slices.spent, LEAST_SECONDS)
            if put_off or now - began >= LEAST_SECONDS:
                break

    def _work(self) -> bool:
        """Begins the frame, or draws more of it; returns False where the frame was put off."""
        try:
            if self.frame is None:
                self._begin()
            else:
                self.done = not self._sample(self.frame)
                wait(self._renderer.device)
        except Cancelled:
            self.release()
            return False
        return True

    def _begin(self) -> None:
        """Begins the frame. Cancelled: gathering was put off."""
        self._worked, self._slices = 0.0, Slices(self._seconds if self.gathers else math.inf)
        frame = self._renderer.start(self._scene, self._request, self._slices, self._known)
        plan = frame.frame_plan.plan
        if self.gathers and not (plan.indirect or plan.gathers_media):
            frame.release()
            self.done = True
            return
        self.frame = frame
        if self.gathers and plan.gathers_by_tile:
            self._slices.seconds = LEAST_SECONDS

    def taken(self) -> Frame:
        """Returns the frame, which the caller releases."""
        frame, self.frame, self.done = self.frame, None, True
        assert frame is not None
        self._slices.seconds = math.inf
        return frame

    def release(self) -> None:
        """Frees what is on the device."""
        if self.frame is not None:
            self.frame.release()
        self.frame = None


class Followers:
    """The pictures that take the place of a view's first one, in turn."""

    def __init__(self) -> None:
        self._waiting: list[Following] = []

    def __bool__(self) -> bool:
        """Whether another picture may follow."""
        return bool(self._waiting)

    def add(self, following: Following) -> None:
        """Adds one that follows all before it."""
        self._waiting.append(following)

    def go_on(self, shown: Frame) -> Frame:
        """Works for a moment on the one that follows `shown`, whose samples are all drawn. Returns what is shown from
        now on: that with more sub-samples at once as soon as it has a sample, that with indirect light as soon as it
        has them all; `shown` is released then. DeviceError, ShaderError: it cannot be drawn."""
        if self._waiting and not (self._waiting[0].gathers or shown.frame_plan.followed):
            del self._waiting[0]  # it would be the same picture
        if not self._waiting:
            return shown
        following = self._waiting[0]
        shown.keep_shown()
        following.go_on()
        started = following.frame is not None and following.frame.done > 0
        if following.done or (started and not following.gathers):
            del self._waiting[0]
            if following.frame is not None:
                shown.release()
                return following.taken()
        return shown

    def release(self) -> None:
        """Frees what is on the device; nothing follows any more."""
        for following in self._waiting:
            following.release()
        self._waiting.clear()
