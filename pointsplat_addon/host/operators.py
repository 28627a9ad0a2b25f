"""Operators."""

from pathlib import Path

import bpy
from bpy.props import FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..formats import dense, hierarchy_cache, vdb
from ..render.device import DeviceError
from . import caches, device_costs, gl_thread, main_gpu, preferences
from .convert.volume import load_openvdb

OPTICAL_DEPTH = 10.0  # across an imported volume where the ramp's alpha is one: the inside shows, and is not flat


class POINTSPLAT_OT_clear_cache(bpy.types.Operator):
    """Forget converted geometry and delete the cache's files; the next picture makes them anew"""

    bl_idname = "pointsplat.clear_cache"
    bl_label = "Clear Cache"

    def execute(self, _context):
        folder = preferences.cache_folder()
        freed = hierarchy_cache.trim(folder, 0) if folder else 0
        caches.release()
        self.report({"INFO"}, f"PointSplat's cache is cleared, {freed / 1e6:.1f} MB deleted")
        return {"FINISHED"}


class POINTSPLAT_OT_calibrate(bpy.types.Operator):
    """Measure how fast the device draws points and triangles; which parts of meshes are points follows from it"""

    bl_idname = "pointsplat.calibrate"
    bl_label = "Calibrate"

    def execute(self, _context):
        own = gl_thread.available()
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


def _stem(path: Path) -> str:
    name = path.name
    return name[: -len(".nii.gz")] if name.lower().endswith(".nii.gz") else path.stem


def _unused(source: Path) -> Path:
    """A path for an OpenVDB file that is not there yet."""
    folder = Path(bpy.data.filepath).parent if bpy.data.filepath else source.parent
    target, number = folder / f"{_stem(source)}.vdb", 0
    while target.exists():
        number += 1
        target = folder / f"{_stem(source)}.{number:03d}.vdb"
    return target


def _ramp(name: str) -> bpy.types.Texture:
    texture = bpy.data.textures.new(f"{name} Transfer", "BLEND")
    texture.use_color_ramp = True
    return texture


def import_menu(menu, _context):
    menu.layout.operator(POINTSPLAT_OT_import_volume.bl_idname, text="Volume for PointSplat (.npy, .nii)")


CLASSES = (POINTSPLAT_OT_clear_cache, POINTSPLAT_OT_calibrate, POINTSPLAT_OT_transfer_ramp, POINTSPLAT_OT_import_volume)


def register() -> None:
    bpy.types.TOPBAR_MT_file_import.append(import_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(import_menu)
