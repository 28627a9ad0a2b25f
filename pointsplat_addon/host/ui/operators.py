"""Operators: clearing the cache, calibration, imports, and strands from meshes."""

from pathlib import Path

import bmesh
import bpy
import numpy as np
from bpy.props import FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ...core.numeric.segments import ranges
from ...core.strand.curves import FREE
from ...core.strand.fit.from_mesh import fit_strands
from ...core.strand.fit.result import FittedStrands
from ...formats.volumes import dense, vdb
from ...render.device.protocol import DeviceError
from .. import caches, disk_cache
from ..convert import arrays
from ..convert.strands.curves_objects import SURFACE_UV
from ..convert.volume import load_openvdb
from ..device import device_costs, gl_thread, libraries, main_gpu
from . import preferences

OPTICAL_DEPTH = 10.0  # across an imported volume where the ramp's alpha is one: the inside shows, and is not flat


class POINTSPLAT_OT_clear_cache(bpy.types.Operator):
    """Forget converted geometry and delete the cache's files; the next picture makes them anew"""

    bl_idname = "pointsplat.clear_cache"
    bl_label = "Clear Cache"

    def execute(self, _context):
        freed = disk_cache.free(preferences.cache_folder(), 0)
        caches.release()
        self.report({"INFO"}, f"PointSplat's cache is cleared, {freed / 1e6:.1f} MB deleted")
        return {"FINISHED"}


class POINTSPLAT_OT_calibrate(bpy.types.Operator):
    """Measure how fast the device draws points and triangles in image space, which decides what is points there"""

    bl_idname = "pointsplat.calibrate"
    bl_label = "Calibrate"

    def execute(self, _context):
        own = libraries.has_moderngl()
        job = gl_thread.THREAD.submit(device_costs.measure) if own else main_gpu.run(device_costs.measure, False)
        try:
            costs = job.result()
        except (DeviceError, ImportError) as error:
            self.report({"ERROR"}, f"The device cannot be calibrated: {error}")
            return {"CANCELLED"}
        device_costs.write()
        self.report({"INFO"}, f"A point takes {costs.point:.0f} ns, a triangle {costs.triangle:.0f} ns")
        return {"FINISHED"}


class POINTSPLAT_OT_transfer_ramp(bpy.types.Operator):
    """Give the volume a colour ramp of its own"""

    bl_idname = "pointsplat.transfer_ramp"
    bl_label = "New Colour Ramp"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "VOLUME"

    def execute(self, context):
        context.object.pointsplat.transfer_texture = _ramp(context.object.name)
        return {"FINISHED"}


