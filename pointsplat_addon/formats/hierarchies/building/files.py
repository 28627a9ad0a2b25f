"""Files of a build's folder, which are there as a whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

COPIED = 1 << 24  # bytes at once


@contextlib.contextmanager
def written(path: Path) -> Iterator[Any]:
    """A file that is there as a whole or not at all. Raises OSError."""
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("wb") as file:
            yield file
        os.replace(unfinished, path)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise


def write_json(path: Path, facts: Any) -> None:
    with written(path) as file:
        file.write(json.dumps(facts).encode())


def write_arrays(path: Path, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
    """Writes arrays, one after the other, behind what is said of them. Raises OSError."""
    table, at = {}, 0
    for name, array in arrays.items():
        table[name] = [array.dtype.descr if array.dtype.names else array.dtype.str, list(array.shape), at]
        at += array.nbytes
    head = json.dumps({**facts, "arrays": table}).encode()
    with written(path) as file:
        file.write(len(head).to_bytes(8, "little") + head)
        for array in arrays.values():
            file.write(np.ascontiguousarray(array).data.cast("B") if array.size else b"")


class Arrays:
    """A file of `write_arrays`, of which ranges of rows are read."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        length = int.from_bytes(self._file.read(8), "little")
        self.facts = json.loads(self._file.read(length))
        self._start = 8 + length

    def _dtype(self, kind: Any) -> np.dtype:
        if isinstance(kind, str):
            return np.dtype(kind)
        return np.dtype([tuple(tuple(part) if isinstance(part, list) else part for part in field) for field in kind])

    def copy(self, name: str, out: Any) -> None:
        """Writes an array's bytes to a file."""
        kind, shape, at = self.facts["arrays"][name]
        left = self._dtype(kind).itemsize * int(np.prod(shape))
        self._file.seek(self._start + at)
        while left and (part := self._file.read(min(left, COPIED))):
            out.write(part)
            left -= len(part)

    def rows(self, name: str, first: int = 0, stop: int | None = None) -> np.ndarray:
        """Rows of an array, from `first` to `stop` (None: its end). Raises OSError where the file is shorter."""
        kind, shape, at = self.facts["arrays"][name]
        dtype, last = self._dtype(kind), shape[0] if stop is None else stop
        row = dtype.itemsize * int(np.prod(shape[1:]))
        found = np.empty((last - first, *shape[1:]), dtype)
        self._file.seek(self._start + at + first * row)
        if found.size and self._file.readinto(found.data.cast("B")) != found.nbytes:
            raise OSError(f"{self._file.name} is shorter than it was")
        return found

    def __enter__(self) -> Arrays:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
