"""Drive the add-on inside a desktop Blender with a window; the exit status tells whether all went well.

    blender --factory-startup --python tests/desktop/run.py [-- --zip dist/pointsplat-0.1.0.zip] [--output out/desktop]
        [--scene FILE.blend [--full]] [--data FOLDER [--only TEXT]] [--guide FILE.laz] [--parts orbit views ...]
        [--limit SECONDS]

Facts decide the exit status; times are printed as figures, because they are the machine's.
Without --zip the checkout is registered as it lies. With --scene, a file is orbited in the Rendered viewport, and that
is all (`python -m scripts.demos.translucent --scene outdoor` makes one that mixes everything). With --data, files of
every format in points/ and splat/ of a folder are imported, drawn and undone, and that is all. Pictures of the window
go to the output folder. Under X11, xdotool presses keys and ImageMagick takes the pictures; without xdotool, keys are
left out, and said so.
"""

import argparse
import faulthandler
import importlib
import math
import os
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path

import bpy
from mathutils import Euler, Quaternion

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender runs this file alone
from files import files
from guide import guide
from handling import handling
from orbit import Meter, orbit_file, rest
from window import check, difference, problems, save_picture, say, shoot, viewport

ROOT = Path(__file__).resolve().parents[2]
EXTENSION = "bl_ext.user_default.pointsplat"
NEED_BEFORE = "off", "undo", "load"  # parts that come back to how the viewport was

events = {"complete": 0, "cancel": 0}


def arguments():
    parser = argparse.ArgumentParser(prog="run.py")
    parser.add_argument("--zip", type=Path, help="install this archive instead of registering the checkout")
    parser.add_argument("--scene", type=Path, help="orbit this file instead of telling the whole story")
    parser.add_argument("--full", action="store_true", help="--scene fills the window, with pixels as at rest")
    parser.add_argument("--parts", nargs="+", help="tell only these parts of the story")
    parser.add_argument("--data", type=Path, help="a folder of scans and captures: import these, and that is all")
    parser.add_argument("--only", default="", help="of --data: files whose path has this in it")
    parser.add_argument("--guide", type=Path, help="a .laz file: take the guide's pictures of it, and that is all")
    parser.add_argument("--limit", type=float, default=600, help="seconds until a hang is taken for one")
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "desktop")
    argv = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    return parser.parse_args(argv)


# ---------------------------------------------------------------------------- the add-on


def enable(archive):
    if archive is None:
        importlib.import_module("pointsplat_addon").register()
    else:
        importlib.import_module("addon_utils").enable(EXTENSION, default_set=True)


def disable(archive):
    if archive is None:
        importlib.import_module("pointsplat_addon").unregister()
    else:
        importlib.import_module("addon_utils").disable(EXTENSION, default_set=True)


def install(archive):
    if archive is None:
        sys.path.insert(0, str(ROOT))
        enable(None)
    else:
        bpy.ops.extensions.package_install_files(
            repo="user_default", filepath=str(archive.resolve()), enable_on_install=True
        )


def registered():
    classes = bpy.types.RenderEngine.__subclasses__()
    return any(getattr(c, "bl_idname", "") == "POINTSPLAT" and c.is_registered for c in classes)


def press_escape():
    """Press the key as a person does; False where xdotool is missing."""
    if not (os.environ.get("DISPLAY") and shutil.which("xdotool")):
        return False
    subprocess.run(["xdotool", "key", "Escape"], check=True)
    return True


# ---------------------------------------------------------------------------- the scene


def fill_scene():
    """The start-up cube as polygons, a dense monkey as points, on a plane."""
    scene = bpy.context.scene
    scene.render.engine = "POINTSPLAT"
    scene.pointsplat.use_indirect = False  # one part looks at it
    bpy.ops.mesh.primitive_plane_add(size=9, location=(0, 0, -1))
    bpy.ops.mesh.primitive_monkey_add(size=2, location=(2.4, -1.2, 0.2))
    monkey = bpy.context.object
    monkey.name = "Monkey"
    monkey.modifiers.new("Subdivision", "SUBSURF").levels = 3
    monkey.modifiers["Subdivision"].render_levels = 3
    monkey.pointsplat.primitive = "POINTS"
    look = bpy.data.materials.new("Orange")
    look.use_nodes = True
    look.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.9, 0.25, 0.05, 1)
    monkey.data.materials.append(look)
    scene.render.resolution_x, scene.render.resolution_y = 640, 360
    bpy.ops.object.select_all(action="DESELECT")


