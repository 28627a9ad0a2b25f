"""Objects that stand for scans too large for memory: they refer to a file and hold a few of its points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.material.color_models import srgb_from_linear
from ...formats.hierarchies.opening import open_pages
from ...formats.hierarchies.source import PageSource
from ...formats.points.gather import Gathered
from ...formats.points.opening import FOLDERS
from ...formats.points.reader import Columns, PointFileError
from .importing import placed, unit_of

STAND_IN = 1 << 13  # points that the object holds, for Solid mode and other engines
OF_NODES = frozenset({"axis", "radii", "covered", "coherence"})  # columns of nodes, whose normals are their kernels'
SPREAD = 0.62  # the golden section, by whose multiples points of the root are taken: evenly, whatever their order


def link_scan(context: Any, path: Path, use_unit: bool = True) -> tuple[bpy.types.Object, PageSource]:
    """Makes an object of a file, which is linked to the active collection and selected; returns it, and the file, which
    the caller closes.

    `use_unit`: objects of files that count in feet are scaled. Raises PointFileError and OSError; no object is made
    then.
    """
    path = path.parent if path.name.lower() == "ept.json" else path
    source = open_pages(path)
    try:
        root = source.read(0)
        if len(root["position"]) == 0:
            raise PointFileError(path, "has no points in its first page")
        found = stand_in(source, root)
        name = path.name if path.is_dir() else path.stem.removesuffix(".copc")
        crs = source.directory.crs
        ob = placed(context, name, found, crs, unit_of(crs) if use_unit else 1.0)
    except BaseException:
        source.close()
        raise
    ob.pointsplat.scan_path = stored_path(path / "ept.json" if path.is_dir() else path)
    ob.pointsplat.shape = "DISKS" if "coherence" in root or ("normal" in root and "radii" not in root) else "BALLS"
    return ob, source


def stored_path(path: Path) -> str:
    """A path as the file refers to it: relative to it, where it is saved on the same drive."""
    absolute = str(path.resolve())
    if not bpy.data.filepath or not bpy.context.preferences.filepaths.use_relative_paths:
        return absolute
    try:
        return bpy.path.relpath(absolute)
    except ValueError:  # another drive
        return absolute


def stand_in(source: PageSource, root: Columns) -> Gathered:
    """Returns at most STAND_IN points of a scan's first page, `root`, evenly spread over it, as an import has them."""
    count = len(root["position"])
    rows = np.arange(count)
    if count > STAND_IN:
        rows = np.flatnonzero(np.modf(np.arange(count) * SPREAD)[0] < STAND_IN / count)
    left_out = {"normal", *OF_NODES} if "radii" in root else set()
    columns = {name: values[rows] for name, values in root.items() if name not in left_out}
    if "color" in columns:
        rgba = np.full((len(rows), 4), 255, np.uint8)
        rgba[:, :3] = np.rint(255 * np.clip(srgb_from_linear(columns["color"]), 0, 1))
        columns["color"] = rgba
    return Gathered(source.directory.origin, columns)


def missing_scans() -> list[bpy.types.Object]:
    """The objects whose files are not where they were."""
    linked = [ob for ob in bpy.data.objects if ob.type == "POINTCLOUD" and ob.pointsplat.scan_path]
    return [ob for ob in linked if not path_of(ob).exists()]


def path_of(ob: bpy.types.Object) -> Path:
    """The file that an object refers to."""
    return Path(bpy.path.abspath(ob.pointsplat.scan_path, library=ob.library))


def find_scans(folder: Path, objects: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """Looks for the files of objects below a folder, by their names (of Entwine, that of the folder); returns the
    objects that were given their file."""
    wanted: dict[tuple[str, ...], list[bpy.types.Object]] = {}
    for ob in objects:
        wanted.setdefault(_tail(path_of(ob)), []).append(ob)
    found = []
    for path in sorted(folder.rglob("*")):
        for ob in wanted.pop(_tail(path), ()):
            ob.pointsplat.scan_path = stored_path(path)
            found.append(ob)
    return found


def _tail(path: Path) -> tuple[str, ...]:
    return path.parts[-2:] if path.name.lower() in FOLDERS else path.parts[-1:]
