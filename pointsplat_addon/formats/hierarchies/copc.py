"""COPC files as pages: chunks of LAZ, by the octree in the file's records (copc.io, version 1.0)."""

from __future__ import annotations

import os
import struct
import threading
from pathlib import Path

import numpy as np

from ..points.lidar.las import LasReader
from ..points.reader import Columns, FileReader, PointFileError
from .octree import Octree, PointsOfPages, calibrated, no_elements

INFO = struct.Struct("<5d2Q")  # centre, half the side, spacing of the root; first byte and length of the root's entries
INFO_AT = 375 + 54  # behind the header of LAS 1.4 and that of the first record, which it is
ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("count", "<i4")])
ELSEWHERE = -1  # the number of points of an entry whose hierarchy goes on in entries of its own
MOST_CHUNK = 1 << 30  # bytes of an unpacked chunk


def is_copc(path: Path) -> bool:
    """Whether a file begins as COPC does."""
    with path.open("rb") as file:
        head = file.read(381)
    return head[:4] == b"LASF" and head[377:381] == b"copc"


class CopcPages(FileReader):
    """A COPC file."""

    def __init__(self, path: Path) -> None:
        """Raises PointFileError where the file is damaged, OSError where it cannot be read."""
        self._path = path
        self._file = path.open("rb")
        self._lock = threading.Lock()
        self._root: Columns | None = None
        try:
            self._reader = LasReader(path, threads=False)
        except BaseException:
            self._file.close()
            raise
        self.header, self.warnings = self._reader.header, self._reader.warnings
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        *numbers, first, length = INFO.unpack(self._bytes(INFO_AT, INFO.size))
        if not np.isfinite(numbers).all() or numbers[3] <= 0 or numbers[4] <= 0:
            raise PointFileError(self._path, "has a record of COPC without centre, size and spacing")
        entries = self._entries(first, length)
        size = self._path.stat().st_size
        # Unsigned numbers beyond the file's end must not wrap.
        if (entries["offset"] > size).any() or (entries["offset"].astype(np.int64) + entries["size"] > size).any():
            raise PointFileError(self._path, "has chunks beyond its end")
        if entries["count"].astype(np.int64).sum() > self.header.count:
            raise PointFileError(self._path, "has chunks of more points than its header promises")
        self._chunks = entries
        middle, half, spacing = np.array(numbers[:3]), float(numbers[3]), float(numbers[4])
        octree = Octree(
            entries["key"].astype(np.int64), entries["count"].astype(np.int64), entries["size"].astype(np.int64),
            middle - half, 2 * half, spacing,
        )  # fmt: skip
        try:
            self.directory = octree.directory(self.header)
        except ValueError as error:
            raise PointFileError(self._path, f"has an octree that is none: {error}") from None
        self._order, self._points = octree.order, PointsOfPages(self.header)
        self._root = calibrated(self)

    def _entries(self, first: int, length: int) -> np.ndarray:
        """Entries of all chunks that have points."""
        size, found, pages, seen = self._path.stat().st_size, [], [(first, length)], set()
        while pages:
            at, count = pages.pop()
            if not 0 <= at <= size or not 0 <= count <= size - at or count % ENTRY.itemsize:
                raise PointFileError(self._path, f"has entries of its octree at byte {at:,} of {size:,}")
            if at in seen:
                continue
            seen.add(at)
            entries = np.frombuffer(self._bytes(at, count), ENTRY)
            more = entries["count"] == ELSEWHERE
            pages += zip(entries["offset"][more].tolist(), entries["size"][more].tolist(), strict=True)
            good = entries[~more]
            if (good["count"] < 0).any() or (good["size"] < 0).any():
                raise PointFileError(self._path, "has chunks of less than no points")
            found.append(good[good["count"] > 0])
        return np.concatenate(found)

    def _bytes(self, first: int, count: int) -> bytes:
        """Bytes of the file. Raises PointFileError where it ends before them."""
        if hasattr(os, "pread"):
            found = os.pread(self._file.fileno(), count, first)
        else:
            with self._lock:
                self._file.seek(first)
                found = self._file.read(count)
        if len(found) < count:
            raise PointFileError(self._path, f"ends at byte {first + len(found):,}, before a chunk does")
        return found

    def read(self, page: int) -> Columns:
        """See `PageSource`."""
        root, self._root = self._root, None
        if page == 0 and root is not None:
            return root
        if self._order[page] < 0:
            return no_elements()
        entry = self._chunks[self._order[page]]
        count = int(entry["count"])
        if count * len(self.header.attributes) > MOST_CHUNK:
            raise PointFileError(self._path, f"promises a chunk of {count:,} points")
        points = self._reader.chunk(self._bytes(int(entry["offset"]), int(entry["size"])), count)
        return self._points.elements(points)

    def close(self) -> None:
        """Closes the file."""
        self._file.close()
        self._reader.close()
