"""Operators of scans too large for memory: building and linking them, and finding their files again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...formats.hierarchies.opening import ENDS
from ...formats.points.opening import FORMATS
from ...formats.points.reader import PointFileError
from ..ui.stepwise import Stepwise
from ..ui.views import reach
from . import linked_paths
from .building import build_scan
from .linking import find_scans, link_scan, missing_scans

LINKED, BUILT = "pointsplat.link_scan", "pointsplat.build_scan"


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


class POINTSPLAT_OT_build_scan(Stepwise, bpy.types.Operator, ImportHelper):
    """Build a hierarchy on disk (.psh) from files of any size, and link it. A build that is stopped goes on where it
    was when it is asked for again"""

    bl_idname = BUILT
    bl_label = "Build Large Point Cloud"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default=";".join(f"*{end}" for end in FORMATS), options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})

    output: StringProperty(
        name="Output",
        description="The hierarchy's file; empty: beside the files, named as the only one or as their folder",
        default="",
    )
    normals: BoolProperty(
        name="Normals",
        description="Find normals, from neighbours; the build takes some four times as long",
        default=True,
    )
    intensity: BoolProperty(name="Intensity", description="Keep intensities, for looks and filters", default=False)
    classification: BoolProperty(name="Classes", description="Keep classes, for looks and filters", default=False)

    noun = "a large scan"

    def draw(self, _context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "output")
        layout.prop(self, "normals")
        column = layout.column(heading="Keep")
        column.prop(self, "intensity")
        column.prop(self, "classification")

    def execute(self, context):
        paths = self.paths()
        alone = len(paths) == 1 and paths[0].is_file()
        folder, name = paths[0].parent, paths[0].stem if alone else paths[0].parent.name
        output = Path(bpy.path.abspath(self.output)) if self.output else folder / name
        self._output = output.with_suffix(".psh")
        kept = tuple(name for name in ("intensity", "classification") if getattr(self, name))
        return self.start(context, build_scan(paths, self._output, self.normals, kept))

    def finish(self, result):
        for warning in result.warnings:
            self.report({"WARNING"}, warning)
        ob, source = link_scan(bpy.context, self._output)
        source.close()
        self.report({"INFO"}, f"{ob.name}: {result.points:,} points, {result.nbytes / 1e6:,.0f} MB")
        reach(bpy.context, [ob])

    _output = Path()


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
    self.layout.operator(BUILT, text="Build Large Point Cloud (.las, .laz, .e57, .ply, ...)")


def _external_data(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(POINTSPLAT_OT_find_missing_scans.bl_idname)


CLASSES = (POINTSPLAT_OT_link_scan, POINTSPLAT_OT_build_scan, POINTSPLAT_OT_find_missing_scans)


def register() -> None:
    bpy.types.TOPBAR_MT_file_import.append(_menu)
    bpy.types.TOPBAR_MT_file_external_data.append(_external_data)
    linked_paths.register()


def unregister() -> None:
    linked_paths.unregister()
    bpy.types.TOPBAR_MT_file_external_data.remove(_external_data)
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
