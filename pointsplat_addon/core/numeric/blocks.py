"""Arrays in memory that goes back to the system as soon as nothing refers to them.

What programs free stays with their allocators, which keep it for later: several times what is in use where arrays of
many sizes come and go. A block is mapped by itself. What others have freed, allocators give back when they are asked.
"""

from __future__ import annotations

import contextlib
import ctypes
import mmap
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

SMALLEST = 1 << 16  # bytes: less is not worth a block
ALIGNED = 64  # bytes, at which each array begins
CLEAN_ALL_BUFFERS = 0  # a command of TBB's allocator
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


def give_back() -> None:
    """Has allocators give back to the system what nothing uses, where they can be asked: some milliseconds for a
    hundred megabytes."""
    for trim in _trims():
        trim()


@cache
def _trims() -> tuple[Callable[[], object], ...]:
    """What the program was linked with."""
    if sys.platform != "linux":
        return ()
    program, found = ctypes.CDLL(None), []
    if hasattr(program, "scalable_allocation_command"):  # TBB's
        program.scalable_allocation_command.argtypes = ctypes.c_int, ctypes.c_void_p
        found.append(lambda: program.scalable_allocation_command(CLEAN_ALL_BUFFERS, None))
    if hasattr(program, "malloc_trim"):  # glibc's
        program.malloc_trim.argtypes = (ctypes.c_size_t,)
        found.append(lambda: program.malloc_trim(0))
    return tuple(found)
