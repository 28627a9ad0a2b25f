"""Finds what others hide, where that saves more than it costs.

In turns, what is likely to hide most is drawn, and all is tested against the farthest depth in each block of pixels
(Greene et al. 1993; Bittner et al. 2004).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....core.numeric.record import value_record
from ....core.numeric.rectangles import RectangleMaxima
from ....core.numeric.segments import owners, ranks
from ...passes.visibility.farthest import BLOCK_SIDE

FEWEST_TRIANGLES = 1 << 19  # in the picture: fewer are drawn in the time that tests take
LEAST_PROMISE = 0.3  # of all triangles: fewer hidden ones are not worth looking for
MOST_WORK = 0.125  # of all triangles, that are drawn to find what they hide
MOST_SHOWN = 0.99  # of what all show: what is left shows little, but for much work
TURNS = 3
LEFT = 0.5  # of the triangles that are drawn so far: if no more are left that may be hidden, another turn does not pay
MOST_BLOCKS = 1 << 21  # that all boxes together are spread over, to see which may hide much: else blocks are wider


@value_record
class Candidates:
    """What a view may show: boxes, and how much it takes to draw what is in them."""

    low: np.ndarray  # (N, 2) float64 pixels, of a rectangle within the picture
    high: np.ndarray
    nearest: np.ndarray  # (N,) float64
    farthest: np.ndarray
    work: np.ndarray  # (N,) triangles

    @property
    def area(self) -> np.ndarray:
        """(N,) square pixels."""
        return (self.high - self.low).prod(axis=1)


def hidden_of(
    given: Candidates, size: tuple[int, int], draw: Callable[[np.ndarray], np.ndarray], most: float = np.inf
) -> np.ndarray:
    """Returns which candidates are known to be hidden, (N,) bool.

    `size`: (width, height) of the picture in pixels. `draw`: draws some of them, (N,) bool, beside those that it has
    drawn before, and returns the farthest depth of each block of pixels, (rows, columns). `most`: triangles that are
    drawn.
    """
    total = given.work.sum()
    most = min(most, MOST_WORK * total)
    drawn, hidden = np.zeros(len(given.work), bool), np.zeros(len(given.work), bool)
    if total < FEWEST_TRIANGLES:
        return hidden
    for _ in range(TURNS):
        left = ~(drawn | hidden)
        depths, shows, side = as_if_full(given, left, size)
        if not drawn.any() and given.work[left & is_behind(given, depths, side)].sum() < LEAST_PROMISE * total:
            break
        more = worth_drawing(shows, given.work, most - given.work[drawn].sum())
        if not more.any():
            break
        drawn |= more
        hidden |= is_behind(given, draw(more))
        if given.work[~(drawn | hidden)].sum() < LEFT * given.work[drawn].sum():
            break
    return hidden


def worth_drawing(shows: np.ndarray, work: np.ndarray, most: float) -> np.ndarray:
    """Returns those candidates, (N,) bool, that show most for their work: most of what all show; none if that takes
    more than `most` work.

    shows: (N,), how much each of them may show. work: (N,).
    """
    order = np.argsort(-shows / np.maximum(work, 1.0), kind="stable")
    before = np.cumsum(shows[order]) - shows[order]
    found = np.zeros(len(shows), bool)
    found[order[(before < MOST_SHOWN * shows.sum()) & (shows[order] > 0)]] = True
    return found if work[found].sum() <= most else np.zeros_like(found)


def is_behind(given: Candidates, depths: np.ndarray, side: int = BLOCK_SIDE) -> np.ndarray:
    """Returns which candidates lie behind all that is in the blocks over which they lie, (N,) bool.

    depths: (rows, columns), the farthest of each block of `side` pixels.
    """
    end = np.array(depths.shape[::-1])
    low = np.minimum(np.floor(given.low / side).astype(np.int64), end - 1)
    high = np.minimum(np.ceil(given.high / side).astype(np.int64), end)
    return given.nearest > RectangleMaxima(depths)(low, np.maximum(high, low + 1))


def as_if_full(given: Candidates, which: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, int]:
    """Returns what would be if boxes were full, some of them, (N,) bool: depths of blocks of pixels, which hide more
    than what is in the boxes may; in how many blocks each box would be the one that is seen, (N,); and how many pixels
    a block is wide.

    `size`: (width, height) of the picture in pixels.
    """
    side = BLOCK_SIDE
    while given.area[which].sum() > MOST_BLOCKS * side**2 and side < max(size):
        side *= 2
    columns, rows = (-(-length // side) for length in size)
    depths = np.full(rows * columns, np.inf)
    low, high = (np.rint(corner[which] / side).astype(np.int64) for corner in (given.low, given.high))
    width, height = (np.minimum(high, [columns, rows]) - low).clip(0).T
    # Rows of all rectangles, then their blocks.
    box, row = owners(height), ranks(height)
    at, column = owners(width[box]), ranks(width[box])
    block, box = (low[box, 1] + row)[at] * columns + low[box[at], 0] + column, box[at]
    farthest = given.farthest[which]
    np.minimum.at(depths, block, farthest[box])
    seen = np.zeros(len(which), np.int64)
    seen[which] = np.bincount(box[farthest[box] == depths[block]], minlength=len(farthest))
    return depths.reshape(rows, columns), seen, side
