"""Final renders (F12, animation, background, previews of materials): one view layer of one frame."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import replace
from operator import attrgetter
from typing import Any

import bpy
import numpy as np

from ..core.numeric.cryptomatte import murmur3
from ..core.scene import camera as camera_module
from ..core.scene import scene as scene_module
from ..core.scene.settings import Settings
from ..core.splat.pixel_radii import with_pixel_radii
from ..render.device.protocol import DeviceError
from ..render.passes.outputs import BY_KEY, CRYPTO, LIGHT_PASSES, PASSES, RenderPass
from ..render.plan.request import Request, Result
from ..render.renderer import Renderer
from . import command_line, disk_cache, motion_blur, parts
from .convert.camera import render_camera
from .convert.objects import collect
from .device import device_costs, gl_thread, libraries, main_gpu
from .sync import Synchronizer
from .ui import last_render

POLL_SECONDS = 0.02  # how often Blender is told of progress and asked whether to stop
PREVIEW_SAMPLES = 8  # of previews of materials
LIBRARY_NAMES = {"OPENGL": "OpenGL through moderngl", "BLENDER_GPU": "Blender's GPU module"}


class RenderError(Exception):
    """A render that cannot be made; the message is shown to the person."""


class FinalRender:
    """Final renders of one engine. What it converted stays, so that the next frame converts only what has changed."""

    last_scene: scene_module.Scene | None = None

    def __init__(self) -> None:
        self.synchronizer = Synchronizer()

    def render(self, engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> dict[str, Any]:
        """Draw the active view layer into Blender's result and return the report.

        Raises RenderError if there is no camera or no pixel, DeviceError if nothing can draw.
        """
        started = time.perf_counter()
        engine.update_stats("", "Converting the scene")
        disk_cache.refresh()
        wanted = frozenset(p.key for p in _asked(depsgraph.view_layer_eval))
        previous = _previous(engine, depsgraph) if "vector" in wanted else None
        camera, warnings = _camera(engine, depsgraph)
        settings = depsgraph.scene_eval.pointsplat.settings()
        command_line.use_threads(depsgraph.scene.render)
        if settings.device != "BLENDER_GPU":
            gl_thread.THREAD.prepare()  # while the scene is converted
        if previous is not None:
            # Going to another frame and back replaced the dependency graph's report of changes.
            self.synchronizer.forget()
        before, transforms = previous or (None, None)
        if before is not None:
            camera = replace(
                camera,
                previous_view_from_world=before.view_from_world,
                previous_clip_from_view=before.clip_from_view,
            )
        scene = self.synchronizer.scene(depsgraph, previous=transforms)
        if engine.is_preview:
            settings = replace(settings, samples=min(settings.samples, PREVIEW_SAMPLES), budget="NONE")
        else:
            FinalRender.last_scene = scene
        scene = with_pixel_radii(scene, camera)
        times = motion_blur.moments(depsgraph.scene_eval.render, 0 if engine.is_preview else settings.samples)
        levels = depsgraph.view_layer_eval.pass_cryptomatte_depth
        request = Request(camera, settings, wanted, settings.samples, crypto_levels=levels, part=_part(settings))
        layer = depsgraph.scene.view_layers.find(depsgraph.view_layer.name)

        def draw() -> tuple[Result, list[str]]:
            if len(times):
                return self._draw_moments(engine, depsgraph, times, scene, request)
            return _draw(engine, scene, request)

        result, problems = _drawn_or_joined(engine, draw, request, layer)
        if not result.cancelled and request.part == (0, 1):
            _write(engine, depsgraph.view_layer_eval.name, scene, result, camera.window[2:])
        messages = dict.fromkeys((*warnings, *scene.warnings, *problems, *result.report.get("warnings", ())))
        if not engine.is_preview:
            for warning in messages:
                engine.report({"WARNING"}, warning)
        return {**result.report, "seconds": time.perf_counter() - started, "warnings": list(messages)}

    def _draw_moments(
        self,
        engine: bpy.types.RenderEngine,
        depsgraph: bpy.types.Depsgraph,
        times: np.ndarray,
        scene: scene_module.Scene,
        request: Request,
    ) -> tuple[Result, list[str]]:
        """Draw with motion blur. The dependency graph is at the present frame again afterwards."""
        frame, subframe = depsgraph.scene.frame_current, depsgraph.scene.frame_subframe

        def show(time: float) -> motion_blur.Shown:
            at = frame + subframe + float(time)
            engine.frame_set(int(np.floor(at)), at - np.floor(at))
            self.synchronizer.forget()
            camera, _ = _camera(engine, depsgraph)
            return with_pixel_radii(self.synchronizer.scene(depsgraph), camera), camera

        try:
            return motion_blur.draw(times, show, lambda *given: _draw(engine, *given), scene, request)
        finally:
            engine.frame_set(frame, subframe)
            self.synchronizer.forget()


def _camera(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph
) -> tuple[camera_module.Camera, tuple[str, ...]]:
    if engine.camera_override is None and depsgraph.scene_eval.camera is None:
        raise RenderError(f'The scene "{depsgraph.scene.name}" has no camera')
    camera, warnings = render_camera(engine, depsgraph)
    if min(camera.window[2:]) <= 0:
        raise RenderError("The render border holds no pixel")
    return camera, tuple(warnings)


def _previous(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph
) -> tuple[camera_module.Camera, dict[tuple, np.ndarray]]:
    """The camera, and world_from_object (4, 4) of instances by identity, one frame before the present one.

    The dependency graph is at the present frame again afterwards.
    """
    frame, subframe = depsgraph.scene.frame_current, depsgraph.scene.frame_subframe
    engine.frame_set(frame - 1, subframe)
    try:
        collected = collect(depsgraph, identify=True)
        camera, _ = _camera(engine, depsgraph)
    finally:
        engine.frame_set(frame, subframe)
    return camera, dict(zip(collected.identity, collected.world_from_object, strict=True))


def _part(settings: Settings) -> tuple[int, int]:
    """The part of pictures that is asked for. RenderError: they cannot be drawn in parts."""
    if parts.asked is None or parts.asked.index is None:
        return 0, 1
    if settings.budget != "NONE":
        raise RenderError("A picture with a budget cannot be drawn in parts: each would keep another one")
    return parts.asked.index, parts.asked.count


def _drawn_or_joined(
    engine: bpy.types.RenderEngine, draw: Callable[[], tuple[Result, list[str]]], request: Request, layer: int
) -> tuple[Result, list[str]]:
    """The picture, drawn or joined of its parts, and problems with the device; a part of it is kept as well."""
    asked = parts.asked
    if asked is not None and asked.index is None:
        size = request.camera.window[2:]
        return parts.joined(asked, layer, size, lambda text: engine.update_stats("", text)), []
    result, problems = draw()
    if asked is not None and not result.cancelled:
        parts.save(asked, layer, result)
    return result, problems


def _draw(engine: bpy.types.RenderEngine, scene: scene_module.Scene, request: Request) -> tuple[Result, list[str]]:
    """Draw on the device of the settings, else on the other one, with a warning. Raises DeviceError if neither can."""
    setting = request.settings.device
    order = ("BLENDER_GPU", "OPENGL") if setting == "BLENDER_GPU" else ("OPENGL", "BLENDER_GPU")
    problems = []
    for name in order:
        if name == "BLENDER_GPU" and bpy.app.background and libraries.lacks_egl():
            problems.append(f"{LIBRARY_NAMES[name]} is not available: there is no driver for EGL")
            continue
        job = Job(scene, request)
        try:
            result = job.wait(engine, job.on_opengl() if name == "OPENGL" else job.on_blender(engine))
        except (DeviceError, ImportError) as error:
            problems.append(f"{LIBRARY_NAMES[name]} is not available: {error}")
        else:
            # Only a device that the settings name is worth a warning.
            return result, [] if setting == "AUTO" else problems
    raise DeviceError("PointSplat finds nothing to draw with. " + ". ".join(problems))


class Job:
    """One drawing, perhaps on another thread, from which progress comes and which is told to stop."""

    def __init__(self, scene: scene_module.Scene, request: Request) -> None:
        self.scene, self.request = scene, request
        self.fraction, self.text, self._shown_text = 0.0, "", ""
        self._stop = threading.Event()
        self._poll = lambda: None  # called at every step if the job runs on the thread that waits for it

    def on_opengl(self) -> Future[Result]:
        """Start the job on the OpenGL thread."""

        def job(renderer: Renderer) -> Result:
            device_costs.apply(renderer, self.request.settings)
            return self._render(renderer)

        return gl_thread.THREAD.submit(job)

    def on_blender(self, engine: bpy.types.RenderEngine) -> Future[Result]:
        """Run the job on Blender's gpu module, now or later on the main thread."""
        if main_gpu.runs_here(engine.bl_use_gpu_context):
            self._poll = lambda: self._exchange(engine)
        return main_gpu.run(self._render, engine.bl_use_gpu_context)

    def wait(self, engine: bpy.types.RenderEngine, future: Future[Result]) -> Result:
        """Wait for the result; meanwhile show progress in Blender and ask it whether to stop."""
        while not wait([future], timeout=POLL_SECONDS).done:
            self._exchange(engine)
        return future.result()

    def _render(self, renderer: Renderer) -> Result:
        return renderer.render(self.scene, self.request, progress=self._progress, cancelled=self._cancelled)

    def _progress(self, fraction: float, text: str) -> None:
        self.fraction, self.text = fraction, text

    def _cancelled(self) -> bool:
        self._poll()
        return self._stop.is_set()

    def _exchange(self, engine: bpy.types.RenderEngine) -> None:
        """Show the progress in Blender, and stop the job if the person cancelled the render."""
        engine.update_progress(self.fraction)
        if self.text != self._shown_text:
            # In background mode each call prints a line.
            engine.update_stats("", self.text)
            self._shown_text = self.text
        if engine.test_break():
            self._stop.set()