def watch_renders():
    @bpy.app.handlers.persistent
    def complete(*_):
        events["complete"] += 1

    @bpy.app.handlers.persistent
    def cancel(*_):
        events["cancel"] += 1

    bpy.app.handlers.render_complete.append(complete)
    bpy.app.handlers.render_cancel.append(cancel)


# ---------------------------------------------------------------------------- the story: each yield waits that long


def orbit(folder):
    _, area, _, space = viewport()
    view = space.region_3d
    pictures = []
    for step in range(24):
        view.view_rotation = Euler((math.radians(60), 0, math.radians(15 * step))).to_quaternion()
        area.tag_redraw()
        yield 0.1
        if step % 6 == 5:
            yield 1.0
            pictures.append(shoot(folder, f"orbit_{step:02d}"))
    for i in range(1, len(pictures)):
        check(difference(pictures[i - 1], pictures[i]) > 0.005, f"the viewport follows the orbit ({i})")


def views(folder):
    _, area, _, space = viewport()
    view = space.region_3d
    view.view_perspective = "ORTHO"
    view.view_rotation = Quaternion((0.7, 0.4, 0.25, 0.5)).normalized()
    area.tag_redraw()
    yield 1.5
    shoot(folder, "orthographic")
    view.view_perspective = "CAMERA"
    area.tag_redraw()
    yield 1.5
    full = shoot(folder, "camera")
    render = bpy.context.scene.render
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.3, 0.6, 0.3, 0.7
    area.tag_redraw()
    yield 1.5
    check(difference(full, shoot(folder, "camera_border")) > 0.002, "the border cuts the camera view")
    render.use_border = False
    view.view_perspective = "PERSP"
    yield 0.5


def lens(folder):
    """Depth of field in camera view, by both methods, and as it follows the focus distance."""
    meter = Meter()
    try:
        yield from blurred(folder, meter)
    finally:
        meter.end()


def blurred(folder, meter):
    _, area, _, space = viewport()
    view = space.region_3d
    scene = bpy.context.scene
    of = scene.camera.data.dof
    view.view_perspective = "CAMERA"
    yield from rest(meter, area)
    sharp = shoot(folder, "lens_off")
    of.use_dof, of.aperture_fstop, of.focus_distance = True, 0.1, 4.0
    yield from rest(meter, area)
    near = shoot(folder, "lens_near")
    check(difference(sharp, near) > 0.004, "depth of field blurs the camera view")
    of.focus_distance = 14.0
    yield from rest(meter, area)
    far = shoot(folder, "lens_far")
    check(difference(near, far) > 0.002, "the blur follows the focus distance")
    settings = scene.pointsplat
    samples_before, settings.viewport_samples = settings.viewport_samples, 32
    settings.dof_method = "LENS_SAMPLES"
    yield from rest(meter, area)
    samples = shoot(folder, "lens_samples")
    alike = difference(far, samples) < difference(sharp, samples) / 2
    check(alike, "both methods show the same blur")
    settings.dof_method, settings.viewport_samples = "SPLAT", samples_before
    yield from final_render(folder, "f12_lens")
    of.use_dof = False
    view.view_perspective = "PERSP"
    area.tag_redraw()
    yield 0.5


def brightness(picture):
    """The mean of the pixels of a picture, in display units from 0 to 1."""
    values = [value for row in picture for pixel in row for value in pixel]
    return sum(values) / len(values)


def indirect(folder):
    """Indirect light comes into a view that stands still, while it can be used, and once more when it has moved."""
    _, area, _, space = viewport()
    settings, meter, view = bpy.context.scene.pointsplat, Meter(), space.region_3d
    background = bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"]
    strength, background.default_value = background.default_value, 10.0  # a sky that can be hidden
    view.view_perspective = "CAMERA"
    try:
        yield from rest(meter, area)
        without = shoot(folder, "indirect_off")
        settings.use_indirect, meter.longest = True, (0.0, 0.0)
        yield from rest(meter, area)
        meter.tell_longest("while indirect light is gathered")
        lit = shoot(folder, "indirect_on")
        check(difference(without, lit) > 0.001, "indirect light comes into a view that stands still")
        for step in range(4):
            view.view_camera_offset = 0.02 * step, 0
            area.tag_redraw()
            yield 0.1
        view.view_camera_offset = 0, 0
        area.tag_redraw()
        yield 0.1
        moving = shoot(folder, "indirect_moving")
        off, gone = brightness(moving) - brightness(lit), brightness(without) - brightness(lit)
        check(abs(off) < abs(gone) / 4, f"and stays while it moves ({off:.4f}; without it: {gone:.4f})")
        yield from rest(meter, area)
        again = difference(lit, shoot(folder, "indirect_again"))
        check(again < difference(without, lit) / 10, "and is gathered again once it has moved")
    finally:
        meter.end()
    settings.use_indirect, background.default_value = False, strength
    view.view_perspective = "PERSP"
    yield 0.5


