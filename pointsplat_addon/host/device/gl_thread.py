"""One long-lived thread that owns an OpenGL context and its renderer, so that their caches survive frames.

A context may only be used on the thread that made it, and Blender renders each frame on another thread.
"""

from __future__ import annotations

import importlib.util
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from ...render.renderer import Renderer
from ..shared_store import STORE
from . import device_costs

T = TypeVar("T")


def available() -> bool:
    """Whether moderngl is installed; whether it can make a context only the thread can tell."""
    return importlib.util.find_spec("moderngl") is not None


class GLThread:
    """Runs jobs one after another on its thread, which the first job starts.

    A daemon with a queue: the executors of concurrent.futures have ended before atexit lets us free the context.
    """

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._jobs: queue.SimpleQueue = queue.SimpleQueue()
        self._lock = threading.Lock()

    def submit(self, job: Callable[[Renderer], T]) -> Future[T]:
        """Queue a job. The future raises what the job raises, or DeviceError where no context can be made."""
        future: Future[T] = Future()
        with self._lock:
            if self._thread is None:
                self._jobs = queue.SimpleQueue()
                self._thread = threading.Thread(target=_work, args=(self._jobs,), name="pointsplat-gl", daemon=True)
                self._thread.start()
            self._jobs.put((job, future))
        return future

    def release(self) -> None:
        """Free the context after the jobs that are queued, and end the thread; a later job starts another."""
        with self._lock:
            thread, self._thread = self._thread, None
            if thread is not None:
                self._jobs.put(None)
        if thread is not None:
            thread.join()


def _work(jobs: queue.SimpleQueue) -> None:
    """The thread: makes its context for the first job, and again for the next one where that failed."""
    device: Any = None
    renderer: Renderer | None = None
    while (item := jobs.get()) is not None:
        job, future = item
        try:
            if renderer is None:
                device = _make_device()
                renderer = Renderer(device, STORE)
                device_costs.apply(renderer)
            future.set_result(job(renderer))
        except BaseException as error:
            future.set_exception(error)
        # What a picture was made of must not wait here for the next job.
        del item, job, future
    if renderer is not None:
        renderer.release()
    if device is not None:
        device.release()


def _make_device() -> Any:
    # Imported here, so that the extension also works where moderngl is missing.
    from ...devices.opengl import OpenGLDevice

    return OpenGLDevice()


THREAD = GLThread()
