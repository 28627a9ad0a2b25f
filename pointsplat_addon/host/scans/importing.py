"""Imports scans: files into one object, step by step, so that a window stays alive meanwhile."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import bpy

from ...formats.points import ply
from ...formats.points.gather import Gathered, Selection, gather
from ...formats.points.opening import FOLDERS, open_points
from ...formats.points.reader import PointFileError, Reader
from .looks import default_look, look_material
from .objects import scan_object, scene_origin

STEP = 1 << 18  # points between two looks at the window


def import_scan(
    context: Any, paths: Sequence[Path], selection: Selection, unit: float = 1.0
) -> Generator[float, None, tuple[bpy.types.Object, list[str]]]:
    """Reads files into one PointCloud object, which is linked to the active collection and selected.

    Yields the share that is done; returns the object, and warnings. Closed before its end it leaves nothing behind.
    `unit`: metres of the files' unit of length. Raises PointFileError and OSError; no object is made then.
    """
    with ExitStack() as stack:
        readers = []
        for path in paths:
            if path.suffix.lower() == ".ply" and ply.kind_of(path) == "SPLATS":
                raise PointFileError(path, "holds captured Gaussian splats, not a scan: import it as such")
            readers.append(reader := open_points(path))
            stack.callback(reader.close)
        warnings = _of_several(readers)
        for reader in readers:
            warnings += reader.header.warnings
        found = yield from gather(readers, selection, STEP)
    if len(found) == 0:
        raise PointFileError(paths[0], "has no points" + (" that are wanted" if selection != Selection() else ""))
    if found.dropped:
        warnings.append(f"{found.dropped:,} points without a position are left out")
    crs = readers[0].header.crs
    found.warnings = warnings + found.warnings
    ob = placed(context, _name(paths), found, crs, unit)
    return ob, found.warnings


def _name(paths: Sequence[Path]) -> str:
    """What the object is called: as its file, or as the folder of several or of an octree."""
    alone = len(paths) == 1 and paths[0].name.lower() not in FOLDERS
    return paths[0].stem.removesuffix(".copc") if alone else paths[0].parent.name


def placed(context: Any, name: str, found: Gathered, crs: str, unit: float) -> bpy.types.Object:
    """The object of the points, in the scene."""
    origin = found.origin
    ob = scan_object(name, found, crs)
    ob.data.materials.append(look_material(ob, default_look(ob.data.attributes.keys())))
    if origin.any():  # coordinates near zero are no map's
        ob.location = (origin - scene_origin(context.scene, origin, crs)) * unit
    ob.scale = (unit, unit, unit)
    context.collection.objects.link(ob)
    for other in context.selected_objects:
        other.select_set(False)
    context.view_layer.objects.active = ob
    ob.select_set(True)
    return ob


def _of_several(readers: Sequence[Reader]) -> list[str]:
    """Warnings of files that do not belong together."""
    systems: dict[str, str] = {}
    for reader in readers:
        systems.setdefault(reader.header.crs, reader.header.path.name)
    if len(systems) < 2:
        return []
    named = "; ".join(f"{name}: {crs[:60] or 'none named'}" for crs, name in systems.items())
    return [f"The files have different coordinate reference systems ({named})"]


def unit_of(crs: str) -> float:
    """Returns metres of a file's unit of length, by its coordinate reference system; 1 where that names none."""
    if "US survey foot" in crs or "Foot_US" in crs or "foot_survey_us" in crs:
        return 1200 / 3937
    if 'UNIT["Foot"' in crs or 'LENGTHUNIT["foot"' in crs or 'UNIT["foot"' in crs:
        return 0.3048
    return 1.0
