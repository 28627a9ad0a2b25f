"""The segments of strands that a view draws, and in which samples of a picture each of the thin ones is drawn."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..numeric.lattice import Lattice
from ..numeric.record import record
from .levels import StrandLevels

ROUND = 2.0  # pixels, along the axis of the raster across a segment: narrower ones have one shade across
THIN = 1.0  # widths of the raster's line: below it a segment is drawn as that line, in some samples
OWN_WIDTH = -1.0  # in place of a share: the width is that of the strand, which need not be known to choose segments


@record
class Segments:
    """The segments of one geometry's strands that one view draws, K of them."""

    ends: np.ndarray  # (K, 2) int32: points of StrandLevels
    instance: np.ndarray  # (K,) int32: rows of Scene.instances
    material: np.ndarray  # (K,) int32
    phase: np.ndarray  # (K,) float32 in [0, 1): by strand, evenly spread over strands
    share: np.ndarray  # (K, 2) float32: width at both ends over that of the raster's line; or OWN_WIDTH
    strands: int  # number of strands with a segment in the list
    lattice: Lattice | None = None  # of the sub-samples that are drawn at once; None: a sample of each pixel in turn

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def on_lattice(self) -> bool:
        """Whether all sub-samples are drawn at once, of which thin segments cover a share."""
        return self.lattice is not None

    @property
    def _round(self) -> float:
        """The share from which on tubes may be seen to be round."""
        return ROUND if self.lattice is None else ROUND / self.lattice.spacing

    def take(self, index: np.ndarray) -> Segments:
        """The segments at an index array."""
        named = {name: getattr(self, name)[index] for name in ("ends", "instance", "material", "phase", "share")}
        return replace(self, **named)

    @cached_property
    def greatest_share(self) -> np.ndarray:
        """(K,) float32: the greater share of the two ends."""
        return np.maximum(self.share[:, 0], self.share[:, 1])  # several times as fast as along the short axis

    @cached_property
    def wide(self) -> np.ndarray:
        """(n,) int64: segments that are drawn with their outlines in every sample, wide enough to look round."""
        return np.flatnonzero(self.greatest_share >= self._round)

    @cached_property
    def narrow(self) -> np.ndarray:
        """(n,) int64: segments that are drawn with their outlines in every sample, too narrow to look round."""
        return np.flatnonzero(
            ((self.greatest_share >= THIN) | (self.greatest_share < 0)) & (self.greatest_share < self._round)
        )

    @cached_property
    def thin(self) -> np.ndarray:
        """(n,) int64: segments that are drawn as lines of the raster, in some samples."""
        return np.flatnonzero((self.greatest_share < THIN) & (self.greatest_share > 0))

    def drawn(self, turn: float) -> np.ndarray:
        """(n,) int64: the thin segments of a sample, whose offset `turn` is one of `sample_offsets`."""
        index = self.thin
        if len(index) == 0:
            return index
        phase = (self.phase[index] + np.float32(turn)) % np.float32(1)
        return index[phase < self.greatest_share[index]]


def sample_offsets(count: int) -> np.ndarray:
    """(count,) float64: the multiples of 1 / count in an order whose beginnings are evenly spread. With frac(phase +
    offset) < a, a strand of share a is drawn in floor or ceil(a count) samples of all, and likewise in the first
    half."""
    index, inverse = np.arange(count), np.zeros(count)
    base = 0.5
    while index.any():
        inverse += base * (index & 1)
        index >>= 1
        base /= 2
    turn = np.empty(count)
    turn[:] = np.argsort(np.argsort(inverse)) / count
    return turn


def all_segments(strands: StrandLevels, instance: int, lattice: Lattice | None = None) -> Segments:
    """All segments of an instance, drawn with their outlines in every sample; on a lattice, as wide as strands are."""
    ends = strands.segment_ends
    count = len(ends)
    strand = strands.strand[ends[:, 0]]
    phase = np.zeros(count, np.float32) if lattice is None else strands.instance_phase(instance)[strand]
    return Segments(
        ends,
        np.full(count, instance, np.int32),
        strands.material[strand].astype(np.int32),
        phase,
        np.full((count, 2), THIN if lattice is None else OWN_WIDTH, np.float32),
        len(strands.start) - 1,
        lattice,
    )


def no_segments() -> Segments:
    """An empty list of segments."""
    none = np.zeros(0, np.int32)
    return Segments(np.zeros((0, 2), np.int32), none, none, np.zeros(0, np.float32), np.zeros((0, 2), np.float32), 0)


def concatenate_segments(parts: list[Segments]) -> Segments:
    """The segments of several instances in one list, in the order given."""
    if len(parts) == 1:
        return parts[0]
    ends, instance, material, phase, share = (
        np.concatenate(arrays)
        for arrays in zip(*((p.ends, p.instance, p.material, p.phase, p.share) for p in parts), strict=True)
    )
    return Segments(ends, instance, material, phase, share, sum(p.strands for p in parts), parts[0].lattice)
