"""Records of a binary file, which are read and not mapped: where a file shrinks, mapped memory ends the process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .reader import PointFileError


class Records:
    """`count` records from byte `start` of a file on."""

    def __init__(self, path: Path, dtype: np.dtype, start: int, count: int) -> None:
        """Raises PointFileError where the file has no room for them."""
        self._path, self._dtype, self._start, self._count = path, dtype, start, count
        room = max(path.stat().st_size - start, 0)
        if dtype.itemsize * count > room:
            raise self._ended(room // max(dtype.itemsize, 1))

    def chunks(self, size: int) -> Iterator[np.ndarray]:
        """Yields them in order, at most `size` at a time. Raises PointFileError where the file has become shorter."""
        with self._path.open("rb") as file:
            file.seek(self._start)
            for first in range(0, self._count, size):
                wanted = min(size, self._count - first)
                found = np.fromfile(file, self._dtype, wanted)
                if len(found) < wanted:
                    raise self._ended(first + len(found))
                yield found

    def _ended(self, there: int) -> PointFileError:
        return PointFileError(self._path, f"promises {self._count:,} points and ends after {there:,}")
