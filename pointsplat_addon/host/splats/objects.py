"""PointCloud objects of captured splats, under the names of attributes that Blender 5.3 gives them.

Data are in the file's axes, and the object is turned to Blender's: spherical harmonics stay as they were trained.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core.numeric.vectors import each_block
from ...core.scene.captured import CapturedSplats
from ...formats.splats.axes import blender_from
from ...formats.splats.reader import BLOCK, SplatHeader
from ..convert import arrays
from ..convert.captured import ANTIALIASED, BASE, HARMONICS, ROTATION, SCALE
from ..convert.selection.filters import ORIGIN
from ..scans.objects import as_object, scene_origin, with_points

WIDTHS = {"FLOAT_VECTOR": 3, "QUATERNION": 4, "FLOAT_COLOR": 4, "FLOAT4": 4}


class SplatObject:
    """A new object that is filled with splats part by part; it is there when it is placed."""

    object: bpy.types.Object | None = None

    def __init__(self, name: str, header: SplatHeader, count: int) -> None:
        self._name, self._header, self._filled = name, header, 0
        self._data = data = with_points(name, count)
        kinds = {SCALE: "FLOAT_VECTOR", ROTATION: "QUATERNION", BASE: _four_floats()}
        kinds |= {HARMONICS.format(i): "FLOAT_VECTOR" for i in range(header.coefficients)}
        for attribute, kind in kinds.items():
            data.attributes.new(attribute, kind, "POINT")

    def fill(self, splats: CapturedSplats) -> None:
        """Writes further splats into Blender's memory."""
        first, self._filled = self._filled, self._filled + len(splats)
        if len(splats) == 0:
            return
        position, scale, rotation, base = (self._array(name) for name in ("position", SCALE, ROTATION, BASE))
        coefficients = 0 if splats.sh is None else splats.sh.shape[1]
        harmonics = [_whole(self._array(HARMONICS.format(i))) for i in range(coefficients)]
        given = None if splats.sh is None else _whole(splats.sh.reshape(-1, 3)).reshape(len(splats), coefficients)

        def write(block: slice) -> None:
            rows = slice(first + block.start, first + block.stop)
            position[rows], scale[rows] = splats.position[block], splats.scale[block]
            rotation[rows] = splats.rotation[block]
            base[rows, :3], base[rows, 3] = splats.base[block], splats.opacity[block]
            if given is not None:
                for i, array in enumerate(harmonics):
                    array[rows] = given[block, i]

        each_block(len(splats), write, BLOCK)

    def _array(self, name: str) -> np.ndarray:
        """An attribute's memory, (N, 3 | 4) float32."""
        attribute = self._data.attributes[name]
        width = WIDTHS[attribute.data_type]
        return arrays.view(attribute.data, (len(attribute.data), width), np.float32)

    def place(self, context: Any, axes: str) -> None:
        """Turns the object from a file's axes to Blender's, links it to the active collection and selects it."""
        header, first = self._header, self._data.attributes["position"].data[0]
        first.vector = first.vector  # Blender does not know that positions changed, and would keep their bounds
        self.object = ob = as_object(self._name, self._data)
        self._data = ob.data
        ob.data.update_tag()
        if header.antialiased:
            ob[ANTIALIASED] = True
        turn = blender_from(axes)
        ob.matrix_basis = Matrix(turn.tolist()).to_4x4()
        if any(header.origin):
            origin = turn @ np.array(header.origin)
            ob[ORIGIN] = [float(x) for x in header.origin]
            ob.location = origin - scene_origin(context.scene, origin, "")
        context.collection.objects.link(ob)
        for other in context.selected_objects:
            other.select_set(False)
        context.view_layer.objects.active = ob
        ob.select_set(True)

    def remove(self) -> None:
        """Takes the object out of the file."""
        if self.object is not None:
            bpy.data.objects.remove(self.object)
        blocks: Any = bpy.data.pointclouds if isinstance(self._data, bpy.types.PointCloud) else bpy.data.meshes
        blocks.remove(self._data)


def _whole(vectors: np.ndarray) -> np.ndarray:
    """Rows (N, 3) float32 as items (N,), which are copied at once: NumPy copies short rows column by column."""
    return vectors.view(np.dtype((np.void, 12)))[:, 0]


def _four_floats() -> str:
    """Blender's type of attributes of four numbers: a colour, where there is no other."""
    kinds = bpy.types.Attribute.bl_rna.properties["data_type"].enum_items
    return "FLOAT4" if "FLOAT4" in kinds else "FLOAT_COLOR"
