"""Registers classes, properties, panels and handlers with Blender, in order."""

from __future__ import annotations

import atexit

import bpy

from . import caches, command_line, engine
from .scans import linked_operators as linked
from .scans import operators as scans
from .scans import picking
from .splats import operators as splats
from .ui import operators, panels, point_filters, point_panels, preferences, properties

MODULES = (
    point_filters,
    properties,
    operators,
    scans,
    linked,
    picking,
    splats,
    preferences,
    engine,
    panels,
    point_panels,
)
CLASSES = tuple(cls for module in MODULES for cls in module.CLASSES)

_registered = False


def register() -> None:
    """Register classes, properties, panels and handlers; nothing stays if one of them fails."""
    global _registered
    if _registered:
        return
    done = []
    try:
        for cls in CLASSES:
            bpy.utils.register_class(cls)
            done.append(cls)
    except Exception:
        for cls in reversed(done):
            bpy.utils.unregister_class(cls)
        raise
    properties.register()
    operators.register()
    scans.register()
    linked.register()
    picking.register()
    splats.register()
    panels.register()
    caches.register()
    command_line.register()
    if bpy.app.module:
        # As a Python package, Blender 4.5 hangs at exit while an engine is registered. The desktop program does
        # not, and has taken its types away by then.
        atexit.register(unregister)
    _registered = True


def unregister() -> None:
    """Undo `register`, and free threads, devices and caches last."""
    global _registered
    if not _registered:
        return
    _registered = False
    atexit.unregister(unregister)
    command_line.unregister()
    panels.unregister()
    splats.unregister()
    picking.unregister()
    linked.unregister()
    scans.unregister()
    operators.unregister()
    properties.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    caches.unregister()
