"""Has viewports drawn again when pages of scans arrive: threads read them, and may not tell Blender themselves."""

from __future__ import annotations

import weakref
from typing import Protocol

import bpy

from ...stream.pool import POOL, VIEWPORT

INTERVAL = 0.1  # seconds between two looks


class Waiting(Protocol):
    """What shows pages, a viewport."""

    def is_behind(self) -> bool:
        """Whether it would be drawn with pages that have come since it was."""
        ...


_waiting: weakref.WeakSet[Waiting] = weakref.WeakSet()


def watch(viewport: Waiting) -> None:
    """Looks for pages until the viewports' are all there. Called by a viewport that waits for some."""
    _waiting.add(viewport)
    if not bpy.app.timers.is_registered(_look):
        bpy.app.timers.register(_look, first_interval=INTERVAL)


def stop() -> None:
    """Looks no more."""
    _waiting.clear()
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)


def _look() -> float | None:
    busy = POOL.is_busy(VIEWPORT)
    # Drawing a window takes time that readers could have.
    if not busy or any(viewport.is_behind() for viewport in _waiting):
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
    if busy:
        return INTERVAL
    _waiting.clear()
    return None
