"""Operators of captured splats: importing and exporting them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ...formats.points.reader import PointFileError
from ...formats.splats.axes import Y_DOWN, Y_UP, Z_UP
from ...formats.splats.opening import ENDS, SETS
from ..ui.stepwise import Stepwise
from ..ui.views import reach
from .exporting import AXES, NothingToExportError, export_file
from .importing import import_files

IMPORTED = "pointsplat.import_splats"
EXPORTED = "pointsplat.export_splats"


class POINTSPLAT_OT_import_splats(Stepwise, bpy.types.Operator, ImportHelper):
    """Import captured Gaussian splats: PLY, packed PLY, splat, ksplat, SPZ, SOG, streamed SOG (lod-meta.json)"""

    bl_idname = IMPORTED
    bl_label = "Import Gaussian Splats"
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    filter_glob: StringProperty(default=";".join(f"*{end}" for end in (*ENDS, *SETS)), options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    axes: EnumProperty(
        name="Axes",
        description="What the file's axes point to; the object is turned so that up is up",
        items=(
            (
                "AUTO",
                "Automatic",
                "Those of the format: Y is up in SPZ files that name no others, and down in all others",
            ),
            (Y_DOWN, "Y Down", "X right, Y down, Z forward, as training has them"),
            (Y_UP, "Y Up", "X right, Y up, Z backward"),
            (Z_UP, "Z Up", "X right, Y forward, Z up, as Blender has them"),
        ),
        default="AUTO",
    )
    level: IntProperty(
        name="Level of Detail", description="Of streamed sets: 0 is the finest, further ones coarser", default=0, min=0
    )

    def draw(self, _context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "axes")
        layout.prop(self, "level")

    def invoke(self, context, event):
        dropped = self.directory and len(self.files)
        return self.invoke_popup(context) if dropped else ImportHelper.invoke(self, context, event)

    def execute(self, context):
        axes = "" if self.axes == "AUTO" else self.axes
        return self.start(context, import_files(context, self.paths(), axes, self.level))

    noun = "splats"

    def finish(self, result):
        objects, warnings = result
        reach(bpy.context, objects)
        for warning in warnings:
            self.report({"WARNING"}, warning)
        for ob in objects:
            self.report({"INFO"}, f"{ob.name}: {len(ob.data.points):,} splats")


class POINTSPLAT_OT_export_splats(bpy.types.Operator, ExportHelper):
    """Export the captured splats of the selected objects, as their modifiers leave them, as PLY or SPZ"""

    bl_idname = EXPORTED
    bl_label = "Export Gaussian Splats"
    bl_options = {"PRESET"}

    filter_glob: StringProperty(default=";".join(f"*{end}" for end in AXES), options={"HIDDEN"})
    filename_ext = ".ply"
    file_format: EnumProperty(
        name="Format",
        description="What is written; a name that ends otherwise gets the format's ending",
        items=(
            ("PLY", "PLY", "Every number as it is, as training programs write it"),
            ("SPZ", "SPZ", "A tenth of the size, each number in a byte or two; version 3, which most programs read"),
            ("SPZ4", "SPZ 4", "SPZ, version 4, which is faster to read"),
        ),
        default="PLY",
    )
    use_selection: BoolProperty(
        name="Selection Only", description="Write the selected objects, else all of the scene", default=True
    )

    def check(self, _context):
        path = Path(self.filepath)
        wanted = str(path.with_suffix(self._ending())) if path.name else self.filepath
        changed = wanted != self.filepath
        self.filepath = wanted
        return changed

    def execute(self, context):
        path = Path(bpy.path.abspath(self.filepath))
        if path.suffix.lower() not in AXES:
            path = path.with_name(path.name + self._ending())
        chosen = context.selected_objects if self.use_selection else context.scene.objects
        try:
            version = 4 if self.file_format == "SPZ4" else 3
            count, warnings = export_file(context, path, chosen, version)
        except (NothingToExportError, PointFileError, OSError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "There is not enough memory for the splats")
            return {"CANCELLED"}
        for warning in warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{path.name}: {count:,} splats")
        return {"FINISHED"}

    def _ending(self) -> str:
        return ".ply" if self.file_format == "PLY" else ".spz"


class POINTSPLAT_FH_splats(bpy.types.FileHandler):
    bl_idname = "POINTSPLAT_FH_splats"
    bl_label = "Gaussian Splats"
    bl_import_operator = IMPORTED
    bl_export_operator = EXPORTED
    bl_file_extensions = ";".join((*ENDS, ".json"))

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type == "VIEW_3D"


def _import_menu(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(IMPORTED, text=f"Gaussian Splats ({', '.join(ENDS)})")


def _export_menu(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(EXPORTED, text=f"Gaussian Splats ({', '.join(AXES)})")


CLASSES = (POINTSPLAT_OT_import_splats, POINTSPLAT_OT_export_splats, POINTSPLAT_FH_splats)


def register() -> None:
    bpy.types.TOPBAR_MT_file_import.append(_import_menu)
    bpy.types.TOPBAR_MT_file_export.append(_export_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_import_menu)
    bpy.types.TOPBAR_MT_file_export.remove(_export_menu)
