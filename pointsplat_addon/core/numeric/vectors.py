"""Vectors as columns (3, n), which NumPy handles several times faster than rows (n, 3); work in blocks.

Functions named `..._rows` and `row_...` take rows (..., 3).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

BLOCK = 1 << 15  # items: the float64 scratch of one block stays in the cache
TOGETHER = 64  # rows that are compared as one: NumPy reduces short rows many times more slowly than long ones
MOST_THREADS = 8  # with more, blocks wait for memory
THREADS = min(os.cpu_count() or 1, MOST_THREADS)  # asked for once: the system takes as long as a small mesh


def blocks(count: int) -> Iterator[slice]:
    """Yields slices of at most BLOCK that cover `count` items."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))


def each_block(count: int, work: Callable[[slice], object], block: int = BLOCK) -> None:
    """Calls `work` for `count` items in slices of at most `block`, in several threads where there are many slices.

    NumPy releases the interpreter's lock within its loops. Slices must not depend on one another. Raises what `work`
    raises in the first slice where it does.
    """
    slices = [slice(start, min(start + block, count)) for start in range(0, count, block)]
    threads = min(THREADS, len(slices) // 2)
    if threads < 2:
        for one in slices:
            work(one)
        return
    left, failures = iter(slices), []

    def work_off() -> None:
        for one in left:  # each goes to the thread that asks first
            try:
                work(one)
            except Exception as error:
                failures.append((one.start, error))
                return

    with ThreadPoolExecutor(threads - 1, thread_name_prefix="PointSplat blocks") as pool:
        for _ in range(threads - 1):
            pool.submit(work_off)
        work_off()
    if failures:  # of the first slice that failed, whichever thread had it
        raise min(failures, key=lambda failure: failure[0])[1]


def take_rows(array: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The items `rows` (K,) int of an array (N, ...), (K, ...): several times as fast as indexing."""
    found = np.empty((len(rows), *array.shape[1:]), array.dtype)
    each_block(len(rows), lambda block: np.take(array, rows[block], axis=0, out=found[block]))
    return found


def take_columns(array: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns (K,) int of a matrix (R, N), (R, K)."""
    found, columns = np.empty((len(array), len(columns)), array.dtype), columns.astype(np.intp, copy=False)

    def take(rows: slice) -> None:
        for out, row in zip(found[rows], array[rows], strict=True):
            out[:] = row.take(columns)

    each_block(len(array), take, rows_at_once(len(columns)))
    return found


def rows_at_once(length: int) -> int:
    """How many rows of that length are one block of work."""
    return -(-BLOCK // max(length, 1))


def put_rows(out: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Puts items (K, ...) at places (K,) int of a contiguous array (N, ...) of the same dtype, each whole at once."""
    # Each item as one of that many bytes: NumPy puts the columns of rows one by one.
    item = np.dtype((np.void, out.itemsize * int(np.prod(out.shape[1:]))))
    whole = np.ascontiguousarray(values, out.dtype).reshape(len(values), -1)
    if whole.shape[1] > 1:
        out.reshape(len(out), -1).view(item)[:, 0][places.astype(np.intp)] = whole.view(item)[:, 0]
    else:
        out.reshape(-1)[places.astype(np.intp)] = whole[:, 0]


def moved_rows(array: np.ndarray, places: np.ndarray) -> np.ndarray:
    """An array (N, ...) whose item i is at places[i], (N,) int, each of which is there once.

    It is read from the first item on, and what is written lies in as many places as the processor's cache holds, where
    `places` leads to few runs: two to three times as fast as taking rows in the inverse order.
    """
    found = np.empty(array.shape, array.dtype)
    each_block(len(places), lambda block: put_rows(found, places[block], array[block]))
    return found


def column_ranges(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest value of each column, (C,) each, of rows (N, C), N > 0; NaN where there is any."""
    if len(rows) < 4 * TOGETHER:
        return rows.min(axis=0), rows.max(axis=0)
    columns = rows.shape[1]
    lows: list[np.ndarray] = []
    highs: list[np.ndarray] = []

    def measure(block: slice) -> None:
        part = np.ascontiguousarray(rows[block])
        most = len(part) - len(part) % TOGETHER
        for long in (part[:most].reshape(-1, TOGETHER * columns), part[most:]):
            if len(long):
                lows.append(long.min(axis=0).reshape(-1, columns).min(axis=0))
                highs.append(long.max(axis=0).reshape(-1, columns).max(axis=0))

    each_block(len(rows), measure)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of (3, n) arrays."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Dot product over the first axis, of (2 | 3, n) arrays."""
    result = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        result += x * y
    return result


def lengths(a: np.ndarray) -> np.ndarray:
    """Euclidean lengths (n,) of vectors (3, n); zeros where there are no coordinates, (0, n)."""
    return np.sqrt(dot(a, a)) if len(a) else np.zeros(a.shape[1])


def clip(start: np.ndarray, stop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters in [0, 1] at which segments enter and leave the intersection of half-spaces (Liang and Barsky).

    start, stop (K, ...): signed distances of the segments' ends, positive inside. Segments outside have
    enter > leave.
    """
    span = start - stop
    t = np.divide(start, span, out=np.zeros_like(span), where=span != 0)
    enter = np.where(start < 0, np.where(stop < 0, 2.0, t), 0.0).max(axis=0)
    return enter, np.where(stop < 0, t, 1.0).min(axis=0)


def golden_ratio_sequence(row: np.ndarray) -> np.ndarray:
    """(I,) float64 in [0, 1): multiples of the golden ratio modulo 1 (Weyl 1916), one number for each integer (I,).

    The values of any run of integers are spread evenly: the share of those below a bound is nearly the bound.
    """
    return (np.asarray(row).astype(np.uint32) * np.uint32(0x9E3779B9)) / 2.0**32


def basis(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with the unit vectors n (3, ...) (Duff et al. 2017)."""
    x, y, z = n
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), np.stack([b, sign + y * y * a, -y])


def as_rows(array: np.ndarray, which: slice) -> np.ndarray:
    """Transposes a slice of an array of items (N,), (N, k) or (N, k, l) to columns (1 | k | k l, n)."""
    return array[which].reshape(-1, int(np.prod(array.shape[1:]))).T


def as_columns(rows: np.ndarray) -> np.ndarray:
    """Transposes (k, n) to a contiguous (n, k) float32."""
    return np.ascontiguousarray(rows.T, np.float32)


def row_frames(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two fields of unit vectors perpendicular to unit rows (..., 3) and to each other."""
    helper = np.where(np.abs(axis[..., 2:]) < 0.7, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    u = unit_rows(np.cross(helper, axis))
    return u, np.cross(axis, u)


def unit_rows(v: np.ndarray) -> np.ndarray:
    """Normalises rows (..., 3); zero rows stay zero."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)
