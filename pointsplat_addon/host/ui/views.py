"""Views of the window that are to show what was imported."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
from mathutils import Vector

FARTHER = 4.0  # of an object's extent, and of its distance from the origin, that a view reaches: it is framed from 2
FARTHEST = 1e6  # that views are made to reach: strays of captures lie anywhere


def reach(context: Any, objects: Iterable[bpy.types.Object]) -> None:
    """Moves the clip end of all 3D views so far that they show the objects whole; what reaches farther stays."""
    corners = [ob.matrix_basis @ Vector(corner) for ob in objects for corner in ob.bound_box]
    if not corners:
        return
    diagonal = (Vector(map(max, *corners)) - Vector(map(min, *corners))).length
    wanted = min(FARTHER * max(diagonal, *(corner.length for corner in corners)), FARTHEST)
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for space in area.spaces:
                if space.type == "VIEW_3D" and space.clip_end < wanted:
                    space.clip_end = wanted
