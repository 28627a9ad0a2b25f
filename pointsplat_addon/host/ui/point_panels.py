"""Panels of point clouds: which of their points are drawn."""

from __future__ import annotations

import bpy

from .panels import ENGINE
from .point_filters import KINDS

LABELS = {key: label for key, label, _ in KINDS}


class _PointPanel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "object"
    bl_parent_id = "POINTSPLAT_OBJECT_PT_pointsplat"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.engine == ENGINE and context.object and context.object.type == "POINTCLOUD"


class POINTSPLAT_OBJECT_PT_filters(_PointPanel, bpy.types.Panel):
    bl_label = "Filters"

    def draw(self, context):
        ob, layout = context.object, self.layout
        for index, one in enumerate(ob.pointsplat.filters):
            box = layout.box()
            row = box.row()
            row.prop(one, "use", text="")
            row.label(text=LABELS[one.kind])
            row.prop(one, "invert", text="", icon="ARROW_LEFTRIGHT")
            row.operator("pointsplat.remove_point_filter", text="", icon="X", emboss=False).index = index
            column = box.column()
            column.active = one.use
            if one.kind == "CLASS":
                column.prop(one, "classes", text="")
                continue
            if one.kind == "ATTRIBUTE":
                column.prop_search(one, "attribute", ob.data, "attributes", text="")
            row = column.row(align=True)
            row.prop(one, "low", text="")
            row.prop(one, "high", text="")
            row.operator("pointsplat.fit_point_filter", text="", icon="FULLSCREEN_EXIT").index = index
        layout.operator_menu_enum("pointsplat.add_point_filter", "kind", icon="ADD")


class POINTSPLAT_OBJECT_PT_clip_boxes(_PointPanel, bpy.types.Panel):
    bl_label = "Clip Boxes"

    def draw(self, context):
        settings, layout = context.object.pointsplat, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "clip_boxes")
        row = layout.row()
        row.active = settings.clip_boxes is not None
        row.prop(settings, "clip_keep")


CLASSES = (POINTSPLAT_OBJECT_PT_filters, POINTSPLAT_OBJECT_PT_clip_boxes)
