"""Which chunks of a LAZ file are decoded side by side.

lazrs decodes those that it is given at once by threads of its own. It keeps the interpreter's lock meanwhile, so that
threads of ours would decode no faster, and nothing else runs until it returns: a batch is short.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

MOST_THREADS = 8
BATCH = 4  # chunks a thread: few threads wait for the last one
Chunk = tuple[int, int]  # points and bytes


def batches(chunks: Sequence[Chunk], count: int, length: int, most_bytes: int) -> Iterator[list[Chunk]]:
    """Yields runs of chunks in order, for `count` points of `length` bytes; one run has at most `most_bytes` of them,
    unless it is a single chunk."""
    most = BATCH * min(os.cpu_count() or 1, MOST_THREADS)
    batch: list[Chunk] = []
    held = 0
    for points, size in chunks:
        points = min(points, count)  # the table counts the last chunk as if it were full
        count -= points
        if batch and (len(batch) == most or (held + points) * length > most_bytes):
            yield batch
            batch, held = [], 0
        batch.append((points, size))
        held += points
        if count == 0:
            break
    if batch:
        yield batch


def side_by_side(chunks: Sequence[Chunk], length: int, most_bytes: int) -> bool:
    """Tells whether chunks whose points have `length` bytes are decoded in batches: where there are several, and two
    of the largest have at most `most_bytes`."""
    largest = max((points for points, _ in chunks), default=0) * length
    return (os.cpu_count() or 1) > 1 and len(chunks) > 1 and 2 * largest <= most_bytes
