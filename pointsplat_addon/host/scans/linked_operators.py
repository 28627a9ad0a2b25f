"""Operators of scans too large for memory: linking them, and finding their files again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...formats.hierarchies.opening import ENDS
from ...formats.points.reader import PointFileError
from ..ui.views import reach
from . import linked_paths
from .linking import find_scans, link_scan, missing_scans

LINKED = "pointsplat.link_scan"


class POINTSPLAT_OT_link_scan(bpy.types.Operator, ImportHelper):
    """Make an object that stands for a scan too large for memory: pictures read what they need of its file: a
    hierarchy of PointSplat's (.psh), Entwine (ept.json) or COPC"""

    bl_idname = LINKED
    bl_label = "Link Large Point Cloud"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default=";".join(f"*{end}" for end in ENDS), options={"HIDDEN"})

    use_unit: BoolProperty(
        name="Feet to Metres",
        description="Scale objects of files whose coordinate reference system counts in feet",
        default=True,
    )

    def execute(self, context):
        try:
            ob, source = link_scan(context, Path(bpy.path.abspath(self.filepath)), self.use_unit)
        except (PointFileError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        with source:
            self.report({"INFO"}, f"{ob.name}: {source.directory.points:,} points in {len(source.directory):,} pages")
        reach(context, [ob])
        return {"FINISHED"}


class POINTSPLAT_OT_find_missing_scans(bpy.types.Operator):
    """Look in a folder, and all folders in it, for the files of linked scans that are not where they were"""

    bl_idname = "pointsplat.find_missing_scans"
    bl_label = "Find Missing Scans"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(name="Folder", description="Where to look", subtype="DIR_PATH")

    def invoke(self, context, _event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        missing = missing_scans()
        if not missing:
            self.report({"INFO"}, "No file of a linked scan is missing")
            return {"FINISHED"}
        found = find_scans(Path(bpy.path.abspath(self.directory)), missing)
        left = ", ".join(ob.name for ob in missing if ob not in found)
        if left:
            self.report({"WARNING"}, f"Not found: {left}")
        self.report({"INFO"}, f"{len(found)} of {len(missing)} files were found")
        return {"FINISHED"} if found else {"CANCELLED"}


def _menu(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(LINKED, text="Large Point Cloud (.psh, Entwine, COPC)")


def _external_data(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(POINTSPLAT_OT_find_missing_scans.bl_idname)


CLASSES = (POINTSPLAT_OT_link_scan, POINTSPLAT_OT_find_missing_scans)


def register() -> None:
    bpy.types.TOPBAR_MT_file_import.append(_menu)
    bpy.types.TOPBAR_MT_file_external_data.append(_external_data)
    linked_paths.register()


def unregister() -> None:
    linked_paths.unregister()
    bpy.types.TOPBAR_MT_file_external_data.remove(_external_data)
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
