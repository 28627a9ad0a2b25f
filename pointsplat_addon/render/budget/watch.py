"""Decides after each sample of a picture whether it has enough: for a budget of time, or one of error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..frame.frame import Frame
from ..frame.sample_positions import is_checkpoint
from .error import Errors, rms_difference

EARLY = 5  # samples by which two cuts are compared: with fewer, edges that are not averaged differ more than the cuts
BLENDED = 9  # least samples where translucent splats are drawn: all pixels of one agree in how shadows are met
LEFT = {2.0: 1.2}  # distance from the finest cut over that from the one of half the tolerance
# Of the error budget that the cut may take, before a finer one is drawn: with what tiles end at (HELD_PART), whose
# square is added, no more than all of it.
CUT_PART = 0.85
HELD_PART = 0.5  # and error up to which they may


class Watch:
    """Decides after each sample of a picture whether it has enough samples."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.errors, self._clock = Errors(), clock
        self._began = self._ready = self._latest = clock()
        self.prepared = 0.0  # ms before the first sample
        self.each = 0.0  # ms of a sample, in the mean
        self.after = 0.0  # ms after the last sample
        self.splats = 0.0  # and what costs as much as so many
        self.done = 0
        self._measure = True

    def ready(self, frame: Frame) -> None:
        """Tells that the picture is prepared and its first sample comes next."""
        self._ready = self._clock()
        self.prepared = 1000 * (self._ready - self._began)
        self.splats = frame.frame_plan.reducible_work(frame.renderer.costs)

    def enough(self, frame: Frame) -> bool:
        """Returns whether the picture needs no more samples."""
        if self._measure:
            self.errors.look(frame)
        self.done = frame.done
        self._latest = self._clock()
        self.each = 1000 * (self._latest - self._ready) / frame.done
        return self.stops()

    def finished(self) -> None:
        """Tells that the picture is finished."""
        self.after = 1000 * (self._clock() - self._latest)

    def stops(self) -> bool:
        """Returns whether what was measured so far is enough."""
        raise NotImplementedError


class InTime(Watch):
    """Stops where the next sample would exceed the time by more than half of it."""

    def __init__(self, milliseconds: float, after: float, clock: Callable[[], float], measure: bool = True) -> None:
        """`after`: milliseconds that are left for what follows the samples. `measure`: estimate the error too, for
        which the picture is read back."""
        super().__init__(clock)
        self._milliseconds, self._measure = milliseconds - after, measure

    def stops(self) -> bool:
        return self.prepared + self.each * (self.done + 0.5) > self._milliseconds


class BelowError(Watch):
    """Stops where the error is small enough, or, after EARLY samples, where the cut proves too coarse for that."""

    def __init__(
        self, limit: float, finer: Callable[[Frame], tuple[float, np.ndarray]], clock: Callable[[], float]
    ) -> None:
        """`finer`: by how much the tolerance of another cut is finer, and its mean of EARLY samples; 1: none is."""
        super().__init__(clock)
        self._limit, self._finer = limit, finer
        self.cut_error = 0.0
        self.too_coarse = False
        self._least = EARLY

    def enough(self, frame: Frame) -> bool:
        self._least = BLENDED if frame.blends else EARLY
        if frame.done == EARLY:
            ratio, mean = self._finer(frame)
            self.cut_error = LEFT.get(ratio, 1.0) * rms_difference(mean, frame.mean())
            self.too_coarse = ratio > 1 and self.cut_error > CUT_PART * self._limit
        found = super().enough(frame)
        if is_checkpoint(frame.done) and not found:
            frame.hold(self.errors.squares, HELD_PART * self._limit)
        return found

    def stops(self) -> bool:
        return self.too_coarse or (self.done >= self._least and self.rmse <= self._limit)

    @property
    def rmse(self) -> float:
        return float(np.hypot(self.errors.rmse, self.cut_error))

    @property
    def too_much(self) -> bool:
        """Whether the error is more than it may be with all samples, which alone would do: the cut takes the rest."""
        return self.errors.rmse <= self._limit < self.rmse
