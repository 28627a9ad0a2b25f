"""Cleaned strands with levels of detail: each level leaves out every other of the inner points that are left."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..numeric.record import record, value_record
from ..numeric.segments import owners, ranks, starts

BLOCK = 64  # consecutive strands, of which each sample draws its share
GOLDEN = (5**0.5 - 1) / 2
BELOW_ONE = 1 - 2.0**-24  # the largest float32
VISIBLE_CHANGE = 1 / 64  # largest change of colours and surface values that leaving out points may cause


@record
class StrandLevels:
    """Strands that can be drawn: all points are finite, consecutive ones differ, and every strand has at least two
    points and a radius. P points in S strands, one after another."""

    origin: np.ndarray  # (3,) float64
    position: np.ndarray  # (P, 3) float32
    radius: np.ndarray  # (P,) float32, at least 0
    start: np.ndarray  # (S + 1,) int64
    tangent: np.ndarray  # (P, 3) float32, unit
    side: np.ndarray | None  # (P, 3) float32, unit: across a ribbon; None: tubes
    material: np.ndarray  # (S,) int64
    levels: tuple[Level, ...]
    detail: np.ndarray  # (S,) int8: the coarsest level at which attributes change too little to be seen

    def __len__(self) -> int:
        """The number of points, P."""
        return len(self.position)

    @property
    def nbytes(self) -> int:
        arrays = [self.position, self.radius, self.start, self.tangent, self.material, self.detail]
        arrays += [] if self.side is None else [self.side]
        arrays += [a for level in self.levels for a in (level.middle, level.low, level.high, level.first, level.strand)]
        return sum(a.nbytes for a in arrays)

    @cached_property
    def phase(self) -> np.ndarray:
        """(S,) float64 in [0, 1): evenly spread over each BLOCK of strands, in random order within it. A sequence
        with an order, such as multiples of the golden ratio, may be the one in which the strands were laid out: those
        that a sample draws would then lie side by side."""
        count = len(self.start) - 1
        block = np.arange(count) // BLOCK
        rank_key, jitter = np.random.default_rng(count).random((2, count))
        rank = np.empty(count)
        rank[np.lexsort((rank_key, block))] = np.arange(count) - BLOCK * block
        return (rank + jitter) / np.minimum(BLOCK, count - BLOCK * block)

    def instance_phase(self, instance: int) -> np.ndarray:
        """(S,) float32 in [0, 1): the phases of the strands of one instance, its row in Scene.instances."""
        return np.minimum((self.phase + instance * GOLDEN) % 1, BELOW_ONE).astype(np.float32)

    @cached_property
    def strand(self) -> np.ndarray:
        """(P,) int32: the strand of each point."""
        return owners(np.diff(self.start), np.int32)

    @cached_property
    def arc_length(self) -> np.ndarray:
        """(P,) float64: length along all strands before each point, in object units; gaps between strands count 0."""
        step = np.linalg.norm(np.diff(self.position, axis=0, prepend=self.position[:1]), axis=1).astype(np.float64)
        step[self.start[:-1]] = 0
        return np.cumsum(step)

    def ends_near(self, ends: np.ndarray) -> np.ndarray:
        """(K, 2) int64: the first and the last point of the strand of each segment (K, 2) that is within a radius of
        it, where its tube may extend beyond the end of the strand; else -1. Closed strands have no ends."""
        strand = self.strand[ends[:, 0]]
        outer = np.stack([self.start[strand], self.start[strand + 1] - 1], axis=1)
        closed = (self.position[outer[:, 0]] == self.position[outer[:, 1]]).all(axis=1)
        reach = np.maximum(*self.radius[ends.T])[:, None]
        near = (np.abs(self.arc_length[ends] - self.arc_length[outer]) <= reach) & (reach > 0) & ~closed[:, None]
        return np.where(near, outer, -1)

    def sum_over_strands(self, length: np.ndarray) -> np.ndarray:
        """(S,) float32: sums over each strand of values (P - 1,) float32 between consecutive points."""
        if len(self.start) < 2:
            return np.zeros(0, np.float32)
        length = np.append(length, np.float32(0))
        return np.add.reduceat(length, self.start[:-1]) - length[self.start[1:] - 1]

    @cached_property
    def segment_ends(self) -> np.ndarray:
        """(K, 2) int32: the ends of all segments at full detail."""
        first = np.delete(np.arange(len(self), dtype=np.int32), self.start[1:] - 1)
        return np.stack([first, first + 1], axis=1)

    @cached_property
    def bounds(self) -> StrandBounds:
        low, high = self.position.min(axis=0), self.position.max(axis=0)
        middle = 0.5 * (low + high)
        away = np.linalg.norm(self.position - middle, axis=1) + self.radius
        step = np.linalg.norm(np.diff(self.position, axis=0), axis=1)
        widest = np.maximum.reduceat(self.radius, self.start[:-1])
        return StrandBounds(
            self.origin + middle,
            float(away.max()),
            float(self.sum_over_strands(step).max()),
            float(2 * widest.max()),
            float(2 * np.median(widest)),
        )

    @cached_property
    def index_in_strand(self) -> np.ndarray:
        """(P,) int32: index of each point within its strand."""
        return (np.arange(len(self)) - self.start[self.strand]).astype(np.int32)


@value_record
class StrandBounds:
    """The extents of all strands of one geometry, in object units."""

    center: np.ndarray  # (3,) float64, of a ball around all strands
    radius: float  # of that ball
    longest: float  # length of the longest strand
    widest: float  # greatest diameter
    typical: float  # median over strands of the greatest diameter


@record
class Level:
    """The points that one level leaves out of the level before, each between two that stay."""

    middle: np.ndarray  # (N,) int32: points that are left out
    low: np.ndarray  # (N,) int32: the points before them
    high: np.ndarray  # (N,) int32: the points after them
    first: np.ndarray  # (R,) int64: rows of the above where each of R strands begins
    strand: np.ndarray  # (R,) int32: these strands


def halving_levels(start: np.ndarray) -> tuple[Level, ...]:
    """The levels of strands (S,): level k leaves out points whose index in their strand is an odd multiple of 2^k."""
    longest = int(np.diff(start).max(initial=0))
    found, step = [], 1
    while 2 * step <= longest:
        inner = np.maximum((np.diff(start) - 2) // step + 1, 0) // 2  # odd multiples of `step` before the last point
        strand, number = owners(inner, np.int32), ranks(inner)
        middle = start[strand] + step * (2 * number + 1)
        high = np.minimum(middle + step, start[strand + 1] - 1)
        some = np.flatnonzero(inner)
        first = starts(inner)[some]
        middle, low, high = (a.astype(np.int32) for a in (middle, middle - step, high))
        found.append(Level(middle, low, high, first, some.astype(np.int32)))
        step *= 2
    return tuple(level for level in found if len(level.middle))


def coarsest_attribute_level(values: np.ndarray | None, levels: tuple[Level, ...], strands: int) -> np.ndarray:
    """(S,) int8: the coarsest level of each strand at which values (P, C) change by less than VISIBLE_CHANGE."""
    if values is None:
        return np.full(strands, 127, np.int8)
    largest = np.maximum(np.abs(values).max(axis=0, initial=0), 1)
    off, result = np.zeros(strands), np.zeros(strands, np.int8)
    fine = np.ones(strands, bool)
    for number, level in enumerate(levels, 1):
        span = (level.high - level.low)[:, None]
        part = (level.middle - level.low)[:, None] / span
        between = values[level.low] * (1 - part) + values[level.high] * part
        error = (np.abs(values[level.middle] - between) / largest).max(axis=1)
        off[level.strand] += np.maximum.reduceat(error, level.first)
        fine &= off <= VISIBLE_CHANGE
        result[fine] = number
    return result
