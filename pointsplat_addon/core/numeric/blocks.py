"""Arrays in memory that goes back to the system as soon as nothing refers to them.

What programs free stays with their allocators, which keep it for later: several times what is in use where arrays of
many sizes come and go. A block is mapped by itself.
"""

from __future__ import annotations

import contextlib
import mmap
import sys
from collections.abc import Mapping, Sequence

import numpy as np

SMALLEST = 1 << 16  # bytes: less is not worth a block
ALIGNED = 64  # bytes, at which each array begins
_PRIVATE = {} if sys.platform == "win32" else {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS}


def empty_block(shapes: Mapping[str, tuple[tuple[int, ...], np.dtype]]) -> dict[str, np.ndarray]:
    """Returns zeros of several shapes and dtypes, by name, in one block."""
    sizes = [int(np.prod(shape)) * dtype.itemsize for shape, dtype in shapes.values()]
    starts = np.cumsum([0, *(-(-size // ALIGNED) * ALIGNED for size in sizes)]).tolist()
    block = None
    if starts[-1] >= SMALLEST:
        with contextlib.suppress(OSError):  # the system has no more mappings
            block = mmap.mmap(-1, starts[-1], **_PRIVATE)
    if block is None:
        return {name: np.zeros(shape, dtype) for name, (shape, dtype) in shapes.items()}
    return {
        name: np.frombuffer(block, dtype, int(np.prod(shape)), start).reshape(shape)
        for (name, (shape, dtype)), start in zip(shapes.items(), starts, strict=False)
    }


def copied_block(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns copies of arrays, by name, in one block."""
    found = empty_block({name: (array.shape, array.dtype) for name, array in arrays.items()})
    for name, array in arrays.items():
        found[name][...] = array
    return found


def concatenated(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Returns arrays of one dtype one after the other, in a block."""
    shape = sum(map(len, arrays)), *arrays[0].shape[1:]
    found = empty_block({"": (shape, arrays[0].dtype)})[""]
    return np.concatenate(arrays, out=found)
