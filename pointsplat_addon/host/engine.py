"""The render engine as Blender sees it: forwards only."""

from __future__ import annotations

import logging

import bpy
import gpu

from ..render.device.protocol import DeviceError
from . import command_line, final
from .device import libraries
from .ui import last_render
from .viewport import Viewport

LOG = logging.getLogger(__name__)

last_report = last_render.REPORT


class PointSplatEngine(bpy.types.RenderEngine):
    """PointSplat among Blender's render engines."""

    bl_idname = "POINTSPLAT"
    bl_label = "PointSplat"
    bl_use_preview = True
    bl_use_eevee_viewport = False
    # With a context of Blender's the window is blocked during a final render: see choose_context.
    bl_use_gpu_context = not libraries.has_moderngl()

    _final: final.FinalRender | None = None
    _viewport: Viewport | None = None

    def update_render_passes(self, scene=None, renderlayer=None):
        final.register_passes(self, scene, renderlayer)

    def render(self, depsgraph):
        if self._final is None:
            self._final = final.FinalRender()
        report = {}
        try:
            report = self._final.render(self, depsgraph)
        except Exception as error:
            self._fail(error)
            report = {"failed": "device"} if isinstance(error, DeviceError) else {}
        if not self.is_preview:
            last_report.clear()
            last_report.update(report)

    def _fail(self, error: Exception) -> None:
        # Blender treats a render as finished when its engine raises.
        message = str(error)
        if not isinstance(error, final.RenderError | DeviceError):
            LOG.error("The render failed", exc_info=error)
            message = f"PointSplat: {type(error).__name__}: {error}"
        self.report({"ERROR"}, message)
        command_line.fail(message)

    def view_update(self, context, depsgraph):
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.update(context, depsgraph)

    def view_draw(self, context, depsgraph):
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.draw(self, context, depsgraph)


def choose_context() -> None:
    """Register the engine again if it needs, or no longer needs, a context of Blender's for final renders.

    Without moderngl nothing else can draw. Background processes of Blender 4.5 cannot make a context later on,
    so there the scenes' device setting decides.
    """
    asked = bpy.app.background and any(scene.pointsplat.device == "BLENDER_GPU" for scene in bpy.data.scenes)
    needed = not libraries.has_moderngl() or (asked and not hasattr(gpu, "init"))
    if needed != PointSplatEngine.bl_use_gpu_context:
        bpy.utils.unregister_class(PointSplatEngine)
        PointSplatEngine.bl_use_gpu_context = needed
        bpy.utils.register_class(PointSplatEngine)


CLASSES = (PointSplatEngine,)
