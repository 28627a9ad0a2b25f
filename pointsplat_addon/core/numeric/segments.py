"""Arithmetic on consecutive segments of an array, given by how many elements each segment has.

With counts [2, 0, 3], the starts are [0, 2, 2], the offsets [0, 2, 2, 5], the owners [0, 0, 2, 2, 2] and the ranks
[0, 1, 0, 1, 2].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import DTypeLike

from .vectors import MOST_THREADS, each_block, rows_at_once

PIECE = 1 << 20  # items that are sorted at once
Counts = np.ndarray | Sequence[int]


def starts(count: Counts) -> np.ndarray:
    """(S,) int64: index at which each segment begins (exclusive prefix sums of `count`, (S,) integers)."""
    return offsets(count)[:-1]


def offsets(count: Counts) -> np.ndarray:
    """(S + 1,) int64: index at which each segment begins, then the total of `count` (S,)."""
    result = np.zeros(len(count) + 1, np.int64)
    if len(count):
        np.cumsum(count, out=result[1:])
    return result


def segment_sums(rows: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(R, S): sums of each row (N,) of (R, N) over segments, none of them empty, that begin at `first` (S,)."""
    found = np.empty((len(rows), len(first)), rows.dtype)

    def add(some: slice) -> None:
        np.add.reduceat(rows[some], first, axis=1, out=found[some])

    each_block(len(rows), add, rows_at_once(rows.shape[1]))
    return found


def owners(count: Counts, dtype: DTypeLike = np.int64) -> np.ndarray:
    """(count.sum(),): index of the segment that each element belongs to."""
    return np.repeat(np.arange(len(count), dtype=dtype), count)


def ranks(count: Counts) -> np.ndarray:
    """(count.sum(),) int64: index of each element within its segment."""
    return ranges(np.zeros(len(count), np.int64), count)


def ranges(first: np.ndarray, count: Counts, dtype: DTypeLike = np.int64) -> np.ndarray:
    """(count.sum(),): the integers first[i], ..., first[i] + count[i] - 1 of every segment i, one after the other."""
    index = np.repeat((first - starts(count)).astype(dtype, copy=False), count)
    index += np.arange(len(index), dtype=dtype)
    return index


def sorted_places(code: np.ndarray) -> np.ndarray:
    """(N,) int32 or int64: where each of the codes (N,) uint16 stands when they are sorted, equal ones as they come.

    Several threads find it.
    """
    if len(code) == 0:
        return np.zeros(0, np.int32)
    size = max(PIECE, -(-len(code) // MOST_THREADS))
    pieces = [slice(start, min(start + size, len(code))) for start in range(0, len(code), size)]
    codes = int(code.max()) + 1
    count = np.array([np.bincount(code[piece], minlength=codes) for piece in pieces])
    # Where the items of each piece with each code go: by code, then by piece.
    goes_to = np.empty_like(count)
    goes_to.T.flat = offsets(count.T.reshape(-1))[:-1]
    place = np.empty(len(code), np.int32 if len(code) < 1 << 31 else np.int64)

    def sort(which: slice) -> None:
        for i in range(which.start, which.stop):
            to = np.repeat(goes_to[i] - starts(count[i]), count[i])
            to += np.arange(len(to))
            place[pieces[i]][np.argsort(code[pieces[i]], kind="stable")] = to

    each_block(len(pieces), sort, 1)
    return place


def batches(count: np.ndarray, most: int) -> Iterator[tuple[int, int]]:
    """Yields ranges (a, b) of consecutive segments that hold at most `most` elements together, or one segment."""
    end = np.cumsum(count)
    a = 0
    while a < len(count):
        b = int(np.searchsorted(end, (end[a - 1] if a else 0) + most, side="right"))
        b = max(b, a + 1)
        yield a, b
        a = b
