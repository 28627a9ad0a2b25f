"""Imports captured splats: each file into an object, step by step, so that a window stays alive meanwhile."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import bpy

from ...formats.points.reader import PointFileError
from ...formats.splats.opening import open_splats
from ...formats.splats.reader import SplatReader, messages
from .objects import SplatObject
from .pictures import read_picture

STEP = 1 << 16  # splats between two looks at the window


def import_files(
    context: Any, paths: Sequence[Path], axes: str = "", level: int = 0
) -> Generator[float, None, tuple[list[bpy.types.Object], list[str]]]:
    """Reads each file into a PointCloud object that is linked to the active collection and selected.

    Yields the share that is done; returns the objects, and warnings. Closed before its end, and where a file cannot be
    read, it leaves nothing behind. axes: see formats/splats/axes.py; empty: those of the format. level: of detail.
    Raises PointFileError and OSError.
    """
    found: list[SplatObject] = []
    warnings: list[str] = []
    try:
        for number, path in enumerate(paths):
            with open_splats(path, read_picture, level) as reader:
                work = _filled(path, reader, found)
                try:
                    while True:
                        yield (number + next(work)) / len(paths)
                except StopIteration:
                    pass
                warnings += [f"{path.name}: {message}" for message in messages(reader)]
                found[-1].place(context, axes or reader.header.axes)
    except BaseException:
        for made in found:
            made.remove()
        raise
    objects = [made.object for made in found if made.object is not None]
    for ob in objects:
        ob.select_set(True)
    return objects, warnings


def _filled(path: Path, reader: SplatReader, found: list[SplatObject]) -> Generator[float, None, None]:
    """Adds the object of a file's splats; yields the share that is read.

    A point cloud cannot be made smaller in all versions of Blender: where splats are left out, as few files have them,
    the file is read once more.
    """
    header = reader.header
    if header.count == 0:
        raise PointFileError(path, "has no splats")
    name = path.parent.name if path.suffix.lower() == ".json" else path.name.removesuffix(path.suffix)
    count = header.count
    while True:
        found.append(made := SplatObject(name, header, count))
        read = 0
        for part in reader.chunks(STEP):
            made.fill(part)
            read += len(part)
            yield min(read / count, 1.0)
        if read == count:
            return
        found.pop().remove()
        count = read
        if count == 0:
            raise PointFileError(path, "has no splats that can be drawn")
