"""A file in the Rendered viewport: as its camera sees it, in motion and at rest, and how fast it is drawn."""

import math
import sys
import time

import bpy
from mathutils import Euler, Vector
from window import check, difference, say, shoot, viewport

STEPS, PAUSE = 24, 6  # of the orbit, and how many between two pictures of a view that stands still
PATIENCE = 180.0  # seconds for a view that stands still to be complete
ALIKE = 0.02  # of what is covered, and of its brightness: by how much a moving view may differ from one at rest


def module(name):
    """A module of the add-on, which has another place where it is installed as an extension."""
    return next(found for at, found in sys.modules.items() if at.endswith(f"pointsplat_addon.{name}"))


class Meter:
    """Watches the viewport draw: what each picture took, and what it showed."""

    def __init__(self):
        self._viewport = module("host.viewport").Viewport
        self._draw = self._viewport._draw
        self._before = None
        self.pictures = []  # of a view that moves: seconds by the clock, of the processor, and pixels' width
        self.wanted, self.mean, self.complete = False, None, False
        self.longest = (0.0, 0.0)  # seconds of the processor and by the clock that a drawing took
        meter = self

        def draw(drawn, *given):
            clock, busy = time.perf_counter(), time.process_time()
            meter._draw(drawn, *given)
            meter.seen(drawn, time.perf_counter() - clock, time.process_time() - busy)

        self._viewport._draw = draw

    def seen(self, drawn, seconds, busy):
        self.longest = max(self.longest, (busy, seconds))
        frame = drawn._frame
        if frame is None:
            return
        if drawn._coarse and frame is not self._before:
            width = drawn._scene and viewport()[2].width
            self.pictures.append((seconds, busy, width / frame.frame_plan.request.camera.window[2]))
        self._before = frame
        self.complete = frame.complete and not drawn._coarse and not drawn._followers
        if self.wanted:
            self.mean, self.wanted = frame.mean(), False

    def tell_longest(self, what):
        """Says how long the window waited at most for a drawing, and begins anew."""
        busy, seconds = self.longest
        say(f"figure: {what}: a drawing takes at most {seconds:.2f} s by the clock, {busy:.2f} s of the processor")
        self.longest = (0.0, 0.0)

    def end(self):
        self._viewport._draw = self._draw


def rest(meter, area):
    """Waits until the picture of a view that stands still is complete."""
    began, meter.complete = time.monotonic(), False
    area.tag_redraw()
    yield 0.3
    while not meter.complete and time.monotonic() - began < PATIENCE:
        yield 0.2
    check(meter.complete, "a view that stands still is drawn to its end")


def look_at_the_same(view):
    """Leave the camera, and look from as far at what it sees: where its ray meets a mesh, else at the middle of all."""
    scene = bpy.context.scene
    camera = scene.camera.matrix_world
    eye, along = camera.translation.copy(), -camera.col[2].xyz.normalized()
    found, place, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), eye, along)
    if not found:
        shown = [o for o in bpy.context.visible_objects if o.type not in {"CAMERA", "LIGHT"}]
        corners = [o.matrix_world @ Vector(corner) for o in shown for corner in o.bound_box]
        place = sum(corners, Vector()) / len(corners)
    view.view_perspective, view.view_rotation = "PERSP", turned(0)
    view.view_location, view.view_distance = place, (place - eye).length


def orbit_file(folder, path, full):
    """A file as its camera sees it, then from all around, in motion and at rest.

    `full`: in the whole window, and with pixels as small while the view moves as when it stands still.
    """
    bpy.ops.wm.open_mainfile(filepath=str(path.resolve()))
    yield 1.0
    bpy.context.scene.render.engine = "POINTSPLAT"
    bpy.context.preferences.view.smooth_view = 0
    if full:
        paced = module("render.budget.viewport")
        paced.STEPS = tuple(step for step in paced.STEPS if step[0] == 1)
        window, area, region, _ = viewport()
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.screen.screen_full_area(use_hide_panels=True)
        yield 1.0
    _, area, region, space = viewport()
    view = space.region_3d
    space.overlay.show_overlays = False
    view.view_perspective = "CAMERA"
    meter = Meter()
    try:
        space.shading.type = "RENDERED"
        began = time.monotonic()
        yield from rest(meter, area)
        say(f"figure: {time.monotonic() - began:.1f} s until the first view is complete")
        pictures = [shoot(folder, f"{path.stem}_camera")]
        look_at_the_same(view)
        for step in range(STEPS):
            view.view_rotation = turned(step)
            meter.wanted = step % PAUSE == PAUSE - 1
            area.tag_redraw()
            yield 0.01
            if step % PAUSE == PAUSE - 1:
                shoot(folder, f"{path.stem}_moving_{step:02d}")
                moving = meter.mean
                yield from rest(meter, area)
                meter.wanted = True
                area.tag_redraw()
                yield 0.3
                pictures.append(shoot(folder, f"{path.stem}_still_{step:02d}"))
                compare(moving, meter.mean, f"step {step}")
    finally:
        meter.end()
    for i in range(1, len(pictures)):
        check(difference(pictures[i - 1], pictures[i]) > 0.005, f"the viewport follows the orbit of {path.stem} ({i})")
    tell(meter.pictures, region)


def turned(step):
    return Euler((math.radians(78), 0, math.radians(360 / STEPS * step - 40))).to_quaternion()


def compare(moving, still, what):
    """A view that moves covers what it covers at rest, and is as bright."""
    alpha, light = (float(still[..., k].mean() if k == 3 else still[..., :3].mean()) for k in (3, 0))
    moving_alpha, moving_light = float(moving[..., 3].mean()), float(moving[..., :3].mean())
    said = f"alpha {moving_alpha:.4f} and {alpha:.4f} at rest, brightness {moving_light:.4f} and {light:.4f}"
    say(f"figure: {what}: {said}")
    check(abs(moving_alpha - alpha) <= ALIKE * alpha, f"a moving view covers what it covers at rest ({what})")
    if not bpy.context.scene.pointsplat.use_indirect:  # which views that move do not have
        check(abs(moving_light - light) <= ALIKE * light + 1e-3, f"a moving view is as bright as at rest ({what})")


def tell(pictures, region):
    if not pictures:
        return
    seconds, busy, widths = (sorted(column) for column in zip(*pictures, strict=True))
    half = len(pictures) // 2
    size = f"{region.width}x{region.height}"
    say(
        f"figure: {len(pictures)} pictures of a view of {size} that moves: {seconds[half]:.2f} s by the clock,"
        f" {busy[half]:.2f} s of the processor, pixels {widths[0]:.0f} to {widths[-1]:.0f} wide"
    )
