"""Decodes the chunks of a LAZ file side by side, and hands them on in order.

lazrs lets go of the interpreter's lock while it decodes, and so does NumPy in its loops: threads do what processes
would, without a second copy of the points. Each makes a chunk's columns, too, while they are in its cache.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import BinaryIO, TypeVar

MOST_THREADS = 8
AHEAD = 1  # chunks more than threads that wait to be decoded, or to be taken
Chunk = tuple[int, int]  # points and bytes
Found = TypeVar("Found")


def threads_for(chunks: Sequence[Chunk], length: int, most_bytes: int) -> int:
    """Returns how many threads decode chunks whose points have `length` bytes, for which the largest are held in at
    most `most_bytes`; 0 where even two would hold more."""
    largest = max((points for points, _ in chunks), default=0) * length
    room = most_bytes // max(largest, 1) - AHEAD
    threads = min(os.cpu_count() or 1, MOST_THREADS, len(chunks), room)
    return threads if threads > 1 else 0


def decoded_in_order(
    file: BinaryIO,
    start: int,
    chunks: Sequence[Chunk],
    count: int,
    threads: int,
    decode: Callable[[bytes, int, int], Found],
) -> Iterator[Found]:
    """Yields what `decode` makes of each chunk, in order, for `count` points: of its bytes, its number of points, and
    that of all points before it.

    file: its chunks begin at byte `start`. `decode` is called by several threads at once; what it raises is raised in
    the place of its chunk. Closed before its end, it waits for the chunks at hand, and decodes no more.
    """
    waiting: deque[Future[Found]] = deque()
    entries, before = iter(chunks), 0
    with _cancelled_at_end(ThreadPoolExecutor(threads, thread_name_prefix="PointSplat LAZ")) as pool:
        file.seek(start)
        while True:
            while before < count and len(waiting) < threads + AHEAD and (entry := next(entries, None)) is not None:
                points = min(entry[0], count - before)  # the table counts the last chunk as if it were full
                waiting.append(pool.submit(decode, file.read(entry[1]), points, before))
                before += points
            if not waiting:
                return
            yield waiting.popleft().result()


@contextmanager
def _cancelled_at_end(pool: ThreadPoolExecutor) -> Iterator[ThreadPoolExecutor]:
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
