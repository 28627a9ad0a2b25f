"""What a build reads: the files, and what their headers say."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ....core.numeric.record import value_record
from ...points.opening import FOLDERS, open_points
from ...points.reader import PointFileError, Reader

BATCH = 1 << 20  # points that are sorted together, and read by one task
MOST_FILES = 1 << 10  # of one task
ATTRIBUTES = {"intensity": "<u2", "classification": "u1"}  # that hierarchies can keep beside colour and normals
PARTS = 1_000_000  # points of a task that reads a part of a file: whole chunks of LAZ


@value_record
class Input:
    """A file, as its header and the file system describe it."""

    path: str
    size: int  # bytes
    modified: int  # nanoseconds
    count: int  # points, as far as its header knows
    bounds: tuple[float, ...] | None  # low and high corner
    crs: str
    color: bool
    attributes: tuple[str, ...]  # of ATTRIBUTES
    divisible: bool  # parts of it can be read

    def has_changed(self) -> bool:
        """Tells whether the file is another than it was."""
        try:
            stat = Path(self.path).stat()
        except OSError:
            return True
        return (stat.st_size, stat.st_mtime_ns) != (self.size, self.modified)


@value_record
class Part:
    """Points of a file."""

    file: int
    first: int = 0
    count: int | None = None  # None: all


def open_single(path: str, threads: bool) -> Reader:
    """Opens a file of points. `threads`: LAZ is decoded on all processors."""
    if Path(path).suffix.lower() in (".las", ".laz"):
        from ...points.lidar.las import LasReader

        return LasReader(Path(path), threads)
    return open_points(Path(path))


def input_of(path: Path) -> Input:
    """Raises PointFileError and OSError."""
    path = path.resolve()
    if path.is_dir():
        path = next((path / name for name in FOLDERS if (path / name).exists()), path)
    with open_single(str(path), False) as reader:
        header = reader.header
        stat = path.stat()
        box = header.bounds
        known = box is not None and bool(np.isfinite(box).all() and (box[0] <= box[1]).all() and np.any(box))
        return Input(
            str(path), stat.st_size, stat.st_mtime_ns, header.count,
            tuple(np.asarray(box).ravel().tolist()) if known else None,
            header.crs, "color" in header.names, tuple(name for name in ATTRIBUTES if name in header.names),
            hasattr(reader, "part"),
        )  # fmt: skip


def inputs_of(paths: Sequence[Path], progress: Callable[[str, float], None]) -> list[Input]:
    """What is known of all files before points are read. Raises PointFileError and OSError."""
    found = []
    for i, path in enumerate(paths):
        if i % 256 == 0:
            progress("Headers", i / len(paths))
        found.append(input_of(path))
    return found


def warnings_of(inputs: Sequence[Input]) -> list[str]:
    """What is odd about the files together: reference systems that differ, and files that come twice."""
    found = []
    systems: dict[str, list[str]] = {}
    for one in inputs:
        systems.setdefault(one.crs, []).append(Path(one.path).name)
    if len(systems) > 1:
        said = "; ".join(
            f"{_short(crs)}: {', '.join(names[:3])}{f' and {len(names) - 3:,} more' if len(names) > 3 else ''}"
            for crs, names in systems.items()
        )
        found.append(f"Files have different coordinate reference systems, and are put together as they are ({said})")
    return found


def _short(crs: str) -> str:
    return crs.split('"')[1] if crs.count('"') > 1 else crs or "none named"


def tasks_of(inputs: Sequence[Input]) -> list[tuple[Part, ...]]:
    """What each task reads: a part of a large file, a file, or several small ones."""
    found: list[tuple[Part, ...]] = []
    small: list[Part] = []
    together = 0
    for number, one in enumerate(inputs):
        if one.count > PARTS or (small and (together + one.count > PARTS or len(small) == MOST_FILES)):
            if small:
                found.append(tuple(small))
            small, together = [], 0
        if one.count <= PARTS:
            small.append(Part(number))
            together += one.count
        elif one.divisible:
            pieces = math.ceil(one.count / PARTS)
            found += [(Part(number, i * PARTS, min(PARTS, one.count - i * PARTS)),) for i in range(pieces)]
        else:
            found.append((Part(number),))
    if small:
        found.append(tuple(small))
    return found


def read_part(one: Input, part: Part, columns: set[str], threads: bool) -> Iterator[dict[str, np.ndarray]]:
    """Yields points of a file. Raises PointFileError where it is damaged or no longer what it was, and OSError."""
    if one.has_changed():
        raise PointFileError(Path(one.path), "has changed since the build began")
    with open_single(one.path, threads) as reader:
        if part.count is None:
            yield from reader.chunks(columns, BATCH)
        else:
            yield from reader.part(part.first, part.count, columns)  # type: ignore[attr-defined]
    if one.has_changed():
        raise PointFileError(Path(one.path), "changed while it was read")