def budgets(folder):
    """A time for a view that moves, an error for one that stands still and for F12, and where both are told."""
    _, area, _, space = viewport()
    view = space.region_3d
    settings, rotation = bpy.context.scene.pointsplat, view.view_rotation.copy()
    settings.budget, settings.time_budget = "TIME", 80.0
    area.tag_redraw()
    yield 2.0
    began, frames = time.monotonic(), 16
    for step in range(frames):
        view.view_rotation = Euler((math.radians(60), 0, math.radians(200 + 3 * step))).to_quaternion()
        area.tag_redraw()
        yield 0.01
    say(f"figure: {1000 * (time.monotonic() - began) / frames:.0f} ms for each step of a view with 80 ms to draw it in")
    moving = shoot(folder, "budget_time")
    yield 2.0
    settings.budget, settings.error_budget = "ERROR", 0.01
    yield 4.0
    still = shoot(folder, "budget_error")
    check(difference(moving, still) < 0.05, "budgets show the same view")
    yield from final_render(folder, "f12_budget")
    path = str(folder / "f12_budget.png")
    with open(path, "rb") as file:
        check(b"pointsplat/error" in file.read(), "the picture's metadata tells its error")
    # In the large area, where all panels of the tab are seen. Nothing but a mouse opens a panel that begins closed.
    panel = bpy.types.POINTSPLAT_RENDER_PT_last_render
    for options in (set(), {"DEFAULT_CLOSED"}):
        bpy.utils.unregister_class(panel)
        panel.bl_options = options
        bpy.utils.register_class(panel)
        if not options:
            area.type = "PROPERTIES"
            area.spaces.active.context = "RENDER"
            yield 1.0
            save_picture(folder / "last_render.png", area)
            area.type = "VIEW_3D"
    settings.budget, view.view_rotation = "NONE", rotation
    yield 1.0


def final_render(folder, name="f12"):
    ticks = [time.monotonic()]

    def count():
        ticks.append(time.monotonic())
        return 0.02

    bpy.app.timers.register(count)
    done = events["complete"]
    bpy.ops.render.render("INVOKE_DEFAULT")
    while events["complete"] == done and time.monotonic() - ticks[0] < 60:
        yield 0.1
    bpy.app.timers.unregister(count)
    check(events["complete"] == done + 1, "F12 completes")
    pause = max(b - a for a, b in zip(ticks, [*ticks[1:], time.monotonic()], strict=True))
    say(f"figure: the window waits at most {pause:.2f} s for F12")
    bpy.data.images["Render Result"].save_render(str(folder / f"{name}.png"))


def cancelled_render():
    settings = bpy.context.scene.pointsplat
    samples, settings.samples = settings.samples, settings.bl_rna.properties["samples"].hard_max
    done = dict(events)
    bpy.ops.render.render("INVOKE_DEFAULT")
    yield 1.5
    # This line is reached in time only if the window stays alive beside the render.
    check(bpy.app.is_job_running("RENDER"), "the window goes on while a long render runs")
    pressed = time.monotonic()
    if press_escape():
        while bpy.app.is_job_running("RENDER") and time.monotonic() - pressed < 30:
            yield 0.02
        say(f"figure: {time.monotonic() - pressed:.2f} s from Esc to the end of the render")
        if bpy.app.is_job_running("RENDER"):
            raise RuntimeError("a render that does not end; nothing more can be tried")
        yield 0.2
        check(events["cancel"] == done["cancel"] + 1, "the render counts as cancelled")
    else:
        say("left out: Esc (no xdotool on this screen)")
        while bpy.app.is_job_running("RENDER"):
            yield 0.5
    settings.samples = samples


