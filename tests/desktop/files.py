"""Files of every format, as a person brings them into a window: chosen, confirmed, cancelled, drawn, undone."""

import math
import os
import shutil
import subprocess
import time

import bpy
from mathutils import Euler
from orbit import Meter, rest
from window import check, difference, save_picture, say, shoot, viewport

SEEN = 0.003  # of what a file adds to an empty view; measured: 0.009 at least, of ten points
SAME = 0.001  # of the empty view before and after; measured: 0
SCANS = {  # a file of each format, and how many points it says that it has, or its lines
    "points/pdal_las/autzen-bmx-2023.las": 687,
    "points/pdal_autzen_trim.laz": 110_000,
    "points/pdal_las_with_several_extra_byte_bloc.laz": 697_721,
    "points/potree_lion_takanawa.copc.laz": 341_989,
    "points/pdal_ept/lone-star-laszip/ept.json": 518_862,
    "points/potree1_lion_takanawa/cloud.js": 272_768,
    "points/pye57_pumpAVisualReferenceImage.e57": 155_201,
    "points/cgal_building.ply": 100_000,
    "points/pcl_milk_cartoon_all_small_clorox.pcd": 307_200 - 65_793,  # without those that are no numbers
    "points/pdal_text/autzen.pts": 10,
    "points/pdal_text/1.2-with-color.ptx": 1_065,
    "points/pdal_text/utm17_1.txt": 10,
    "points/pdal_text/autzen-bmx-cc.txt": 103,
}
SPLATS = {
    "splat/donut_inria_fused.ply": 45_624,
    "splat/playcanvas_guitar.compressed.ply": 90_854,
    "splat/playcanvas_biker.spz": 152_746,
    "splat/pdal_fourth_st.spz": 131_199,
    "splat/playbot_sog/lod-meta.json": 125_000,
    "splat/minimal/minimal-v4.spz": 4,
    "splat/minimal/minimal.splat": 4,
    "splat/minimal/minimal.ksplat": 4,
}


def files(folder, data, only=""):
    """Each file of the folder `data` alone in the view, lit by a sun; `only`: those whose path has this in it."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0  # the new window is there
    override = empty_scene()
    meter = Meter()
    try:
        yield from rest(meter, override["area"])
        empty = shoot(folder, "nothing")
        for table, operator in ((SCANS, "import_points"), (SPLATS, "import_splats")):
            for name, count in table.items():
                if only not in name:
                    continue
                if not (data / name).exists():
                    say(f"left out: {name}, which is not in {data}")
                    continue
                yield from one(folder, meter, override, operator, data / name, count, empty)
        if only in "dialogue" and (data / "points/pdal_autzen_trim.laz").exists():
            yield from dialogue(folder, override, data / "points/pdal_autzen_trim.laz", 110_000)
            yield from cancelled(override, data / "points/pdal_las_with_several_extra_byte_bloc.laz")
    finally:
        meter.end()


def empty_scene():
    """A sun over nothing, in the Rendered viewport; what operators are called with."""
    window, area, region, space = viewport()
    scene = bpy.context.scene
    scene.render.engine = "POINTSPLAT"
    bpy.context.preferences.view.smooth_view = 0
    for name in ("Cube", "Light"):
        bpy.data.objects.remove(bpy.data.objects[name])
    override = {"window": window, "area": area, "region": region}
    with bpy.context.temp_override(**override):
        bpy.ops.object.light_add(type="SUN", rotation=(0.6, 0.3, 0.4))
        bpy.context.object.data.energy = 3.0
        bpy.ops.object.select_all(action="DESELECT")
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.35, 0.4, 1)
    space.overlay.show_overlays = space.show_gizmo = space.show_region_toolbar = False
    space.region_3d.view_perspective = "PERSP"
    space.region_3d.view_rotation = Euler((math.radians(62), 0, math.radians(30))).to_quaternion()
    space.shading.type = "RENDERED"
    bpy.ops.ed.undo_push(message="an empty scene")
    return override


def one(folder, meter, override, operator, path, count, empty):
    _, area, _, space = viewport()
    view = space.region_3d
    name = f"{path.parent.name}_{path.name}".replace(".", "_")
    with bpy.context.temp_override(**override):
        result = getattr(bpy.ops.pointsplat, operator)("EXEC_DEFAULT", True, filepath=str(path))
    ob = bpy.context.object
    check(result == {"FINISHED"} and len(ob.data.points) == count, f"{path.name} has {count:,} points")
    with bpy.context.temp_override(**override):
        bpy.ops.view3d.view_selected()
    yield from rest(meter, area)
    check(difference(empty, shoot(folder, name)) > SEEN, f"{path.name} is seen in the viewport")
    view.view_distance *= 0.35
    yield from rest(meter, area)
    shoot(folder, f"{name}_near")
    meter.tell_longest(path.name)
    with bpy.context.temp_override(**override):
        bpy.ops.ed.undo()
    scene = bpy.context.scene
    check("crs x" not in scene and not bpy.data.pointclouds and len(scene.objects) == 2, f"undo takes {path.name} back")
    yield from rest(meter, area)
    check(difference(empty, shoot(folder, "nothing_again")) < SAME, "the viewport is empty again")


def dropped(path):
    """Begins the import as a file that is dropped onto the viewport begins it: with its dialogue."""
    bpy.ops.pointsplat.import_points(
        "INVOKE_DEFAULT", filepath=str(path), directory=str(path.parent), files=[{"name": path.name}]
    )


def press(*keys):
    if not (os.environ.get("DISPLAY") and shutil.which("xdotool")):
        return False
    subprocess.run(["xdotool", "key", *keys], check=True)
    return True


def dialogue(folder, override, path, count):
    """The dialogue of the import, confirmed by a key; the points are then read beside the window."""
    with bpy.context.temp_override(**override):
        dropped(path)
    yield 1.0
    save_picture(folder / "dialogue.png")
    if not press("Return"):
        say("left out: the dialogue (no xdotool on this screen)")
        return
    ticks, began = 0, time.monotonic()
    while not bpy.data.pointclouds and time.monotonic() - began < 60:
        ticks += 1
        yield 0.02
    yield 0.5
    check(bool(bpy.data.pointclouds) and len(bpy.data.pointclouds[0].points) == count, "the dialogue imports the file")
    check(ticks > 1, "the window is alive meanwhile")
    with bpy.context.temp_override(**override):
        bpy.ops.ed.undo()
    check(not bpy.data.pointclouds, "undo takes back what the dialogue imported")


def cancelled(override, path):
    """Esc while points are read."""
    with bpy.context.temp_override(**override):
        dropped(path)
    yield 1.0
    if not press("Return"):
        return
    yield 0.3
    press("Escape")
    yield 3.0
    check(not bpy.data.pointclouds and "crs x" not in bpy.context.scene, "Esc cancels the import and leaves nothing")
