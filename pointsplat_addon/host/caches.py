"""What outlives a picture: threads, devices and converted geometry."""

from __future__ import annotations

import bpy

from . import engine, sync
from .convert.material import images
from .device import gl_thread
from .device.main_gpu import MAIN_GPU
from .final import FinalRender
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
    STORE.clear()
    sync.CACHE.clear()
    images.clear()


@bpy.app.handlers.persistent
def on_load(*_arguments) -> None:
    """Another file: nothing that is known will be needed."""
    release()


@bpy.app.handlers.persistent
def on_loaded(*_arguments) -> None:
    """The new file's settings."""
    engine.choose_context()


@bpy.app.handlers.persistent
def on_undo(*_arguments) -> None:
    """Undo brings data back without always telling that it changed."""
    for viewport in list(Viewport.alive):
        viewport.synchronizer.forget()


HANDLERS = (("load_pre", on_load), ("load_post", on_loaded), ("undo_post", on_undo), ("redo_post", on_undo))


def register() -> None:
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    for name, handler in HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    release()
