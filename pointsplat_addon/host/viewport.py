"""The Rendered viewport: draws coarsely while the view moves and refines the picture while it is still."""

from __future__ import annotations

import logging
import time
import weakref
from dataclasses import replace
from typing import ClassVar

import bpy

from ..core.numeric.lattice import FEW
from ..core.scene import camera as camera_module
from ..core.scene import scene as scene_module
from ..core.scene import settings as settings_module
from ..core.splat.pixel_radii import with_pixel_radii
from ..render.budget.following import Followers, Following
from ..render.budget.known_light import KnownLight
from ..render.budget.viewport import Arrivals, Moving, Pace, Refining
from ..render.device.protocol import DeviceError, wait
from ..render.frame.frame import Frame
from ..render.plan.request import Request
from ..shading.sources import ShaderError
from ..stream.pool import POOL, VIEWPORT
from . import disk_cache
from .convert.camera import pixel_size, viewport_camera
from .device.main_gpu import MAIN_GPU
from .scans import page_arrivals
from .sync import Synchronizer

LOG = logging.getLogger(__name__)
STILL_SECONDS = 0.2  # without a change before the picture is refined
NAVIGATION_SAMPLES = FEW.count  # of each pixel while the view moves: one lattice of the visibility buffer


class Viewport:
    """One viewport: its scene, and the frame that it accumulates."""

    alive: ClassVar[weakref.WeakSet[Viewport]] = weakref.WeakSet()

    def __init__(self) -> None:
        Viewport.alive.add(self)
        self.synchronizer = Synchronizer()
        self._scene: scene_module.Scene | None = None
        self._frame: Frame | None = None
        self._view: tuple | None = None  # what the frame depends on besides the scene, settings first
        self._pacing: Moving | Refining | None = None  # keeps the frame within its budget
        self._followers = Followers()  # of the frame, where the view stands still
        self._known: KnownLight | None = None  # by which views are lit until then
        self._coarse = False
        self._pace = Pace()
        self._changed_at = float("-inf")
        self._error = ""
        self._begun = 0  # frames, so that none is held to tell whether there is another
        self._hasty = False  # the frame has few samples, for pages of scans are still to come
        self._arrivals = Arrivals()

    def __del__(self) -> None:
        # The viewport ends with its engine, whose own struct Blender has freed by then.
        self._drop()
        self._forget_light()

    def update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Convert what changed in the scene."""
        disk_cache.refresh()
        self._scene = self.synchronizer.scene(depsgraph, view3d=context.space_data)
        self._drop()
        self._error = ""
        self._hasty = False
        self._arrivals.forget()

    def draw(self, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw one more sample into the region, and request a redraw while there is more to do."""
        if self._error:
            engine.update_stats("PointSplat", self._error)
            return
        try:
            self._draw(engine, context, depsgraph)
        except (DeviceError, ShaderError) as error:
            # Blender would draw again at once: the error is shown, and drawing is tried when the scene changes.
            self._drop()
            self._error = str(error)
            LOG.exception("The viewport cannot be drawn")
            engine.update_stats("PointSplat", self._error)

    def release(self) -> None:
        """Free what is on the device; the next drawing converts the scene again."""
        self._drop()
        self._forget_light()
        self._scene = self._view = None

    def _draw(self, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        if self._scene is None:
            self.update(context, depsgraph)
        settings = depsgraph.scene_eval.pointsplat.settings()
        camera = viewport_camera(context, depsgraph)
        if self._scene is None or min(camera.window[2:]) <= 0:
            return
        begun, began = self._begun, time.perf_counter()
        frame = self._frame_for(self._scene, camera, settings, pixel_size(depsgraph.scene_eval.render))
        more = not frame.complete
        if more:
            more = frame.sample() if self._pacing is None else self._pacing.sample(frame)
        elif self._followers:  # which begin once this one is shown
            frame, before = self._followers.go_on(frame), frame
            if frame is not before:
                self._frame = frame
                self._keep_light(frame)
        more = more or not frame.complete or bool(self._followers)
        streamed = frame.frame_plan.streamed
        if streamed is not None and self._begun != begun:
            self._arrivals.drawn(began, time.perf_counter() - began, self._hasty, POOL.arrivals)
        if self._coarse and self._begun != begun:
            wait(MAIN_GPU.renderer().device)
            self._pace.measured(time.perf_counter() - began)
        smooth = self._coarse or self._hasty
        _present(frame, camera, smooth=smooth and frame.frame_plan.request.camera.window != camera.window)
        engine.update_stats("", "" if streamed is None else streamed.progress)
        if more or self._coarse:
            engine.tag_redraw()
        if streamed is not None and (streamed.waiting or self._hasty):
            page_arrivals.watch(self)

    def _keep_light(self, frame: Frame) -> None:
        """Keeps the light of a picture that has gathered it, for views that move and for the next picture until its
        own light is there."""
        light = frame.indirect
        if light is None or (self._known is not None and light is self._known.light):
            return  # it has none, or what is kept
        self._forget_light()
        if light.tells and self._scene is not None and self._view is not None:
            self._known = KnownLight(MAIN_GPU.renderer(), self._scene, self._view[0], light)

    def _forget_light(self) -> None:
        if self._known is not None:
            self._known.release()
        self._known = None

    def _frame_for(
        self, scene: scene_module.Scene, camera: camera_module.Camera, settings: settings_module.Settings, pixel: int
    ) -> Frame:
        """The frame that accumulates this view: coarse after a change, fine once nothing has moved for a while."""
        now = time.perf_counter()
        view = (
            settings, camera.view_from_world.tobytes(), camera.clip_from_view.tobytes(), camera.window, camera.aperture,
            pixel,
        )  # fmt: skip
        if self._frame is None or view != self._view:
            # The first picture and changes of the scene alone are drawn finely at once.
            self._coarse = self._view is not None and view != self._view
            self._changed_at, self._view = now, view
        elif self._coarse and now - self._changed_at > STILL_SECONDS:
            self._coarse = False
        elif self.is_behind():
            pass  # once more at the same fineness, with the pages that have come since
        else:
            return self._frame
        self._drop()
        self._begun += 1
        renderer, with_indirect = MAIN_GPU.renderer(), settings.use_indirect
        if self._known is not None and not self._known.is_of(renderer, scene, settings):
            self._forget_light()
        scene = with_pixel_radii(scene, camera)
        camera = camera.with_coarser_pixels(pixel)
        settings = replace(settings, use_indirect=self._known is not None)
        request = Request(
            camera,
            settings,
            frozenset({"combined"}),
            settings.viewport_samples,
            interactive=True,
            moving=self._coarse,
        )
        self._pacing = None
        if self._coarse and settings.budget == "TIME":
            self._pacing = Moving(renderer, scene, request)
        elif self._coarse:
            coarse = replace(settings, tolerance=settings.tolerance * self._pace.tolerance)
            request = replace(
                request,
                camera=camera.with_coarser_pixels(self._pace.times),
                settings=coarse,
                samples=NAVIGATION_SAMPLES,
            )
        elif settings.budget == "ERROR":
            self._pacing = Refining(request)
        self._hasty = not self._coarse and self._reads_pages(scene)
        if self._hasty:
            request = replace(
                request,
                camera=camera.with_coarser_pixels(self._arrivals.pixels),
                pages_of=camera,
                samples=min(request.samples, NAVIGATION_SAMPLES),
            )
        if self._pacing is not None:
            request = self._pacing.request
        known = None if self._known is None else self._known.light
        if not (self._coarse or self._hasty):
            if self._pacing is None:
                request = replace(request, first=True)
                following = replace(request, first=False, following=True)
                self._followers.add(Following(renderer, scene, following, known))
            else:
                following = request
            if with_indirect:
                lit = replace(following, settings=replace(request.settings, use_indirect=True))
                again = Refining(lit) if isinstance(self._pacing, Refining) else None
                sample = Frame.sample_tile if again is None else again.sample
                self._followers.add(Following(renderer, scene, lit, sample=sample))
        self._frame = renderer.start(scene, request, known=known)
        return self._frame

    def _reads_pages(self, scene: scene_module.Scene) -> bool:
        """Whether pages of scans are likely to come while the frame is drawn."""
        if all(geometry.streamed is None for geometry in scene.geometries):
            return False
        return not self._arrivals.begun or POOL.is_busy(VIEWPORT)

    def is_behind(self) -> bool:
        """Whether another frame is drawn with pages that this one lacks, or that were to come when it was begun."""
        streamed = None if self._frame is None else self._frame.frame_plan.streamed
        if streamed is None or not (self._hasty or streamed.waiting):
            return False
        if not POOL.is_busy(VIEWPORT):
            return self._hasty or streamed.arrivals != POOL.arrivals
        arrived = POOL.arrivals - streamed.arrivals
        missing, there = POOL.missing(VIEWPORT), POOL.arrivals
        return self._arrivals.are_enough(time.perf_counter(), streamed.drawn, arrived, missing, there)

    def _drop(self) -> None:
        """Release the frame, so that the next drawing starts another."""
        if self._frame is not None:
            self._frame.release()
        self._followers.release()
        self._frame = None


def _present(frame: Frame, camera: camera_module.Camera, smooth: bool) -> None:
    """Draw the frame into the region, at its border; `smooth`: without showing the squares of coarser pixels."""
    import gpu

    x0, y0, width, height = camera.window
    before = gpu.state.viewport_get()
    gpu.state.viewport_set(before[0] + x0, before[1] + y0, width, height)
    try:
        frame.present(smooth)
    finally:
        gpu.state.viewport_set(*before)
