"""Operators of scans: importing them, and how they look; and the panel of a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatVectorProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...formats.points.gather import Selection
from ...formats.points.opening import FORMATS, open_points
from ...formats.points.reader import PointFileError
from ..convert.selection.filters import ORIGIN, class_numbers
from ..ui.stepwise import Stepwise
from ..ui.views import reach
from . import looks
from .importing import import_scan, unit_of
from .sequences import import_sequence

ENDS = tuple(end for end in FORMATS if end.startswith("."))
IMPORTED = "pointsplat.import_points"


class POINTSPLAT_OT_import_points(Stepwise, bpy.types.Operator, ImportHelper):
    """Import a scan: LAS, LAZ, COPC, E57, PLY, PCD, PTS, PTX, text, Entwine (ept.json) or Potree 1.7 (cloud.js)"""

    bl_idname = IMPORTED
    bl_label = "Import Point Cloud"
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    filter_glob: StringProperty(default=";".join(f"*{end}" for end in FORMATS), options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    attributes: EnumProperty(
        name="Attributes",
        description="What is kept beside positions",
        items=(
            ("ALL", "All", "All attributes of the file that are not zero everywhere"),
            ("LOOK", "Colour and Intensity", "Colours, intensities, normals and classes alone"),
            ("NONE", "None", "Positions alone"),
        ),
        default="ALL",
    )
    every: IntProperty(
        name="Every nth Point", description="Of so many points one is kept", default=1, min=1, soft_max=100
    )
    use_box: BoolProperty(name="Bounds", description="Keep the points within a box of map coordinates", default=False)
    box_low: FloatVectorProperty(name="Low", description="Low corner of the box, map coordinates", size=3, precision=3)
    box_high: FloatVectorProperty(
        name="High", description="High corner of the box, map coordinates", size=3, precision=3
    )
    classes: StringProperty(
        name="Classes", description="Numbers of the classes that are kept, such as 2, 6; empty keeps all", default=""
    )
    use_unit: BoolProperty(
        name="Feet to Metres",
        description="Scale objects of files whose coordinate reference system counts in feet",
        default=True,
    )

    shape: EnumProperty(
        name="Shape",
        description="What the points are drawn as; the object's Shape, which may be changed later",
        items=(
            ("SURFACE", "Surface", "Ellipses that close the surface, and balls where points lie on none, as of leaves"),
            ("BALLS", "Balls", "Balls, without finding normals first: quicker to draw, with gaps from near"),
        ),
        default="SURFACE",
    )

    sequence: BoolProperty(
        name="Sequence",
        description="The file is one of numbered PLY files, as frame_0001.ply. One object reads the file of the "
        "scene's frame, by geometry nodes, which other engines show as well",
        default=False,
        options={"SKIP_SAVE"},
    )

    def draw(self, _context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "sequence")
        if self.sequence:
            return
        layout.prop(self, "shape")
        layout.prop(self, "attributes")
        layout.prop(self, "every")
        layout.prop(self, "classes")
        layout.prop(self, "use_unit")
        column = layout.column(heading="Bounds")
        column.prop(self, "use_box", text="")
        if self.use_box:
            column.prop(self, "box_low")
            column.prop(self, "box_high")
        _draw_columns(layout, self.filepath)

    def invoke(self, context, event):
        dropped = self.directory and len(self.files)
        return self.invoke_popup(context) if dropped else ImportHelper.invoke(self, context, event)

    def execute(self, context):
        paths = self.paths()
        if self.sequence:
            return self._import_sequence(context, paths[0])
        try:
            selection = Selection(self._attributes(), self.every, self._box(), self._classes())
            unit = self._unit(paths[0])
        except (PointFileError, OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self.start(context, import_scan(context, paths, selection, unit))

    noun = "points"

    def finish(self, result):
        ob, warnings = result
        ob.pointsplat.shape = self.shape
        reach(bpy.context, [ob])
        for warning in warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{ob.name}: {len(ob.data.points):,} points")

    def _import_sequence(self, context: Any, path: Path) -> set[str]:
        try:
            ob, warnings = import_sequence(context, path)
        except (PointFileError, OSError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "There is not enough memory for the points")
            return {"CANCELLED"}
        for warning in warnings:
            self.report({"WARNING"}, f"{ob.name}: {warning}")
        return {"FINISHED"}

    def _attributes(self) -> frozenset[str] | None:
        kept = {"NONE": (), "LOOK": ("color", "alpha", "intensity", "normal", "classification", "radius")}
        return frozenset(kept[self.attributes]) if self.attributes in kept else None

    def _box(self) -> Any:
        return (tuple(self.box_low), tuple(self.box_high)) if self.use_box else None

    def _classes(self) -> frozenset[int] | None:
        return class_numbers(self.classes) or None

    def _unit(self, path: Path) -> float:
        if not self.use_unit:
            return 1.0
        reader = open_points(path)
        try:
            return unit_of(reader.header.crs)
        finally:
            reader.close()


def _draw_columns(layout: bpy.types.UILayout, filepath: str) -> None:
    """What the columns of a text file are taken for."""
    path = Path(bpy.path.abspath(filepath)) if filepath else None
    if path is None or path.suffix.lower() not in (".xyz", ".txt", ".asc", ".csv", ".pts") or not path.is_file():
        return
    from ...formats.points.text.table import guess

    try:
        layout.label(text=f"Columns: {guess(path)}")
    except (PointFileError, OSError) as error:
        layout.label(text=str(error), icon="ERROR")


class POINTSPLAT_FH_points(bpy.types.FileHandler):
    bl_idname = "POINTSPLAT_FH_points"
    bl_label = "Point Cloud"
    bl_import_operator = IMPORTED
    bl_file_extensions = ";".join((*ENDS, ".json", ".js"))

    @classmethod
    def poll_drop(cls, context):
        return context.area is not None and context.area.type == "VIEW_3D"


class POINTSPLAT_OT_scan_look(bpy.types.Operator):
    """Give the scan a material that shows one of its attributes"""

    bl_idname = "pointsplat.scan_look"
    bl_label = "Scan Look"
    bl_options = {"REGISTER", "UNDO"}

    look: EnumProperty(
        name="Look",
        description="What the points show",
        items=[(key, label, tip) for key, (_, _, label, tip) in looks.LOOKS.items()],
        default="COLOR",
    )
    attribute: StringProperty(name="Attribute", description="The attribute that is shown", default="")
    lit: BoolProperty(
        name="Lit", description="Lights and shadows fall on the points; otherwise they emit", default=True
    )

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "POINTCLOUD"

    def execute(self, context):
        ob = context.object
        name = self.attribute if self.look == "ATTRIBUTE" else looks.LOOKS[self.look][0]
        if name is not None and name not in ob.data.attributes:
            self.report({"ERROR"}, f'{ob.name} has no attribute "{name}"')
            return {"CANCELLED"}
        made = looks.look_material(ob, self.look, self.attribute, self.lit)
        if len(ob.data.materials):
            ob.data.materials[0] = made
        else:
            ob.data.materials.append(made)
        return {"FINISHED"}


class POINTSPLAT_OBJECT_PT_scan(bpy.types.Panel):
    bl_label = "Scan"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "object"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "POINTCLOUD" and ORIGIN in context.object

    def draw(self, context):
        ob, layout = context.object, self.layout
        column = layout.column(align=True)
        column.label(text=f"{len(ob.data.points):,} points")
        for axis, value in zip("XYZ", ob[ORIGIN], strict=True):
            column.label(text=f"Map {axis} of the origin: {value:,.3f}")
        flow = layout.grid_flow(columns=3, align=True)
        for key in looks.available(ob.data):
            if key != "ATTRIBUTE":
                flow.operator("pointsplat.scan_look", text=looks.LOOKS[key][2]).look = key
        layout.operator("pointsplat.scan_look", text="By Attribute").look = "ATTRIBUTE"
        if ob.pointsplat.scan_path:
            layout.prop(ob.pointsplat, "scan_path")
            layout.label(text="Points are picked in a 3D view: View, Pick Point")


def _menu(self: Any, _context: bpy.types.Context) -> None:
    self.layout.operator(IMPORTED, text=f"Point Cloud ({', '.join(e[1:] for e in ENDS[:5])}, ...)")


CLASSES = (
    POINTSPLAT_OT_import_points,
    POINTSPLAT_FH_points,
    POINTSPLAT_OT_scan_look,
    POINTSPLAT_OBJECT_PT_scan,
)


def register() -> None:
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
