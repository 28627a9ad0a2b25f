"""Releases what outlives a picture, threads, devices and converted geometry, when files are loaded or undone."""

from __future__ import annotations

import bpy

from ..stream.pool import POOL
from . import engine
from .convert.light import world_surface
from .convert.material import images
from .device import gl_thread
from .device.main_gpu import MAIN_GPU
from .final import FinalRender
from .geometry_cache import CACHE
from .scans import page_arrivals
from .shared_store import STORE
from .viewport import Viewport


def release() -> None:
    """Free every device and forget all converted data. Viewports start anew with their next drawing."""
    for viewport in list(Viewport.alive):
        viewport.release()
        viewport.synchronizer.forget()
    MAIN_GPU.release()
    gl_thread.THREAD.release()
    FinalRender.last_scene = None
    page_arrivals.stop()
    POOL.clear()
    STORE.clear()
    CACHE.clear()
    images.clear()
    world_surface.clear()


@bpy.app.handlers.persistent
def on_load(*_arguments) -> None:
    """Release everything before another file is loaded."""
    release()


@bpy.app.handlers.persistent
def on_loaded(*_arguments) -> None:
    """Register the engine again if the loaded file's device setting needs another kind of GPU context."""
    engine.choose_context()


@bpy.app.handlers.persistent
def on_undo(*_arguments) -> None:
    """Make viewports read the scene again after undo or redo, which do not always report what they changed."""
    for viewport in list(Viewport.alive):
        viewport.synchronizer.forget()


HANDLERS = (("load_pre", on_load), ("load_post", on_loaded), ("undo_post", on_undo), ("redo_post", on_undo))


def register() -> None:
    """Add the handlers to Blender's."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Remove the handlers from Blender's and release everything."""
    for name, handler in HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    release()
