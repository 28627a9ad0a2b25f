"""The renderer on Blender's own gpu module: of the main thread, where viewports draw and timers run."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

import bpy

from ...core.lod.cost import DEFAULT
from ...devices.blender_gpu import BlenderDevice
from ...render.device.protocol import Device
from ...render.renderer import Renderer
from ..shared_store import STORE
from . import device_costs

T = TypeVar("T")


class MainGPU:
    """One renderer for all viewports, made when it is first asked for."""

    def __init__(self) -> None:
        self._device: Device | None = None
        self._renderer: Renderer | None = None

    def renderer(self) -> Renderer:
        """The shared renderer. DeviceError where Blender has no graphics context on this thread."""
        if self._renderer is None:
            self._device = BlenderDevice()
            self._renderer = Renderer(self._device, STORE)
            self._renderer.costs = device_costs.KNOWN.get(self._device.limits.renderer, DEFAULT)
        return self._renderer

    def release(self) -> None:
        """Free everything on the device; a later call of renderer() starts anew."""
        if self._renderer is not None:
            self._renderer.release()
        if self._device is not None:
            self._device.release()
        self._renderer = self._device = None


MAIN_GPU = MainGPU()


def runs_here(own_context: bool) -> bool:
    """Whether `run` draws on the calling thread; otherwise the main thread does, when its timers run."""
    return own_context or threading.current_thread() is threading.main_thread()


def run(job: Callable[[Renderer], T], own_context: bool) -> Future[T]:
    """Run a job on Blender's gpu; its future is done already unless the main thread has to run it later.

    own_context: the engine has a context of its own on this thread for this render only, so what the job
    makes there must not outlive it.
    """
    future: Future[T] = Future()
    if own_context:
        _settle(future, lambda: _on_own_device(job))
    elif runs_here(own_context):
        _settle(future, lambda: job(MAIN_GPU.renderer()))
    else:
        bpy.app.timers.register(lambda: _settle(future, lambda: job(MAIN_GPU.renderer())))
    return future


def _settle(future: Future[T], make: Callable[[], T]) -> None:
    """Give the future its result or its exception: whoever waits for it raises it."""
    try:
        future.set_result(make())
    except Exception as error:
        future.set_exception(error)


def _on_own_device(job: Callable[[Renderer], T]) -> T:
    device = BlenderDevice()
    renderer = Renderer(device, STORE)
    try:
        return job(renderer)
    finally:
        renderer.release()
        device.release()
