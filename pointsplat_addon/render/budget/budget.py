"""What a picture may cost: a time to keep, or an error to stay below (docs/notes/budgets.md).

TIME chooses how many samples a picture gets, and how coarse its cut is, from what earlier pictures of the scene took:
t(n, s) = p(s) + n q(s), with p what comes once and q what each sample takes, both linear in the splats s of the cut.
ERROR measures how far the mean of all samples still moves, and how far another cut lies from this one.
"""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ...core.scene.scene import Scene
from ...core.scene.settings import Settings

if TYPE_CHECKING:
    from ..device.protocol import Device
    from ..frame.frame import Frame
    from ..plan.request import Request, Result
    from ..renderer import Renderer

Progress = Callable[[float, str], None]
Clock = Callable[[], float]  # seconds

MOST_SAMPLES = 257  # of a picture with a budget: what more of them change cannot be seen
COARSEST = 16.0  # times the tolerance that the settings ask for: TIME goes no further
FINEST = 0.25  # times it: what ERROR ends at
REMEMBERED = 8  # pictures from which a line is fitted
UNLIKE = 2.0  # times what the inverse square gives: how a cut differs that follows another law
CUTS = 32  # pictures of which it is known how many splats a tolerance takes
MIDDLE_OF = 3  # latest pictures of which the middle one says how slow the device is now
PRIOR_SHARE, PRIOR_WEIGHT = 0.5, 0.05  # share of the time that splats take, before it was seen to change with them
MOST_STEP = 16.0  # by which the splats of one picture differ from those of the one before; and if they get more:
MOST_MORE = 4.0
STRETCH = 2.0  # times the tolerance: how much coarser a cut may get for the sake of one more sample
CLOSE = 0.06  # of the budget: what is predicted that near is left as it is, so that cuts do not flicker
SCENES = 16  # that a device remembers
EARLY = 5  # samples by which two cuts are compared: with fewer, edges that are not averaged differ more than the cuts
BLENDED = 9  # least samples where translucent splats are drawn: all pixels of one agree in how shadows are met
MOST_OF_ALL = 0.6  # of all samples, of which the mean is compared with that of all
RATIOS = (2.0, 4.0)  # of a tolerance to the finer one that it is compared with
LEFT = {2.0: 1.2}  # distance from the finest cut over that from the one of half the tolerance
EVENLY = 0.7  # of the error of independent samples: these are spread evenly
# Of the error budget that the cut may take, before a finer one is drawn: with what tiles end at (HELD_PART), whose
# square is added, no more than all of it.
CUT_PART = 0.85
TILES_PART = 0.25  # of the error budget: difference at which tiles end
HELD_PART = 0.5  # and error up to which they may
MOST_UNSEEN, UNSEEN = 0.015, 0.28  # of a pixel, that an edge beside it covers where none of its samples met it


@dataclass(frozen=True)
class Choice:
    """How a picture is drawn."""

    tolerance: float  # pixels
    samples: int
    coarse: bool = False  # not even one sample fits at the tolerance that was asked for