class POINTSPLAT_OT_import_volume(bpy.types.Operator, ImportHelper):
    """Make a Volume object of a three-dimensional array (.npy) or a scan (.nii, .nii.gz), by way of an OpenVDB file"""

    bl_idname = "pointsplat.import_volume"
    bl_label = "Import Volume"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default="*.npy;*.nii;*.nii.gz", options={"HIDDEN"})
    size: FloatProperty(
        name="Size",
        description="Length of the longest side; zero keeps the file's own measures",
        default=2.0,
        min=0.0,
        subtype="DISTANCE",
    )
    threshold: FloatProperty(
        name="Threshold",
        description="Share of the range of values, from the lowest, up to which voxels are left out",
        default=0.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    output: StringProperty(
        name="OpenVDB File",
        description="The file that is written; empty chooses one beside the blend file, or beside the imported file",
        subtype="FILE_PATH",
    )

    def execute(self, context):
        source = Path(bpy.path.abspath(self.filepath))
        try:
            found = dense.read(source)
            value, low, high = dense.without_background(found.value, self.threshold)
            matrix = dense.centred(found, self.size) if self.size > 0 else found.object_from_index
            target = Path(bpy.path.abspath(self.output)) if self.output else _unused(source)
            vdb.write(load_openvdb(), target, "density", value, matrix, low)
        except (OSError, ValueError, ImportError) as error:
            self.report({"ERROR"}, f"{source.name}: {error}")
            return {"CANCELLED"}
        data = bpy.data.volumes.new(_stem(source))
        data.filepath = bpy.path.relpath(str(target)) if bpy.data.filepath else str(target)
        ob = bpy.data.objects.new(data.name, data)
        context.collection.objects.link(ob)
        ob.pointsplat.use_transfer = True
        ob.pointsplat.transfer_texture = _ramp(ob.name)
        ob.pointsplat.transfer_low, ob.pointsplat.transfer_high = low + self.threshold * (high - low), high
        side = max(abs(matrix[:3, :3]).sum(axis=1) * value.shape)
        ob.pointsplat.transfer_density = OPTICAL_DEPTH / side
        for other in context.selected_objects:
            other.select_set(False)
        context.view_layer.objects.active = ob
        ob.select_set(True)
        return {"FINISHED"}


class POINTSPLAT_OT_mesh_to_strands(bpy.types.Operator):
    """Turn branches and leaves of the mesh into strands: rings of vertices become tubes, and rows of triangles and flat
    parts ribbons. What has no such structure stays in the mesh"""

    bl_idname = "pointsplat.mesh_to_strands"
    bl_label = "Mesh to Strands"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "MESH" and context.object.mode == "OBJECT"

    def execute(self, context):
        ob = context.object
        if ob.data.users > 1:
            ob.data = ob.data.copy()
        mesh = ob.data
        mesh.calc_loop_triangles()
        triangles = arrays.read(mesh.loop_triangles, "vertices", 3, np.int32)
        polygon = arrays.read(mesh.loop_triangles, "polygon_index", 1, np.int32)
        position = arrays.read(mesh.vertices, "co", 3, np.float32)
        found = fit_strands(position, triangles)
        if len(found) == 0:
            self.report({"WARNING"}, f"{ob.name}: none of {found.parts} parts is a branch or a leaf")
            return {"CANCELLED"}
        slot = arrays.read(mesh.polygons, "material_index", 1, np.int32)[polygon[found.triangle]]
        uv = None
        if mesh.uv_layers.active:
            corners = arrays.read(mesh.loop_triangles, "loops", 3, np.int32)[found.triangle]
            uv = arrays.read(mesh.uv_layers.active.uv, "vector", 2, np.float32)[corners].mean(axis=1)
        for ribbon, kind in ((False, "Tubes"), (True, "Ribbons")):
            for material in np.unique(slot[found.ribbon == ribbon]):
                part = np.flatnonzero((found.ribbon == ribbon) & (slot == material))
                data = _curves(f"{ob.name} {kind}", found, part, uv)
                if len(ob.material_slots):
                    data.materials.append(ob.material_slots[min(material, len(ob.material_slots) - 1)].material)
                made = bpy.data.objects.new(data.name, data)
                ob.users_collection[0].objects.link(made)
                made.parent, made.pointsplat.ribbons = ob, ribbon
        _keep_polygons(mesh, np.unique(polygon[found.remaining]))
        ribbons = int(found.ribbon.sum())
        self.report(
            {"INFO"},
            f"{ob.name}: {len(found) - ribbons} tubes, {ribbons} ribbons, "
            f"{found.remaining_parts} of {found.parts} parts stay polygons",
        )
        return {"FINISHED"}


def _curves(name: str, found: FittedStrands, part: np.ndarray, uv: np.ndarray | None) -> bpy.types.Curves:
    """A Curves data block with the strands `part`, given by their indices. uv: (N, 2) of all strands, or None."""
    count = np.diff(found.start)[part]
    points = ranges(found.start[part], count)
    data = bpy.data.hair_curves.new(name)
    data.add_curves(count.tolist())
    data.set_types(type="POLY")
    data.position_data.foreach_set("vector", found.position[points].astype(np.float32).ravel())

    def attribute(label: str, kind: str, domain: str, key: str, values: np.ndarray) -> None:
        made = data.attributes.get(label) or data.attributes.new(label, kind, domain)
        made.data.foreach_set(key, values.ravel())

    attribute("radius", "FLOAT", "POINT", "value", found.radius[points].astype(np.float32))
    if uv is not None:
        attribute(SURFACE_UV, "FLOAT2", "CURVE", "vector", uv[part].astype(np.float32))
    if found.ribbon[part[0]]:
        attribute("normal_mode", "INT8", "CURVE", "value", np.full(len(part), FREE, np.int32))
        attribute("custom_normal", "FLOAT_VECTOR", "POINT", "vector", found.normal[points].astype(np.float32))
    return data


def _keep_polygons(mesh: bpy.types.Mesh, kept: np.ndarray) -> None:
    edited = bmesh.new()
    edited.from_mesh(mesh)
    stays = np.zeros(len(edited.faces), bool)
    stays[kept] = True
    faces = [face for face, stay in zip(edited.faces, stays.tolist(), strict=True) if not stay]
    bmesh.ops.delete(edited, geom=faces, context="FACES")
    edited.to_mesh(mesh)
    edited.free()
    mesh.update()


def _stem(path: Path) -> str:
    """The name of a file without its extension, .nii.gz included."""
    name = path.name
    return name[: -len(".nii.gz")] if name.lower().endswith(".nii.gz") else path.stem


def _unused(source: Path) -> Path:
    """A path for a new OpenVDB file, beside the blend file or else beside `source`."""
    folder = Path(bpy.data.filepath).parent if bpy.data.filepath else source.parent
    target, number = folder / f"{_stem(source)}.vdb", 0
    while target.exists():
        number += 1
        target = folder / f"{_stem(source)}.{number:03d}.vdb"
    return target


def _ramp(name: str) -> bpy.types.Texture:
    """A new texture with a colour ramp for a transfer function."""
    texture = bpy.data.textures.new(f"{name} Transfer", "BLEND")
    texture.use_color_ramp = True
    return texture


def import_menu(menu, _context):
    """Draw the entries of the menu File > Import."""
    menu.layout.operator(POINTSPLAT_OT_import_volume.bl_idname, text="Volume for PointSplat (.npy, .nii)")


def convert_menu(menu, _context):
    """Draw the entries of the menu Object > Convert."""
    menu.layout.operator(POINTSPLAT_OT_mesh_to_strands.bl_idname)


CLASSES = (
    POINTSPLAT_OT_clear_cache,
    POINTSPLAT_OT_calibrate,
    POINTSPLAT_OT_transfer_ramp,
    POINTSPLAT_OT_import_volume,
    POINTSPLAT_OT_mesh_to_strands,
)


def register() -> None:
    bpy.types.TOPBAR_MT_file_import.append(import_menu)
    bpy.types.VIEW3D_MT_object_convert.append(convert_menu)


def unregister() -> None:
    bpy.types.VIEW3D_MT_object_convert.remove(convert_menu)
    bpy.types.TOPBAR_MT_file_import.remove(import_menu)
