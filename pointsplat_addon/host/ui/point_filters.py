"""The list object.pointsplat.filters, and the operators that change it."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..convert.selection.filters import FilterError, Filters, PointFilter, filters_of, values

KINDS = (
    ("CLASS", "Class", "Numbers of the standard's classes (LAS), of the attribute classification"),
    ("HEIGHT", "Height", "Z in the object, plus the Z of its map origin where it has one"),
    ("DISTANCE", "Distance", "To the scanner that saw the point, where the object names it; else to its origin"),
    ("INTENSITY", "Intensity", "How much came back: the attribute intensity"),
    ("RETURN", "Return", "Which of a pulse's echoes a point is: the attribute return_number"),
    ("TIME", "Time", "Seconds since the first point: the attribute gps_time"),
    ("ATTRIBUTE", "Attribute", "Any attribute of the points; of vectors and colours the length"),
)


def changed(_properties: Any, _context: bpy.types.Context) -> None:
    """Do nothing. Without an update callback Blender does not refresh evaluated copies after a script's change."""


class PointSplatFilter(bpy.types.PropertyGroup):
    """A condition that the points of an object must meet to be drawn."""

    use: BoolProperty(name="Use", description="Whether the filter applies", default=True, update=changed)
    kind: EnumProperty(
        name="Kind", description="What the filter asks of a point", items=KINDS, default="CLASS", update=changed
    )
    attribute: StringProperty(
        name="Attribute", description="The attribute that the filter reads", default="", update=changed
    )
    classes: StringProperty(
        name="Classes",
        description="Numbers of the classes that are shown, such as 2, 6; empty shows all",
        default="",
        update=changed,
    )
    low: FloatProperty(
        name="From", description="The least value that is shown", default=0.0, precision=3, update=changed
    )
    high: FloatProperty(
        name="To", description="The greatest value that is shown", default=0.0, precision=3, update=changed
    )
    invert: BoolProperty(
        name="Invert",
        description="Show what the filter would hide. Points whose value is not a number are hidden by both",
        default=False,
        update=changed,
    )


class _FilterOperator:
    """What operators on a point cloud's list of filters have in common."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "POINTCLOUD"


class POINTSPLAT_OT_add_point_filter(_FilterOperator, bpy.types.Operator):
    """Hide points of the object by what they are, in pictures alone; the range is at first that of all points"""

    bl_idname = "pointsplat.add_point_filter"
    bl_label = "Add Filter"

    kind: EnumProperty(name="Kind", description="What the filter asks of a point", items=KINDS, default="CLASS")
    attribute: StringProperty(name="Attribute", description="The attribute that the filter reads", default="")

    def execute(self, context):
        ob = context.object
        made = ob.pointsplat.filters.add()
        made.kind, made.attribute = self.kind, self.attribute
        _fit(context, ob, made)
        ob.update_tag()
        return {"FINISHED"}


class _ChosenFilterOperator(_FilterOperator):
    """An operator on one filter of the list."""

    index: IntProperty(name="Index", description="Which filter of the list", default=0, min=0)

    def execute(self, context):
        filters = context.object.pointsplat.filters
        if self.index >= len(filters):
            self.report({"ERROR"}, f"{context.object.name} has {len(filters)} filters")
            return {"CANCELLED"}
        if problem := self.change(context, filters):
            self.report({"ERROR"}, f"{context.object.name}: {problem}")
            return {"CANCELLED"}
        return {"FINISHED"}


class POINTSPLAT_OT_fit_point_filter(_ChosenFilterOperator, bpy.types.Operator):
    """Set the range of the filter to that of the object's points"""

    bl_idname = "pointsplat.fit_point_filter"
    bl_label = "Range of the Points"

    def change(self, context, filters):
        return _fit(context, context.object, filters[self.index])


class POINTSPLAT_OT_remove_point_filter(_ChosenFilterOperator, bpy.types.Operator):
    """Remove the filter; the points that it hides are shown again"""

    bl_idname = "pointsplat.remove_point_filter"
    bl_label = "Remove Filter"

    def change(self, context, filters):
        filters.remove(self.index)
        context.object.update_tag()  # lists have no update callback
        return ""


def _fit(context: bpy.types.Context, ob: bpy.types.Object, made: Any) -> str:
    """Set a filter's range to that of all finite values, of points as modifiers leave them; returns why it cannot."""
    if made.kind == "CLASS":
        return ""
    try:
        used = filters_of(ob) or Filters((PointFilter(made.kind),))
        data = ob.evaluated_get(context.evaluated_depsgraph_get()).data
        value = values(data, made.kind, made.attribute, used) if len(data.points) else np.empty(0)
    except FilterError as error:
        return str(error)
    value = value[np.isfinite(value)]
    if len(value):
        # Properties are float32, which may lie within the range.
        low, high = np.float32(value.min()), np.float32(value.max())
        made.low = float(low if low <= value.min() else np.nextafter(low, np.float32(-np.inf)))
        made.high = float(high if high >= value.max() else np.nextafter(high, np.float32(np.inf)))
    return ""


CLASSES = (
    PointSplatFilter,
    POINTSPLAT_OT_add_point_filter,
    POINTSPLAT_OT_fit_point_filter,
    POINTSPLAT_OT_remove_point_filter,
)
