"""TODO: say what this module is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def starts(count: np.ndarray) -> np.ndarray:
    """Exclusive prefix sums, int64: where each of consecutive segments begins."""
    begin = np.zeros(len(count), np.int64)
    np.cumsum(count[:-1], out=begin[1:])
    return begin


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """The integers first[i] ... first[i] + count[i] - 1 of every i, one after the other, int64."""
    index = np.repeat(first - starts(count), count)
    index += np.arange(len(index))
    return index


def runs(count: np.ndarray, most: int) -> Iterator[tuple[int, int]]:
    """Cut consecutive segments into runs (a, b) that hold at most `most` elements, or one segment."""
    end = np.cumsum(count)
    a = 0
    while a < len(count):
        b = int(np.searchsorted(end, (end[a - 1] if a else 0) + most, side="right"))
        b = max(b, a + 1)
        yield a, b
        a = b