def blender_name(key: str) -> str:
    """The name that Cycles gives, in this version of Blender, to the pass of a key; levels keep their number."""
    stem = next((c for c in CRYPTO if key.startswith(c)), key)
    return BY_KEY[stem].names[bpy.app.version >= (5, 0, 0)] + key.removeprefix(stem)


def _asked(view_layer: bpy.types.ViewLayer) -> list[RenderPass]:
    """The passes that the view layer's switches enable."""
    return [p for p in (*PASSES, *LIGHT_PASSES) if not p.switch or attrgetter(p.switch)(view_layer)]


def register_passes(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Register the passes that the view layer's switches enable."""
    for p in _asked(view_layer):
        levels = range((view_layer.pass_cryptomatte_depth + 1) // 2) if p.key in CRYPTO else (None,)
        for level in levels:
            name = blender_name(p.key if level is None else f"{p.key}{level:02d}")
            engine.register_pass(scene, view_layer, name, p.channels, p.ids, p.kind)


def _write(
    engine: bpy.types.RenderEngine, layer: str, scene: scene_module.Scene, result: Result, size: tuple[int, int]
) -> None:
    """Put the passes into Blender's render result; one that was opened must be ended, or Blender crashes later."""
    opened = engine.begin_result(0, 0, *size, layer=layer)
    try:
        passes = {p.name: p for p in opened.layers[0].passes}
        for key, pixels in result.pixels.items():
            if (name := blender_name(key)) in passes:
                passes[name].rect.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    finally:
        engine.end_result(opened)
    render_result = engine.get_result()
    for field, value in (_manifest(layer, scene, result) | last_render.stamps(result.report)).items():
        render_result.stamp_data_add_field(field, value)


def _manifest(layer: str, scene: scene_module.Scene, result: Result) -> dict[str, str]:
    """Metadata that maps names to Cryptomatte's identifiers, for compositors (Cryptomatte specification 1.2)."""
    hashes = scene.instances.object_hash
    names: dict[str, dict[str, int]] = {"crypto_object": {}, "crypto_material": {}}
    if hashes is not None:
        names["crypto_object"] = dict(zip(scene.instances.names, hashes.tolist(), strict=True))
    names["crypto_material"] = dict(zip(scene.materials.names, scene.materials.hash.tolist(), strict=True))
    fields = {}
    for key, identifiers in names.items():
        if f"{key}00" not in result.pixels:
            continue
        name = f"{layer}.{blender_name(key)}"
        prefix = f"cryptomatte/{murmur3(name.encode()):08x}"[: len("cryptomatte/") + 7]
        fields[f"{prefix}/name"] = name
        fields[f"{prefix}/hash"] = "MurmurHash3_32"
        fields[f"{prefix}/conversion"] = "uint32_to_float32"
        fields[f"{prefix}/manifest"] = json.dumps({n: f"{h:08x}" for n, h in identifiers.items()})
    return fields