class Line:
    """Milliseconds over splats, from the latest pictures: m ((1 - r) + r s / s0), with r in [0, 1]."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        self._first = True

    def add(self, splats: float, ms: float) -> None:
        if self._first and len(self._seen) == 1:
            # The first picture compiled shaders and filled caches.
            self._seen.clear()
            self._first = False
        self._seen.append((max(splats, 1.0), max(ms, 1e-6)))

    def fitted(self) -> tuple[float, float]:
        """(constant, slope): ms, and ms per splat. (0, 0) where nothing was measured."""
        if not self._seen:
            return 0.0, 0.0
        splats, ms = np.array(self._seen, float).T
        middle = np.exp(np.log(splats).mean())
        x, y = splats / middle - 1, ms / np.median(ms) - 1
        # Regression towards the prior: where splats hardly changed, noise says nothing of what they cost.
        share = np.clip((x @ y + PRIOR_WEIGHT * PRIOR_SHARE) / (x @ x + PRIOR_WEIGHT), 0.0, 1.0)
        level = float(np.median((ms / (1 + share * x))[-MIDDLE_OF:]))
        return level * (1 - share), level * share / middle


@dataclass
class Pacer:
    """Chooses for one scene, at one size, on one device, so that pictures take a given time."""

    once: Line = field(default_factory=Line)  # what a picture takes before its first sample and after its last
    each: Line = field(default_factory=Line)  # what a sample takes
    after: float = 0.0  # ms that the latest picture took after its samples
    _last: tuple[float, float] | None = None  # tolerance and splats of the latest picture
    _cuts: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=CUTS))  # of the latest ones

    def measured(self, tolerance: float, splats: float, once: float, each: float, after: float = 0.0) -> None:
        """A picture took `once` ms before its first sample, `each` ms for one sample in the mean, and `after` ms after
        the last one."""
        self._last, self.after = (tolerance, max(splats, 1.0)), after
        self._cuts.append(self._last)
        self.once.add(splats, once + after)
        self.each.add(splats, each)

    def choose(self, budget: float, tolerance: float, most: int = MOST_SAMPLES) -> Choice:
        """For `budget` ms; no finer than `tolerance` pixels, no more than `most` samples.

        As many samples as fit at that tolerance; one more where a cut that is up to STRETCH coarser makes room for it.
        Where not even one fits, the tolerance at which it does: splats go with the inverse square of it.
        """
        if self._last is None:
            return Choice(tolerance, most)
        last, splats = self._last
        (p0, p1), (q0, q1) = self.once.fitted(), self.each.fitted()
        here = splats * (last / tolerance) ** 2
        count = int(np.clip((budget - p0 - p1 * here) / max(q0 + q1 * here, 1e-9), 0, most))
        known = self._splats_at(tolerance)
        if p0 + q0 + (p1 + q1) * known > budget:
            count = 0  # not even one sample fits, whatever the latest cut promises
        if count < most:
            samples, coarsest = count + 1, STRETCH if count else COARSEST
            room = (budget - p0 - samples * q0) / max(p1 + samples * q1, 1e-12)
            wanted = np.clip(room, splats / MOST_STEP, splats * MOST_MORE)
            at = last * float(np.sqrt(splats / wanted)) if count else self._tolerance_of(float(wanted))
            at = max(at, tolerance)
            if at <= coarsest * tolerance or not count:
                found = self._steady(min(at, COARSEST * tolerance), budget, samples)
                return Choice(found, samples, not count and found > tolerance)
        return Choice(max(tolerance, last / MOST_MORE**0.5), count)

    def _curve(self) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of tolerances, rising, and of splats, falling: the latest cut, and those that lie so far from the
        inverse square that not the view has changed: meshes take triangles where they are near, and nodes not at all.
        """
        assert self._last is not None
        known, (last, splats) = dict(self._cuts), self._last  # of each tolerance the latest
        finer = sorted((t for t in known if t < last), reverse=True)
        coarser = sorted(t for t in known if t > last)
        found = [(last, splats)]
        for side, sign in ((finer, 1), (coarser, -1)):
            end = splats
            for t in side:
                other = known[t] / (splats * (last / t) ** 2)
                if sign * (known[t] - end) > 0 and not 1 / UNLIKE < other < UNLIKE:
                    end = known[t]
                    found.append((t, end))
        tolerances, cuts = np.log(sorted(found)).T
        return tolerances, cuts

    def _splats_at(self, tolerance: float) -> float:
        """Of a cut: between those that are known, of which the scene decides; beyond, by the inverse square."""
        x, y = self._curve()
        at = np.log(tolerance)
        beyond = 2 * (max(x[0] - at, 0.0) - max(at - x[-1], 0.0))
        return float(np.exp(np.interp(at, x, y) + beyond))

    def _tolerance_of(self, splats: float) -> float:
        """The reverse."""
        x, y = self._curve()
        at = np.log(splats)
        beyond = 0.5 * (max(y[-1] - at, 0.0) - max(at - y[0], 0.0))
        return float(np.exp(np.interp(at, y[::-1], x[::-1]) + beyond))

    def _steady(self, tolerance: float, budget: float, samples: int) -> float:
        """The latest tolerance where that is predicted to do as well."""
        assert self._last is not None
        last, splats = self._last
        (p0, p1), (q0, q1) = self.once.fitted(), self.each.fitted()
        predicted = p0 + p1 * splats + samples * (q0 + q1 * splats)
        return last if abs(predicted - budget) < CLOSE * budget else tolerance


