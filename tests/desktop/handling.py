"""What an artist does in a Rendered viewport besides turning it: hides, edits, splits, looks from within."""

import bpy
from mathutils import Quaternion
from orbit import Meter, rest
from window import check, difference, shoot, viewport

SAME = 0.001  # mean difference of two pictures of one scene in one view; measured: 0
OTHER = 0.002  # of what an artist sees change at once; a hidden monkey: 0.004
TECHNIQUES = "VISIBILITY", "IMAGE_SPACE", "EWA", "PAINTER"


def handling(folder):
    """The scene of run.py: a cube, a monkey, a plane."""
    _, area, _, space = viewport()
    # What Blender itself draws over a view changes with its mode.
    bare(space, True)
    view, meter = space.region_3d, Meter()
    try:
        bpy.ops.object.select_all(action="DESELECT")
        yield from rest(meter, area)
        before = shoot(folder, "handled")
        yield from shading(folder, meter, before)
        yield from hiding(folder, meter, before)
        yield from editing(folder, meter, before)
        yield from techniques(folder, meter, before)
        yield from splitting(folder, meter, before)
        meter.tell_longest("from Solid to areas that are split")
        # From within the monkey, and along an axis in parallel.
        kept = view.view_location.copy(), view.view_distance, view.view_rotation.copy()
        view.view_location, view.view_distance = bpy.data.objects["Monkey"].location, 0.05
        yield from rest(meter, area)
        check(difference(before, shoot(folder, "within")) > OTHER, "a view from within a mesh is drawn")
        meter.tell_longest("from within a mesh of points")
        view.view_location, view.view_distance, _ = kept
        view.view_perspective, view.view_rotation = "ORTHO", Quaternion((0.7071, 0.7071, 0, 0))
        yield from rest(meter, area)
        check(difference(before, shoot(folder, "front")) > OTHER, "a view along an axis is drawn")
        view.view_perspective, view.view_rotation = "PERSP", kept[2]
        yield from rest(meter, area)
        check(difference(before, shoot(folder, "handled_back")) < SAME, "back in its place, the view is as before")
    finally:
        meter.end()
        bare(space, False)


def bare(space, on):
    space.overlay.show_overlays = space.show_gizmo = not on
    space.show_region_toolbar = space.show_region_header = space.show_region_tool_header = not on


def shading(folder, meter, before):
    """Solid and back again."""
    _, area, _, space = viewport()
    for kind in ("SOLID", "RENDERED"):
        space.shading.type = kind
        area.tag_redraw()
        yield 1.0
    yield from rest(meter, area)
    check(difference(before, shoot(folder, "solid_and_back")) < SAME, "from Solid, Rendered comes back as it was")


def hiding(folder, meter, before):
    """An object hidden in the viewport, and local view of one."""
    window, area, region, _ = viewport()
    monkey = bpy.data.objects["Monkey"]
    for hidden, name in ((True, "hidden"), (False, "shown")):
        monkey.hide_set(hidden)
        yield from rest(meter, area)
        seen = difference(before, shoot(folder, name))
        check(seen > OTHER if hidden else seen < SAME, f"an object that is {name} is so in the viewport")
    monkey.select_set(True)
    bpy.context.view_layer.objects.active = monkey
    for name in ("local", "global"):
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.view3d.localview(frame_selected=False)
        yield from rest(meter, area)
        seen = difference(before, shoot(folder, name))
        check(seen > OTHER if name == "local" else seen < SAME, f"the viewport follows into {name} view")
    monkey.select_set(False)


def editing(folder, meter, before):
    """A mesh that is edited, and undone."""
    window, area, region, _ = viewport()
    cube = bpy.data.objects["Cube"]
    bpy.context.view_layer.objects.active = cube
    override = {"window": window, "area": area, "region": region}
    with bpy.context.temp_override(**override):
        bpy.ops.ed.undo_push(message="before editing")
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
    yield from rest(meter, area)
    check(difference(before, shoot(folder, "editing")) < SAME, "a mesh in edit mode is drawn as it is")
    with bpy.context.temp_override(**override):
        bpy.ops.transform.resize(value=(1, 1, 1.8))
    yield from rest(meter, area)
    check(difference(before, shoot(folder, "edited")) > OTHER, "the viewport follows what is edited")
    with bpy.context.temp_override(**override):
        bpy.ops.transform.resize(value=(1, 1, 1 / 1.8))
        bpy.ops.object.mode_set(mode="OBJECT")
        bpy.ops.object.select_all(action="DESELECT")
    yield from rest(meter, area)
    check(difference(before, shoot(folder, "edited_back")) < SAME, "a mesh that is edited back is drawn as before")


def techniques(folder, meter, before):
    _, area, _, _ = viewport()
    settings = bpy.context.scene.pointsplat
    kept = settings.technique
    for name in TECHNIQUES:
        settings.technique = name
        yield from rest(meter, area)
        check(difference(before, shoot(folder, f"by_{name.lower()}")) < 0.02, f"{name} shows the same scene")
    settings.technique = kept
    yield from rest(meter, area)
    check(difference(before, shoot(folder, "by_own")) < SAME, "with its technique, the view is as before")


def splitting(folder, meter, before):
    """The area split in two: each shows the scene in its own shape."""
    window, area, region, _ = viewport()
    before_split = {a.as_pointer() for a in window.screen.areas}
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    yield from rest(meter, area)
    yield 3.0
    split = shoot(folder, "split")
    colors = {tuple(round(c * 15) for c in pixel) for row in split for pixel in row}
    check(len(colors) > 12, "a split area shows the scene")
    other = next(a for a in window.screen.areas if a.as_pointer() not in before_split)
    with bpy.context.temp_override(window=window, area=other):
        bpy.ops.screen.area_close()
    yield from rest(meter, viewport()[1])
    check(difference(before, shoot(folder, "joined")) < SAME, "an area that is whole again shows what it showed")
