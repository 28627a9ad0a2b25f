"""Chooses samples and tolerance so that pictures take a given time (docs/notes/budgets.md).

The time of a picture is modelled as t(n, s) = p(s) + n q(s), with p what comes once and q what each of n samples takes,
both linear in the splats s of the cut; both are fitted to the latest pictures of the scene.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field

import numpy as np

from ...core.numeric.record import value_record
from ...core.scene.scene import Scene
from ..plan.request import Request

MOST_SAMPLES = 257  # of a picture with a budget: what more of them change cannot be seen
COARSEST = 16.0  # times the tolerance that the settings ask for: TIME goes no further
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


@value_record
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
        """Returns (constant in ms, slope in ms per splat); (0, 0) where nothing was measured."""
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
        """Records a picture that took `once` ms before its first sample, `each` ms for one sample in the mean, and
        `after` ms after the last one."""
        self._last, self.after = (tolerance, max(splats, 1.0)), after
        self._cuts.append(self._last)
        self.once.add(splats, once + after)
        self.each.add(splats, each)

    def choose(self, budget: float, tolerance: float, most: int = MOST_SAMPLES) -> Choice:
        """Chooses for `budget` ms; no finer than `tolerance` pixels, no more than `most` samples.

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
        """Returns the logarithms of tolerances, rising, and of their numbers of splats, falling.

        They are those of the latest cut, and of earlier ones whose numbers differ so much from the inverse square that
        the view alone cannot explain it: near meshes become triangles, and nodes are not used there at all.
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
        """Returns how many splats a cut at a tolerance has: interpolated between known cuts; beyond, by the inverse
        square."""
        x, y = self._curve()
        at = np.log(tolerance)
        beyond = 2 * (max(x[0] - at, 0.0) - max(at - x[-1], 0.0))
        return float(np.exp(np.interp(at, x, y) + beyond))

    def _tolerance_of(self, splats: float) -> float:
        """Returns the tolerance of a cut with so many splats: the inverse of `_splats_at`."""
        x, y = self._curve()
        at = np.log(splats)
        beyond = 0.5 * (max(y[-1] - at, 0.0) - max(at - y[0], 0.0))
        return float(np.exp(np.interp(at, y[::-1], x[::-1]) + beyond))

    def _steady(self, tolerance: float, budget: float, samples: int) -> float:
        """Returns the latest tolerance where that is predicted to take about the budget, else `tolerance`."""
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
        """Returns the pacer of scenes with the same objects, at the same size and by the same technique: a scene whose
        objects move keeps its pacer."""
        names = frozenset(geometry.name for geometry in scene.geometries)
        key = (names, request.camera.window[2:], request.settings.technique, request.interactive)
        self._known[key] = pacer = self._known.pop(key, None) or Pacer()
        while len(self._known) > SCENES:
            self._known.popitem(last=False)
        return pacer