class Pacers:
    """A pacer for each of the scenes that a device has drawn lately."""

    def __init__(self) -> None:
        self._known: OrderedDict[tuple, Pacer] = OrderedDict()

    def of(self, scene: Scene, request: Request) -> Pacer:
        """Of a scene with the same objects, at the same size and by the same technique: what moves keeps its own."""
        names = frozenset(geometry.name for geometry in scene.geometries)
        key = (names, request.camera.window[2:], request.settings.technique, request.interactive)
        self._known[key] = pacer = self._known.pop(key, None) or Pacer()
        while len(self._known) > SCENES:
            self._known.popitem(last=False)
        return pacer


def checkpoint(samples: int) -> bool:
    """Whether a picture is looked at after so many: 1, 3, 5, 9, 17 ..., one and pairs that face each other."""
    return samples == 1 or (samples > 2 and not (samples - 1) & (samples - 2))


class Errors:
    """How far the mean of all samples lies from that of very many, by how far it moved since half of them.

    Where samples have the variance v, the means of all n and of the first m differ by v (1 / m - 1 / n), and the
    former lies v / n from the limit: that is m / (n - m) of the difference. Samples that are spread evenly do better
    (EVENLY), but on edges, which are what is left, not by much.
    """

    def __init__(self) -> None:
        self._means: list[tuple[int, np.ndarray]] = []  # of the last three checkpoints
        self._squares: np.ndarray | None = None  # (H, W) float64: error of each pixel, squared
        self._counted: np.ndarray | int = 0
        self._unseen: np.ndarray = np.zeros((1, 1))

    def look(self, frame: Frame) -> bool:
        """After a sample; True where there is a new estimate."""
        n = frame.done
        if not checkpoint(n) and not frame.complete:
            return False
        mean = frame.mean()
        earlier = [(m, picture) for m, picture in self._means if m <= MOST_OF_ALL * n]
        if earlier:
            m, before = earlier[-1]
            counts = frame.counts()
            fresh = np.broadcast_to(np.asarray(counts) > self._counted, (*mean.shape[:2], 1))[..., 0]
            squares = ((mean - before)[..., :3].astype(np.float64) ** 2).mean(axis=-1) * (m / (n - m))
            self._squares = squares if self._squares is None else np.where(fresh, squares, self._squares)
            self._counted, self._unseen = counts, unseen(mean, counts, frame.in_focus())
        if checkpoint(n):
            self._means = [*self._means[-2:], (n, mean)]
        return bool(earlier)

    @property
    def squares(self) -> np.ndarray:
        """(H, W) float64: error of each pixel, squared; infinite where nothing is known yet."""
        if self._squares is None:
            return np.full((1, 1), np.inf)
        return np.maximum(EVENLY**2 * np.nan_to_num(self._squares), self._unseen)

    @property
    def rmse(self) -> float:
        """Root mean square over pixels and colours, scene-linear; infinite where nothing is known yet."""
        return float(np.sqrt(self.squares.mean()))


