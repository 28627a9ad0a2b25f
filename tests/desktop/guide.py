"""The pictures of docs/guide/scans.md: from a .laz file to a lit picture, taken in the window."""

import math
import subprocess

import bpy
from files import dropped, empty_scene
from mathutils import Euler, Vector
from orbit import Meter, rest
from window import save_picture, viewport

PARENT = "POINTSPLAT_OBJECT_PT_pointsplat"
OPENED = "POINTSPLAT_OBJECT_PT_filters", "POINTSPLAT_OBJECT_PT_scan"


def guide(folder, path):
    """The dialogue over an empty view; the object's panels beside the scan; the final picture."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    override = empty_scene()
    with bpy.context.temp_override(**override):
        dropped(path)
    yield 1.0
    subprocess.run(["xdotool", "mousemove_relative", "--", "-170", "70"], check=True)  # away from what has a tooltip
    yield 0.3
    save_picture(folder / "guide_dialogue.png")
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    override = empty_scene()
    with bpy.context.temp_override(**override):
        bpy.ops.pointsplat.import_points("EXEC_DEFAULT", filepath=str(path))
        bpy.ops.view3d.view_selected()
        bpy.ops.pointsplat.add_point_filter(kind="CLASS")
    ob = bpy.context.object
    ob.pointsplat.filters[0].classes, ob.pointsplat.filters[0].invert = "7", True
    sky()
    camera_over(ob)
    open_panels()
    before = {area.as_pointer() for area in override["window"].screen.areas}
    with bpy.context.temp_override(**override):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.62)
    beside = next(area for area in override["window"].screen.areas if area.as_pointer() not in before)
    beside.type = "PROPERTIES"
    beside.spaces.active.context = "OBJECT"
    yield 1.0
    meter = Meter()
    try:
        viewport()[3].region_3d.view_perspective = "CAMERA"
        yield from rest(meter, viewport()[1])
    finally:
        meter.end()
    save_picture(folder / "guide_panels.png")
    bpy.ops.render.render()
    bpy.data.images["Render Result"].save_render(str(folder / "guide_result.png"))


def sky():
    sun = next(ob for ob in bpy.context.scene.objects if ob.type == "LIGHT")
    sun.data.energy, sun.data.angle, sun.data.color = 4.0, math.radians(0.5), (1.0, 0.93, 0.82)
    sun.rotation_euler = (math.radians(55), 0.0, math.radians(-60))
    background = bpy.context.scene.world.node_tree.nodes["Background"].inputs
    background["Color"].default_value, background["Strength"].default_value = (0.25, 0.5, 1.0, 1.0), 0.45


def camera_over(ob):
    """The scene's camera above a corner of an object, with all of it in front."""
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    bpy.context.view_layer.update()
    corners = [ob.matrix_world @ Vector(corner) for corner in ob.bound_box]
    middle, size = sum(corners, Vector()) / 8, ob.dimensions.length
    camera.rotation_euler = Euler((math.radians(66), 0.0, math.radians(25)))
    camera.location = middle + camera.rotation_euler.to_matrix() @ Vector((0.0, 0.0, 0.42 * size))
    camera.data.clip_end, camera.data.lens = 4 * size, 30.0
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = 800, 450


def open_panels():
    """This add-on's panels of a scan without Blender's above them, and open: nothing but a mouse opens one."""
    panels = [kind for kind in bpy.types.Panel.__subclasses__() if getattr(kind, "bl_context", "") == "object"]
    for kind in panels:
        if kind.__module__.startswith("bl_ui") and kind.is_registered:
            bpy.utils.unregister_class(kind)
    own = [kind for kind in panels if kind.__name__ in (PARENT, *OPENED) or getattr(kind, "bl_parent_id", "") == PARENT]
    own.sort(key=lambda kind: kind.__name__ != PARENT)
    for kind in reversed(own):
        bpy.utils.unregister_class(kind)
        if kind.__name__ in OPENED:
            kind.bl_options = set()
    for kind in own:
        bpy.utils.register_class(kind)
