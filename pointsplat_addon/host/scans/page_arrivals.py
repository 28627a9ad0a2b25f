"""Has viewports drawn again when pages of scans arrive: threads read them, and may not tell Blender themselves."""

from __future__ import annotations

import bpy

from ...stream.pool import POOL, VIEWPORT

INTERVAL = 0.1  # seconds between two looks


_seen = 0  # arrivals when viewports were told last


def watch() -> None:
    """Looks for pages until the viewports' are all there. Called by a viewport that waits for some."""
    global _seen
    if not bpy.app.timers.is_registered(_look):
        _seen = POOL.arrivals
        bpy.app.timers.register(_look, first_interval=INTERVAL)


def stop() -> None:
    """Looks no more."""
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)


def _look() -> float | None:
    global _seen
    busy = POOL.is_busy(VIEWPORT)
    if POOL.arrivals != _seen or not busy:
        _seen = POOL.arrivals
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
    return INTERVAL if busy else None
