"""Reads .ksplat, the format of mkkellogg's viewer: sections of splats, as floats or relative to centres of buckets.

Level 0 has floats throughout; levels 1 and 2 have positions of 16 bits about the centre of a bucket, and halves; level
2 has spherical harmonics of bytes. Each degree's coefficients are those of red, then green, then blue.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.scene.captured import COEFFICIENTS
from ..points.reader import PointFileError
from .reader import BlockReader, Decoded, SplatHeader, coefficients_of

HEADER, SECTION = 4096, 1024  # bytes
MOST_DEGREE = 3
SH_RANGE = 1.5  # of bytes, where the header has none
LEVELS = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))  # positions, scales and rotations, SH


class Section(NamedTuple):
    """Splats that are stored alike."""

    first: int  # of all of the file
    records: np.ndarray
    bucket: np.ndarray  # (n,) of each splat
    centers: np.ndarray  # (B, 3) float32
    step: float  # length of a position's unit
    middle: int  # a position's unit of the bucket's centre
    degree: int


class KsplatFile(BlockReader):
    """The splats of a .ksplat file."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        size = path.stat().st_size
        data = np.memmap(path, np.uint8, "r") if size else np.empty(0, np.uint8)
        head = bytes(data[:HEADER])
        if size < HEADER or head[0] != 0 or head[1] < 1:
            raise PointFileError(path, "is no .ksplat file of version 0.1 or later")
        sections, count = (int(np.frombuffer(head, "<u4", 1, at)[0]) for at in (4, 16))
        self._level = int(np.frombuffer(head, "<u2", 1, 20)[0])
        if self._level >= len(LEVELS):
            raise PointFileError(path, f"has compression level {self._level}, expected 0 to {len(LEVELS) - 1}")
        low, high = np.frombuffer(head, "<f4", 2, 36).tolist()
        self._sh_low, self._sh_high = low or -SH_RANGE, high or SH_RANGE
        at = HEADER + SECTION * sections
        if at > size:
            raise PointFileError(path, f"promises {sections:,} sections and ends after {size:,} bytes")
        self._sections: list[Section] = []
        first = 0
        for number in range(sections):
            found, at = self._section(data, HEADER + SECTION * number, at, first)
            first += len(found.records)
            self._sections.append(found)
        if first != count:
            raise PointFileError(path, f"promises {count:,} splats and has {first:,}")
        degree = max((section.degree for section in self._sections), default=0)
        self.header = SplatHeader(path, f"ksplat, level {self._level}", count, (0, *COEFFICIENTS)[degree])

    def _section(self, data: np.ndarray, head: int, at: int, first: int) -> tuple[Section, int]:
        """A section whose header is at one byte and whose data begin at another; and where they end."""
        words = np.frombuffer(data[head : head + 44], "<u4").tolist()
        count, most, capacity, buckets = words[:4]
        extent = float(np.frombuffer(data[head + 16 : head + 20], "<f4")[0])
        width, degree = words[5] & 0xFFFF, words[10] & 0xFFFF
        middle, full, partial = words[6] or 32767, words[8], words[9]
        if degree > MOST_DEGREE or count > most:
            raise PointFileError(self._path, f"has a section at byte {head:,} that cannot be understood")
        place, real, harmonic = LEVELS[self._level]
        sh = 3 * (0, *COEFFICIENTS)[degree]
        record = np.dtype([("position", place, 3), ("scale", real, 3), ("rotation", real, 4), ("color", "u1", 4),
                           ("sh", harmonic, (sh,))])  # fmt: skip
        start = at + 4 * partial + width * buckets
        end = start + record.itemsize * most
        if end > len(data) or (self._level and buckets and width < 12):
            what = f"promises {most:,} splats in {buckets:,} buckets from byte {at:,} on"
            raise PointFileError(self._path, f"{what}, and ends after {len(data):,} bytes")
        sizes = np.frombuffer(data[at : at + 4 * partial], "<u4").astype(np.int64)
        bucket, centers = np.empty(0, np.intp), np.empty((0, 3), np.float32)
        if self._level:
            held = min(full * capacity, count)
            bucket = np.arange(held) // max(capacity, 1)
            ends = np.cumsum(sizes)
            bucket = np.concatenate([bucket, full + np.searchsorted(ends, np.arange(count - held), side="right")])
            if count and int(bucket[-1]) >= buckets:
                raise PointFileError(self._path, f"has more splats from byte {start:,} on than its buckets hold")
            rows = data[at + 4 * partial : start].reshape(buckets, width)
            centers = np.ascontiguousarray(rows[:, :12]).view("<f4")
        records = data[start : start + record.itemsize * count].view(record)
        return Section(first, records, bucket, centers, extent / 2 / middle, middle, degree), end

    def decode(self, first: int, out: Decoded) -> None:
        end = first + len(out.opacity)
        for section in self._sections:
            low, high = max(first, section.first), min(end, section.first + len(section.records))
            if low < high:
                self._decode(
                    section,
                    slice(low - section.first, high - section.first),
                    out.part(slice(low - first, high - first)),
                )

    def _decode(self, section: Section, rows: slice, out: Decoded) -> None:
        part = section.records[rows]
        out.position[:] = part["position"]
        if self._level:
            np.subtract(out.position, np.float32(section.middle), out=out.position)
            np.multiply(out.position, np.float32(section.step), out=out.position)
            np.add(out.position, section.centers[section.bucket[rows]], out=out.position)
        out.scale[:] = np.where(part["scale"] >= 0, part["scale"], np.nan)
        out.rotation[:] = part["rotation"]
        coefficients_of(part["color"][:, :3] * np.float32(1 / 255), out.base)
        np.multiply(part["color"][:, 3], np.float32(1 / 255), out=out.opacity)
        if out.sh.size:
            out.sh[:] = 0
            values = part["sh"].astype(np.float32)
            if self._level == 2:
                values = self._sh_low + values * np.float32((self._sh_high - self._sh_low) / 255)
            for degree in range(1, section.degree + 1):
                before, after = degree**2 - 1, (degree + 1) ** 2 - 1
                own = values[:, 3 * before : 3 * after].reshape(len(part), 3, -1)
                out.sh[:, before:after] = own.transpose(0, 2, 1)

    def close(self) -> None:
        self._sections = []
