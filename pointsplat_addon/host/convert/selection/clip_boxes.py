"""Clip boxes of a PointCloud object: empties, inside or outside of which its points are drawn.

A box is a cube from -1 to 1 times the empty's display size, as Blender draws an empty that is displayed as a cube, in
the empty's own space. A cloud is clipped once it is made: boxes that move do not make the cloud, its normals and its
colours anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import bpy
import numpy as np

from ....core.numeric.record import value_record
from ....core.scene.bounds import within
from ....core.scene.cloud import PointCloud
from .. import arrays

Lookup = Callable[[str, Callable[[], Any]], Any]  # the object of a key, made only if it is not known


class Boxes(NamedTuple):
    """The clip boxes of an object, in world space."""

    box_from_world: np.ndarray  # (B, 4, 4) float64; a box is a cube from -1 to 1
    inside: bool  # whether the points within are kept; else those within none
    messages: tuple[str, ...]

    def of_instance(self, world_from_object: np.ndarray) -> Clip:
        """The boxes as one instance of the object meets them. world_from_object: (4, 4)."""
        boxes = self.box_from_world @ world_from_object
        return Clip(tuple(float(x) for x in boxes.ravel()), self.inside, self.messages)


@value_record
class Clip:
    """Boxes in the space of an object's points, and what went wrong with them."""

    box_from_object: tuple[float, ...]  # 16 numbers of each box, row by row
    inside: bool
    messages: tuple[str, ...] = ()


def boxes_of(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Boxes | None:
    """The clip boxes of an object; None without a collection of them."""
    if ob.type != "POINTCLOUD" or (collection := ob.original.pointsplat.clip_boxes) is None:
        return None
    empties = [item for item in collection.all_objects if item.type == "EMPTY"]
    messages = [] if empties else [f'The collection "{collection.name}" of its clip boxes has no empties']
    found = []
    for empty in empties:
        # Hidden ones are not evaluated: they are where they were seen last.
        world_from_box = np.array(empty.evaluated_get(depsgraph).matrix_world, np.float64)
        world_from_box[:3, :3] *= empty.empty_display_size
        if not np.isfinite(world_from_box).all() or np.linalg.matrix_rank(world_from_box[:3, :3]) < 3:
            messages.append(f'The clip box "{empty.name}" has no volume and is left out')
        else:
            found.append(np.linalg.inv(world_from_box))
    inside = ob.original.pointsplat.clip_keep == "INSIDE"
    return Boxes(np.array(found).reshape(-1, 4, 4), inside, tuple(messages))


def clipped(key: str, cloud: PointCloud, clip: Clip, lookup: Lookup) -> tuple[str, PointCloud | None]:
    """(content key, cloud) of the points that the boxes keep, None without any. `key`: of the whole cloud."""
    boxes = np.array(clip.box_from_object).reshape(-1, 4, 4)
    if len(boxes) == 0:
        return key, cloud
    key = f"{key} {arrays.digest(clip.box_from_object, clip.inside)}"
    rows = np.flatnonzero(within(cloud.position, boxes) == clip.inside)
    if len(rows) in (0, len(cloud)):
        return key, cloud if len(rows) else None
    return key, lookup(key, lambda: cloud.take(rows))