def off_and_on(folder, archive, before):
    disable(archive)
    check(not registered(), "disabling takes the engine back")
    check(not hasattr(bpy.types.Scene, "pointsplat"), "disabling takes the settings back")
    yield 0.5
    enable(archive)
    check(registered(), "enabling brings the engine again")
    bpy.context.scene.render.engine = "POINTSPLAT"
    viewport()[3].shading.type = "RENDERED"
    yield 2.0
    check(difference(before, shoot(folder, "enabled_again")) < 0.02, "after enabling again the viewport is as before")


def undo(folder, before):
    bpy.ops.ed.undo_push(message="before the move")
    bpy.data.objects["Monkey"].location.z += 1.5
    bpy.ops.ed.undo_push(message="the move")
    yield 1.5
    moved = shoot(folder, "moved")
    check(difference(before, moved) > 0.003, "the viewport follows a moved object")
    window, area, region, _ = viewport()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.ed.undo()
    check(abs(bpy.data.objects["Monkey"].location.z - 0.2) < 1e-6, "undo moves the object back")
    yield 2.0
    check(difference(before, shoot(folder, "undone")) < 0.02, "after undo the viewport is as before")


def save_and_load(folder, before):
    path = str(folder / "desktop.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    check(bpy.context.scene.render.engine != "POINTSPLAT", "the start-up file has its own engine")
    bpy.ops.wm.open_mainfile(filepath=path)
    yield 0.5
    viewport()[3].shading.type = "RENDERED"  # Blender itself opens files with Solid in its place
    yield 2.5
    scene = bpy.context.scene
    check(scene.render.engine == "POINTSPLAT", "the file keeps the engine")
    check(scene.objects["Monkey"].pointsplat.primitive == "POINTS", "the file keeps an object's settings")
    check(difference(before, shoot(folder, "loaded")) < 0.02, "after loading the viewport is as before")


def grow():
    """Fur on the plane, a tuft of curves, a bevelled curve, and a mesh that can become a strand."""
    plane = bpy.data.objects["Plane"]
    plane.modifiers.new("Fur", "PARTICLE_SYSTEM")
    fur = plane.particle_systems[0].settings
    fur.type, fur.count, fur.hair_length, fur.radius_scale = "HAIR", 200, 0.8, 0.05
    fur.child_type, fur.child_percent, fur.rendered_child_count = "INTERPOLATED", 4, 4
    fur.kink, fur.kink_amplitude = "CURL", 0.05
    tuft = bpy.data.hair_curves.new("Tuft")
    tuft.add_curves([6] * 60)
    places = []
    for i in range(60):
        turn, out = 2.4 * i, 0.05 * math.sqrt(i)
        for k in range(6):
            far = out * (1 + 0.3 * k * k / 5)
            places += [far * math.cos(turn), far * math.sin(turn), 0.4 * k]
    tuft.position_data.foreach_set("vector", places)
    bpy.context.collection.objects.link(bpy.data.objects.new("Tuft", tuft))
    bpy.data.objects["Tuft"].location = (-2.5, -1.5, -1)
    pipe = bpy.data.curves.new("Pipe", "CURVE")
    pipe.dimensions, pipe.bevel_depth = "3D", 0.15
    spline = pipe.splines.new("BEZIER")
    spline.bezier_points.add(2)
    for point, at in zip(spline.bezier_points, ((-3, 2, -1), (-1.5, 2.5, 1.5), (0.5, 2.5, -1)), strict=True):
        point.co, point.handle_left_type, point.handle_right_type = at, "AUTO", "AUTO"
    bpy.context.collection.objects.link(bpy.data.objects.new("Pipe", pipe))
    bpy.ops.mesh.primitive_cylinder_add(
        vertices=12, radius=0.3, depth=3, end_fill_type="NOTHING", location=(1, -3, 0.5)
    )
    bpy.context.object.name = "Trunk"


def strands(folder):
    window, area, region, space = viewport()
    bald = shoot(folder, "bald")
    with bpy.context.temp_override(window=window, area=area, region=region):
        grow()
    bpy.ops.ed.undo_push(message="strands")
    yield 4.0
    grown = shoot(folder, "grown")
    check(difference(bald, grown) > 0.003, "hair and curves are seen in the viewport")
    turned = space.region_3d.view_rotation.copy()
    space.region_3d.view_rotation = Euler((math.radians(75), 0, math.radians(200))).to_quaternion()
    area.tag_redraw()
    yield 4.0
    check(difference(grown, shoot(folder, "grown_behind")) > 0.01, "hair and curves turn with the view")
    space.region_3d.view_rotation = turned
    yield from final_render(folder, "f12_strands")
    yield 2.0
    trunk = bpy.data.objects["Trunk"]
    with bpy.context.temp_override(
        window=window, area=area, region=region, object=trunk, active_object=trunk, selected_objects=[trunk],
        selected_editable_objects=[trunk],
    ):  # fmt: skip
        bpy.ops.pointsplat.mesh_to_strands("EXEC_DEFAULT", True)
    made = [o.name for o in bpy.data.objects if o.type == "CURVES" and o.name != "Tuft"]
    check(len(made) == 1, f"a cylinder becomes a strand ({made})")
    yield 3.0
    # A round tube in place of twelve flat sides
    check(difference(grown, shoot(folder, "converted")) < 0.02, "the strand is where the cylinder was")
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.ed.undo()
    check(not [o.name for o in bpy.data.objects if o.type == "CURVES" and o.name != "Tuft"], "undo takes it back")
    check(len(bpy.data.objects["Trunk"].data.polygons) == 12, "and the cylinder is whole again")
    yield 3.0
    check(difference(grown, shoot(folder, "unconverted")) < 0.01, "after undo the viewport is as before")


def story(args):
    args.output.mkdir(parents=True, exist_ok=True)
    yield 1.0
    install(args.zip)
    check(registered(), "the engine is registered")
    if args.scene:
        yield from orbit_file(args.output, args.scene, args.full)
        return
    if args.guide:
        yield from guide(args.output, args.guide.resolve())
        return
    if args.data:
        yield from files(args.output, args.data.resolve(), args.only)
        return
    watch_renders()
    bpy.context.preferences.view.render_display_type = "NONE"  # F12 leaves the window as it is
    fill_scene()
    _, area, _, space = viewport()
    space.shading.type = "SOLID"
    yield 1.0
    solid = shoot(args.output, "solid")
    space.shading.type = "RENDERED"
    meter = Meter()
    yield from rest(meter, area)  # the first picture waits for shaders to be compiled
    meter.end()
    rendered = shoot(args.output, "rendered")
    check(difference(solid, rendered) > 0.02, "Rendered looks different from Solid")
    colors = {tuple(round(c * 15) for c in pixel) for row in rendered for pixel in row}
    check(len(colors) > 12, f"the rendered viewport shows shaded objects ({len(colors)} coarse colours)")
    before = []

    def remember():
        yield 2.0
        before.append(shoot(args.output, "before"))

    parts = {
        "orbit": lambda: orbit(args.output),
        "views": lambda: views(args.output),
        "handling": lambda: handling(args.output),
        "lens": lambda: lens(args.output),
        "indirect": lambda: indirect(args.output),
        "budgets": lambda: budgets(args.output),
        "render": lambda: final_render(args.output),
        "cancel": cancelled_render,
        "off": lambda: off_and_on(args.output, args.zip, before[0]),
        "undo": lambda: undo(args.output, before[0]),
        "load": lambda: save_and_load(args.output, before[0]),
        "strands": lambda: strands(args.output),
    }
    for name in args.parts or parts:
        if name in NEED_BEFORE and not before:
            yield from remember()
        yield from parts[name]()


def quit_blender():
    """Quit as a person does when all went well, so that a crash or a hang on the way out shows in the exit status."""
    if problems:
        say(f"{len(problems)} facts are wrong: " + "; ".join(problems))
        sys.stdout.flush()
        os._exit(1)
    say("all is well")
    bpy.context.preferences.view.use_save_prompt = False
    window, area, region, _ = viewport()
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.wm.quit_blender()


def main():
    args = arguments()
    faulthandler.dump_traceback_later(args.limit, exit=True)
    bpy.context.preferences.view.show_splash = False  # in time: it is shown after this script

    # Blender prints what is raised in a draw callback and goes on; here it is a failure.
    def on_exception(kind, value, trace):
        problems.append(f"{kind.__name__}: {value}")
        traceback.print_exception(kind, value, trace)

    sys.excepthook = on_exception
    steps = story(args)

    def tick():
        try:
            return next(steps)
        except StopIteration:
            pass
        except Exception as error:
            problems.append(f"{type(error).__name__}: {error}")
            traceback.print_exc()
        quit_blender()
        return None

    bpy.app.timers.register(tick, first_interval=0.5, persistent=True)


main()
