"""Reads PTX, Leica's text of gridded scans: each scan has a scanner's pose, and a line for each place of its grid.

A scan begins with ten lines: columns, rows, the scanner's position and axes, and a matrix of row vectors that leads
from the scanner's coordinates to the world's. A line "0 0 0 0.5" is a ray that nothing answered.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ....core.numeric.record import record
from ..reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .rows import TextRows

HEAD = 10  # lines
LONGEST_LINE = 4096  # bytes
BLOCK = 1 << 22  # bytes


@record
class Scan:
    """One scan of a file."""

    start: int  # bytes before its first point
    count: int  # lines
    columns: int  # numbers on a line
    station: np.ndarray  # (3,) float64
    world_from_scanner: np.ndarray  # (4, 4) float64


class PtxReader(FileReader):
    """All scans of a PTX file."""

    def __init__(self, path: Path) -> None:
        self._path, self.warnings = path, []
        self._scans = _scans(path)
        columns = {scan.columns for scan in self._scans}
        attributes = [Attribute("position", np.dtype(np.float64), 3)]
        attributes += [Attribute("intensity", np.dtype(np.float32))] if columns & {4, 7} else []
        attributes += [Attribute("color", np.dtype(np.uint8), 3)] if columns & {6, 7} else []
        several = len(self._scans) > 1
        attributes += [Attribute("station", np.dtype(np.int32))] if several else []
        stations = np.array([scan.station for scan in self._scans]).reshape(-1, 3)
        self.header = Header(
            path,
            f"PTX of {len(self._scans)} scan{'s' if several else ''}",
            sum(scan.count for scan in self._scans),
            tuple(attributes),
            origin=origin_of(None, stations),
            stations=stations,
        )

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        names = {attribute.name for attribute in self.wanted(columns)}
        for number, scan in enumerate(self._scans):
            for rows in TextRows(self._path, scan.start, 0, scan.count, scan.columns).chunks(size):
                answered = ~(rows[:, :3] == 0).all(axis=1)
                rows = rows[answered]
                matrix = scan.world_from_scanner
                found = {"position": rows[:, :3] @ matrix[:3, :3].T + matrix[:3, 3]}
                if "intensity" in names:
                    has = scan.columns in (4, 7)
                    found["intensity"] = rows[:, 3].astype(np.float32) if has else np.zeros(len(rows), np.float32)
                if "color" in names:
                    has = scan.columns in (6, 7)
                    color = rows[:, scan.columns - 3 :] if has else np.zeros((len(rows), 3))
                    found["color"] = np.clip(color, 0, 255).astype(np.uint8)
                if "station" in names:
                    found["station"] = np.full(len(rows), number, np.int32)
                yield found


def _scans(path: Path) -> list[Scan]:
    """Finds all scans. Raises PointFileError where one is not whole."""
    found = []
    size = path.stat().st_size
    with path.open("rb") as file:
        while True:
            where = file.tell()
            lines = [file.readline(LONGEST_LINE) for _ in range(HEAD)]
            if not b"".join(lines).strip():
                break
            try:
                values = [[float(word) for word in line.split()] for line in lines]
                [columns], [rows] = values[:2]
                station, matrix = np.array(values[2]), np.array(values[6:HEAD]).T
            except ValueError:
                raise PointFileError(path, f"has no header of a scan at byte {where:,}") from None
            if station.shape != (3,) or matrix.shape != (4, 4) or not np.isfinite(matrix).all():
                raise PointFileError(path, f"has no pose of a scanner at byte {where:,}")
            start, count = file.tell(), columns * rows
            if not (0 <= 6 * count <= size - start + 1 and count == int(count)):
                raise PointFileError(path, f"promises {columns:g} times {rows:g} points, for which it is too short")
            width = len(file.readline(LONGEST_LINE).split()) if count else 4
            if width not in (3, 4, 6, 7):
                raise PointFileError(path, f"has points of {width} numbers at byte {start:,}, expected 3, 4, 6 or 7")
            found.append(Scan(start, int(count), width, station, matrix))
            file.seek(_after_lines(path, start, int(count)))
    if not found:
        raise PointFileError(path, "has no scan")
    return found


def _after_lines(path: Path, start: int, count: int) -> int:
    """Bytes before the line that follows `count` lines from `start` on."""
    if count == 0:
        return start
    with path.open("rb") as file:
        file.seek(start)
        while data := file.read(BLOCK):
            ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))
            if len(ends) >= count:
                return start + int(ends[count - 1]) + 1
            count, start = count - len(ends), start + len(data)
    if count > 1:  # the last line may lack its newline
        raise PointFileError(path, f"ends {count:,} points before the last one")
    return start