def unseen(mean: np.ndarray, samples: np.ndarray | int, in_focus: np.ndarray | None = None) -> np.ndarray:
    """(H, W) squared error of what no sample has met in pixels of a picture (H, W, 3 or more) that had so many each.

    An edge beside a pixel may reach into its filter where none of its samples lies. What it covers of it then was
    measured for edges in all directions: MOST_UNSEEN at first, later UNSEEN / n. `in_focus` (H, W, 1): the share of
    each pixel that samples decide at all, None: all; blurred edges are gathered, and none of them is missed.
    """
    # Steps, not slopes: what changes evenly has no second difference.
    steps = np.zeros(mean.shape[:2])
    for axis in (0, 1):
        bent = (np.diff(np.nan_to_num(mean[..., :3]).astype(np.float64), n=2, axis=axis) ** 2).mean(axis=-1)
        steps = np.maximum(steps, np.pad(bent, [(1, 1) if a == axis else (0, 0) for a in (0, 1)])[: len(steps)])
    n = np.broadcast_to(np.asarray(samples, np.float64), (*mean.shape[:2], 1))[..., 0]
    share = np.minimum(MOST_UNSEEN, UNSEEN / n)
    if in_focus is not None:
        sharp = np.pad(in_focus[..., 0], 1)
        for axis in (0, 1):  # an edge is of what lies on either side of it
            sharp = np.lib.stride_tricks.sliding_window_view(sharp, 3, axis).max(axis=-1)
        share = share * np.minimum(sharp, 1.0)
    return steps * share**2


class Watch:
    """Asked after each sample of a picture whether there are enough."""

    def __init__(self, clock: Clock) -> None:
        self.errors, self._clock = Errors(), clock
        self._began = self._ready = self._latest = clock()
        self.prepared = 0.0  # ms before the first sample
        self.each = 0.0  # ms of a sample, in the mean
        self.after = 0.0  # ms after the last sample
        self.splats = 0.0  # and what costs as much as so many
        self.done = 0
        self._measure = True

    def ready(self, frame: Frame) -> None:
        """The picture is prepared."""
        self._ready = self._clock()
        self.prepared = 1000 * (self._ready - self._began)
        self.splats = frame.shot.work(frame.renderer.costs)

    def enough(self, frame: Frame) -> bool:
        """Whether the picture needs no more samples."""
        if self._measure:
            self.errors.look(frame)
        self.done = frame.done
        self._latest = self._clock()
        self.each = 1000 * (self._latest - self._ready) / frame.done
        return self.stops()

    def finished(self) -> None:
        """The picture is there."""
        self.after = 1000 * (self._clock() - self._latest)

    def stops(self) -> bool:
        raise NotImplementedError


class InTime(Watch):
    """Until the next sample would end later than it may, by more than half of it."""

    def __init__(self, milliseconds: float, after: float, clock: Clock, measure: bool = True) -> None:
        """`after`: of the milliseconds, those that what follows the samples is taken to need. `measure`: the error
        too, which takes reading the picture back."""
        super().__init__(clock)
        self._milliseconds, self._measure = milliseconds - after, measure

    def stops(self) -> bool:
        return self.prepared + self.each * (self.done + 0.5) > self._milliseconds


