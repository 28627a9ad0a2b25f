"""The bytes of an E57 file (ASTM E2807): pages of 1,024 bytes, of which the last four are a checksum of the others."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ..reader import PointFileError

PAGE, PAYLOAD = 1024, 1020  # bytes
WINDOW = 4096  # pages that are checked at once
POLYNOMIAL = 0x82F63B78  # of CRC-32C (Castagnoli et al. 1993), reversed
HEADER = struct.Struct("<8sIIQQQQ")


def _table() -> np.ndarray:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(POLYNOMIAL), table >> 1)
    return table


TABLE = _table()


def checksums(pages: np.ndarray) -> np.ndarray:
    """Returns the CRC-32C (N,) uint32 of rows of bytes (N, B) uint8."""
    found = np.full(len(pages), 0xFFFFFFFF, np.uint32)
    for column in np.ascontiguousarray(pages.T):
        found = TABLE[(found ^ column) & 0xFF] ^ (found >> 8)
    return ~found


class Pages:
    """A file whose checksums are taken out, and compared where they are read."""

    def __init__(self, path: Path) -> None:
        """Raises PointFileError where the file has no header of E57, or is shorter than that says."""
        self._path, size = path, path.stat().st_size
        with path.open("rb") as file:
            head = file.read(HEADER.size)
        if len(head) < HEADER.size or head[:8] != b"ASTM-E57":
            raise PointFileError(path, "is no E57 file, for it does not begin with ASTM-E57")
        _, _, _, length, xml, xml_length, page = HEADER.unpack(head)
        if page != PAGE or length > size or length < PAGE or xml >= length or xml_length > length - xml:
            raise PointFileError(path, f"is {size:,} bytes long, where its header says {length:,} with text at {xml:,}")
        self._pages = int(length) // PAGE
        self._first = self._end = 0  # pages of the window
        self._window = np.empty(0, np.uint8)
        self.xml_place, self.xml_length = self.logical(xml), int(xml_length)

    @property
    def size(self) -> int:
        """Bytes without checksums."""
        return self._pages * PAYLOAD

    def logical(self, physical: int) -> int:
        """A place in the file as one among the bytes without checksums."""
        return int(physical) // PAGE * PAYLOAD + min(int(physical) % PAGE, PAYLOAD)

    def read(self, place: int, count: int) -> bytes:
        """Returns bytes. Raises PointFileError beyond the end, and where a checksum is wrong."""
        if not 0 <= place <= place + count <= self.size:
            raise PointFileError(self._path, f"ends before byte {place + count:,} of {self.size:,}")
        if place + count > PAYLOAD * WINDOW + place // PAYLOAD * PAYLOAD:
            half = PAYLOAD * (WINDOW // 2)
            return b"".join(self.read(place + i, min(half, count - i)) for i in range(0, count, half))
        if not self._first * PAYLOAD <= place or not place + count <= self._end * PAYLOAD:
            self._look_at(place // PAYLOAD)
        start = place - self._first * PAYLOAD
        return self._window[start : start + count].tobytes()

    def _look_at(self, page: int) -> None:
        # Read, not mapped: where a file shrinks, mapped memory ends the process.
        wanted = min(WINDOW, self._pages - page) * PAGE
        pages = np.fromfile(self._path, np.uint8, wanted, offset=page * PAGE)
        if len(pages) < wanted:
            raise PointFileError(self._path, f"ends at byte {page * PAGE + len(pages):,}, before its pages do")
        pages = pages.reshape(-1, PAGE)
        stored = pages[:, PAYLOAD:].copy().view(">u4")[:, 0]
        wrong = np.flatnonzero(stored != checksums(pages[:, :PAYLOAD]))
        if len(wrong):
            raise PointFileError(self._path, f"is damaged at byte {(page + int(wrong[0])) * PAGE:,}: a wrong checksum")
        self._first, self._end = page, page + len(pages)
        self._window = pages[:, :PAYLOAD].reshape(-1)

    def close(self) -> None:
        self._window = np.empty(0, np.uint8)
