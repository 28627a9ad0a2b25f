"""The segments of strands that a view draws, and in which samples of a picture each of the thin ones is drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .levels import StrandLevels

ROUND = 2.0  # widths of the raster's line: below it a segment has one shade across
THIN = 1.0  # widths of the raster's line: below it a segment is one


@dataclass(frozen=True, eq=False)
class Segments:
    """What one view draws of the strands of one geometry."""

    ends: np.ndarray  # (K, 2) int32: points of `Strands`
    instance: np.ndarray  # (K,) int32: rows of Scene.instances
    material: np.ndarray  # (K,) int32
    phase: np.ndarray  # (K,) float32 in [0, 1): evenly spread over strands
    share: np.ndarray  # (K, 2) float32: of the raster line's width, at both ends
    strands: int  # that have a segment in the list

    def __len__(self) -> int:
        return len(self.ends)

    def take(self, index: np.ndarray) -> Segments:
        """Some of them."""
        named = {name: getattr(self, name)[index] for name in ("ends", "instance", "material", "phase", "share")}
        return replace(self, **named)

    @cached_property
    def most(self) -> np.ndarray:
        """(K,) float32: the greater share of the two ends."""
        return np.maximum(self.share[:, 0], self.share[:, 1])  # several times as fast as along the short axis

    @cached_property
    def wide(self) -> np.ndarray:
        """(K,) int64: segments that are drawn with their outlines in every sample, and may be seen to be round."""
        return np.flatnonzero(self.most >= ROUND)

    @cached_property
    def narrow(self) -> np.ndarray:
        """(K,) int64: segments that are drawn with their outlines in every sample, and are too narrow for more."""
        return np.flatnonzero((self.most >= THIN) & (self.most < ROUND))

    @cached_property
    def thin(self) -> np.ndarray:
        """(K,) int64: segments that are lines of one pixel in some samples."""
        return np.flatnonzero((self.most < THIN) & (self.most > 0))

    def drawn(self, turn: float) -> np.ndarray:
        """(N,) int64: the thin ones of a sample, whose `turn` is one of `turns`."""
        index = self.thin
        if len(index) == 0:
            return index
        phase = (self.phase[index] + np.float32(turn)) % np.float32(1)
        return index[phase < self.most[index]]


def sample_offsets(count: int) -> np.ndarray:
    """(count,) float64: k / count in an order in which any first ones lie evenly. With frac(phase + turn) < a, a strand
    of share a is drawn in floor or ceil(a count) samples of all, and so in the first half of them."""
    index, inverse = np.arange(count), np.zeros(count)
    base = 0.5
    while index.any():
        inverse += base * (index & 1)
        index >>= 1
        base /= 2
    turn = np.empty(count)
    turn[:] = np.argsort(np.argsort(inverse)) / count
    return turn


def all_segments(strands: StrandLevels, instance: int) -> Segments:
    ends = strands.every
    count = len(ends)
    return Segments(
        ends,
        np.full(count, instance, np.int32),
        strands.material[strands.strand[ends[:, 0]]].astype(np.int32),
        np.zeros(count, np.float32),
        np.full((count, 2), THIN, np.float32),
        len(strands.start) - 1,
    )


def no_segments() -> Segments:
    none = np.zeros(0, np.int32)
    return Segments(np.zeros((0, 2), np.int32), none, none, np.zeros(0, np.float32), np.zeros((0, 2), np.float32), 0)


def concatenate_segments(parts: list[Segments]) -> Segments:
    """The segments of several instances as one list."""
    if len(parts) == 1:
        return parts[0]
    ends, instance, material, phase, share = (
        np.concatenate(arrays)
        for arrays in zip(*((p.ends, p.instance, p.material, p.phase, p.share) for p in parts), strict=True)
    )
    return Segments(ends, instance, material, phase, share, sum(p.strands for p in parts))
