"""Reads streamed SOG: sets of several levels of detail, whose tree says which splats of which set are a node's.

One level is read whole (developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.scene.captured import COEFFICIENTS, CapturedSplats
from ..points.reader import PointFileError
from .reader import CHUNK, BlockReader, SplatHeader
from .sog import ImageDecoder, SogSplats, beside, open_sog, read_json

MOST_NODES = 1 << 20


class Range(NamedTuple):
    """Splats of one set."""

    file: int
    first: int
    count: int


class StreamedSplats(BlockReader):
    """One level of a streamed set."""

    def __init__(self, path: Path, decode: ImageDecoder, level: int = 0) -> None:
        super().__init__()
        meta = read_json(path)
        names, levels = meta.get("filenames"), meta.get("lodLevels")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise PointFileError(path, "does not name its files")
        if not isinstance(levels, int) or not 0 <= level < levels:
            raise PointFileError(path, f"has {levels!r:.20} levels of detail, so that there is no level {level}")
        ranges = sorted(_ranges(path, meta.get("tree"), level, len(names)))
        environment = meta.get("environment")
        if isinstance(environment, str) and environment:
            names = [*names, environment]
            ranges.append(Range(len(names) - 1, 0, -1))
        self._path, self._names, self._ranges, self._decode = path, names, ranges, decode
        # Files are described in small files beside large ones: counts and degrees are known before pictures are read.
        described = {r.file: read_json(beside(path, names[r.file])) for r in ranges}
        count = sum(_count(described[r.file]) if r.count < 0 else r.count for r in ranges)
        coefficients = max((_coefficients(one) for one in described.values()), default=0)
        antialiased = any(one.get("antialias") is True for one in described.values())
        title = f"streamed SOG, level {level} of {levels}"
        self.header = SplatHeader(path, title, count, coefficients, antialiased)

    def chunks(self, size: int = CHUNK) -> Iterator[CapturedSplats]:
        self.dropped = self.unturned = 0
        number, reader = -1, None
        for file, first, count in self._ranges:
            if reader is None or file != number:
                reader = open_sog(beside(self._path, self._names[file]), self._decode)
                number = file
            end = reader.header.count if count < 0 else first + count
            if end > reader.header.count:
                what = f"{self._names[file]}, which has {reader.header.count:,} splats"
                raise PointFileError(self._path, f"names splats up to {end:,} of {what}")
            for start in range(first, end, size):
                yield self._whole(reader, start, min(size, end - start))

    def _whole(self, reader: SogSplats, first: int, count: int) -> CapturedSplats:
        """Returns splats of one of the level's sets, with as many coefficients as the whole level has: 0 where the set
        has none."""
        dropped, unturned = reader.dropped, reader.unturned
        found = reader._chunk(first, count)
        self.dropped += reader.dropped - dropped
        self.unturned += reader.unturned - unturned
        wanted = self.header.coefficients
        if reader.header.coefficients < wanted:
            sh = np.zeros((len(found), wanted, 3), np.float32)
            if found.sh is not None:
                sh[:, : found.sh.shape[1]] = found.sh
            found = replace(found, sh=sh)
        return replace(found, antialiased=self.header.antialiased)


def _ranges(path: Path, tree: object, level: int, files: int) -> Iterator[Range]:
    """The splats that nodes have at a level, or at the next coarser one that they have, else the next finer."""
    left, seen = [tree], 0
    while left:
        node = left.pop()
        seen += 1
        if not isinstance(node, dict) or seen > MOST_NODES:
            raise PointFileError(path, "has a tree that cannot be understood")
        children, levels = node.get("children") or [], node.get("lods") or {}
        if not isinstance(children, list) or not isinstance(levels, dict):
            raise PointFileError(path, "has a tree that cannot be understood")
        left += children
        there = {int(key): value for key, value in levels.items() if key.isdigit() and len(key) < 9}
        if not there:
            continue
        nearest = min(there, key=lambda number: (number < level, abs(number - level)))
        entry = there[nearest]
        try:
            found = Range(*(int(entry[key]) for key in ("file", "offset", "count")))
        except (KeyError, TypeError, ValueError, OverflowError):
            raise PointFileError(path, f"has a node whose level {nearest} has no file, offset and count") from None
        if not (0 <= found.file < files and 0 <= found.first < 1 << 40 and 0 <= found.count < 1 << 40):
            raise PointFileError(path, f"has a node whose level {nearest} names file {found.file} of {files}")
        if found.count:
            yield found


def _count(meta: dict) -> int:
    count = meta.get("count")
    return count if isinstance(count, int) and 0 <= count < 1 << 31 else 0


def _coefficients(meta: dict) -> int:
    part = meta.get("shN")
    bands = part.get("bands") if isinstance(part, dict) else 0
    return COEFFICIENTS[bands - 1] if bands in (1, 2, 3) else 0
