"""Captured splats of a PointCloud object, by the names of attributes that Blender 5.3 gives them.

Any point cloud with a scale, a rotation and a radiance is one, whoever made it: importers, or geometry nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ...core.numeric.vectors import each_block, take_rows
from ...core.scene.captured import COEFFICIENTS, CapturedSplats
from . import arrays
from .selection.clip_boxes import Clip, within

SCALE, ROTATION, BASE = "scale", "rotation", "radiance:base"  # base: three coefficients of degree 0, and opacity
HARMONICS = "radiance:sh_{}"  # of each coefficient of higher degrees
TYPES = {SCALE: ("FLOAT_VECTOR",), ROTATION: ("QUATERNION",), BASE: ("FLOAT_COLOR", "FLOAT4")}
ANTIALIASED = "pointsplat_antialiased"  # custom property of an object
Lookup = Callable[[str, Callable[[], Any]], Any]  # the object of a key, made only if it is not known


def is_captured(data: Any) -> bool:
    """Whether a point cloud holds captured splats."""
    return isinstance(data, bpy.types.PointCloud) and all(_has(data, name, kinds) for name, kinds in TYPES.items())


def read_captured(
    data: Any, antialiased: bool, lookup: Lookup, rows: np.ndarray | None = None, clip: Clip | None = None
) -> tuple[str, CapturedSplats, tuple[str, ...]] | None:
    """(content key, splats, messages) of a point cloud, in object space; None if nothing is left of it.

    rows: the points that are wanted, (K,) int; None: all. clip: boxes that cut them.
    """
    count = len(data.points)
    if "position" not in data.attributes or count == 0:
        return None
    widths = {"position": 3, SCALE: 3, ROTATION: 4, BASE: 4}
    given = {name: arrays.values(data.attributes[name], width, np.float32) for name, width in widths.items()}
    sh, messages = _harmonics(data)
    if clip is not None:
        rows, messages = _clipped(given["position"], rows, clip), messages + clip.messages
    if rows is not None and len(rows) == 0:
        return None
    key = arrays.digest("captured", antialiased, "all" if rows is None else rows, *given.values(), *sh)

    def taken(array: np.ndarray) -> np.ndarray:
        """The wanted rows, not in Blender's memory."""
        return array.copy() if rows is None else take_rows(array, rows)

    def make() -> CapturedSplats:
        base = taken(given[BASE])
        own = taken(given["position"]), taken(given[SCALE]), taken(given[ROTATION]), np.ascontiguousarray(base[:, :3])
        opacity = np.clip(base[:, 3], 0, 1)  # of colours, which nodes may have brought beyond
        return CapturedSplats(*own, opacity, _together(sh, rows), antialiased=antialiased)

    return key, lookup(key, make), messages


def _has(data: Any, name: str, kinds: tuple[str, ...]) -> bool:
    attribute = data.attributes.get(name)
    return attribute is not None and attribute.data_type in kinds and attribute.domain == "POINT"


def _harmonics(data: Any) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """The coefficients of the whole degrees that there are, (N, 3) each, and messages of those that are left out."""
    there = 0
    while there < COEFFICIENTS[-1] and _has(data, HARMONICS.format(there), ("FLOAT_VECTOR",)):
        there += 1
    whole = max((count for count in (0, *COEFFICIENTS) if count <= there), default=0)
    found = [arrays.values(data.attributes[HARMONICS.format(i)], 3, np.float32) for i in range(whole)]
    given = sum(attribute.name.startswith(HARMONICS.format("")) for attribute in data.attributes)
    if given == whole:
        return found, ()
    return found, (f"{given - whole} of the {given} attributes {HARMONICS.format('*')} make no whole degree of"
                   " spherical harmonics and are left out",)  # fmt: skip


def _together(sh: list[np.ndarray], rows: np.ndarray | None) -> np.ndarray | None:
    """Coefficients (N, K, 3) of the wanted rows; None without any."""
    if not sh:
        return None
    count = len(sh[0]) if rows is None else len(rows)
    found = np.empty((count, len(sh), 3), np.float32)

    def fill(block: slice) -> None:
        for i, array in enumerate(sh):
            found[block, i] = array[block] if rows is None else array[rows[block]]

    each_block(count, fill)
    return found


def _clipped(position: np.ndarray, rows: np.ndarray | None, clip: Clip) -> np.ndarray | None:
    """The rows that clip boxes keep."""
    boxes = np.array(clip.box_from_object).reshape(-1, 4, 4)
    if len(boxes) == 0:
        return rows
    kept = within(position if rows is None else take_rows(position, rows), boxes) == clip.inside
    if kept.all():
        return rows
    return np.flatnonzero(kept) if rows is None else rows[kept]