class BelowError(Watch):
    """Until the error is small enough, or the cut proves too coarse for that: then after EARLY samples."""

    def __init__(self, limit: float, finer: Callable[[Frame], tuple[float, np.ndarray]], clock: Clock) -> None:
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
            self.cut_error = LEFT.get(ratio, 1.0) * distance(mean, frame.mean())
            self.too_coarse = ratio > 1 and self.cut_error > CUT_PART * self._limit
        found = super().enough(frame)
        if checkpoint(frame.done) and not found:
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


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square difference of two pictures (H, W, 3 or more) over pixels and colours."""
    return float(np.sqrt(np.nan_to_num((a - b)[..., :3].astype(np.float64) ** 2).mean()))


def kept(
    renderer: Renderer,
    scene: Scene,
    request: Request,
    progress: Progress,
    cancelled: Callable[[], bool],
    clock: Clock = time.perf_counter,
) -> Result:
    """A picture within its budget. Its report tells the "estimate": the error "rmse" and the "seconds" that it took."""
    began = clock()
    keep = in_time if request.settings.budget == "TIME" else below_error
    result, rmse = keep(renderer, scene, request, progress, cancelled, clock)
    if not result.report:
        return result
    seconds = clock() - began
    estimate = {"rmse": rmse if np.isfinite(rmse) else None, "seconds": seconds}
    return replace(result, report={**result.report, "seconds": seconds, "estimate": estimate})


def in_time(
    renderer: Renderer,
    scene: Scene,
    request: Request,
    progress: Progress,
    cancelled: Callable[[], bool],
    clock: Clock,
) -> tuple[Result, float]:
    """A picture that takes as long as it may, and its error by samples; that of its cut would take more time."""
    settings, pacer = request.settings, renderer.pacers.of(scene, request)
    choice = pacer.choose(settings.time_budget, settings.tolerance)
    watch = InTime(settings.time_budget, pacer.after, clock)
    result = renderer.draw(scene, _chosen(request, choice, MOST_SAMPLES), progress, cancelled, watch)
    if watch.done:
        pacer.measured(choice.tolerance, watch.splats, watch.prepared, watch.each, watch.after)
    return result, watch.errors.rmse


def _chosen(request: Request, choice: Choice, most: int) -> Request:
    """With room for half as many samples more, where a picture turns out faster than those before: InTime ends it."""
    settings = replace(request.settings, tolerance=choice.tolerance)
    samples = min(choice.samples + -(-choice.samples // 2), most)
    return replace(request, settings=settings, samples=samples, coarse=choice.coarse)


def below_error(
    renderer: Renderer,
    scene: Scene,
    request: Request,
    progress: Progress,
    cancelled: Callable[[], bool],
    clock: Clock,
) -> tuple[Result, float]:
    """A picture whose error is at most what it may be, as far as MOST_SAMPLES and FINEST reach, and that error.

    After EARLY samples as many of a finer cut tell what the tolerance does. Where that is too much, the finer one is
    drawn instead; what it was sampled with is kept. So it is where all samples together leave too much, and the cut has
    a part in it.
    """
    settings = request.settings
    tolerance = settings.tolerance

    def at(value: float) -> Request:
        """What is out of focus is cut as much finer as what is in it."""
        asked = replace(settings, tolerance=value, adaptive_threshold=_threshold(settings))
        node = request.node * value / settings.tolerance
        return replace(request, settings=asked, samples=MOST_SAMPLES, node=node)

    def finer(frame: Frame) -> tuple[float, np.ndarray]:
        """Finer samples of a mesh that are there already serve coarser cuts too: the first cut that differs."""
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
    """Of adaptive sampling: tiles must not end before their error is well below the budget."""
    return min(settings.adaptive_threshold, TILES_PART * settings.error_budget)


class Moving:
    """The pictures of a viewport while its view moves, each as good as there is time for."""

    def __init__(self, renderer: Renderer, scene: Scene, request: Request, clock: Clock = time.perf_counter) -> None:
        """`request` has the tolerance and the samples of a picture that stands still."""
        settings = request.settings
        self._pacer, self._device = renderer.pacers.of(scene, request), renderer.device
        choice = self._pacer.choose(settings.time_budget, settings.tolerance, request.samples)
        self.request = _chosen(request, choice, request.samples)
        self._watch = InTime(settings.time_budget, self._pacer.after, clock, measure=False)

    def sample(self, frame: Frame) -> bool:
        """Draw all samples at once; False: there are no more."""
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
    """A picture of a viewport that stands still, until its error by samples is small enough; its cut is what it is."""

    def __init__(self, request: Request, clock: Clock = time.perf_counter) -> None:
        settings = request.settings
        asked = replace(settings, adaptive_threshold=_threshold(settings))
        self.request = replace(request, settings=asked, samples=MOST_SAMPLES)
        self._watch = BelowError(settings.error_budget, lambda frame: (1.0, frame.mean()), clock)

    def sample(self, frame: Frame) -> bool:
        """Draw one sample; False when there were enough."""
        if frame.complete:
            return False
        frame.sample()
        if self._watch.enough(frame):
            frame.end()
        return not frame.complete


def _wait(device: Device) -> None:
    """Until the device has done what it was told: reading waits for that on every device."""
    texel = device.texture((1, 1), "R32F", np.zeros(1, np.float32))
    device.read(texel)
    texel.release()
