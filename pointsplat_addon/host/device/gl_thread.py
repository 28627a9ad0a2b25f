"""One long-lived thread that owns an OpenGL context and its renderer, so that their caches survive frames.

A context may only be used on the thread that made it, and Blender renders each frame on another thread.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from ...render.renderer import Renderer
from ..shared_store import STORE

T = TypeVar("T")


class GLThread:
    """Runs jobs one after another on its thread, which the first job starts.

    A daemon with a queue: the executors of concurrent.futures have ended before atexit lets us free the context.
    """

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._jobs: queue.SimpleQueue = queue.SimpleQueue()
        self._lock = threading.Lock()

    def submit(self, job: Callable[[Renderer], T]) -> Future[T]:
        """Queue a job. The future raises what the job raises, or DeviceError if no context can be made."""
        future: Future[T] = Future()
        with self._lock:
            if self._thread is None:
                self._jobs = queue.SimpleQueue()
                self._thread = threading.Thread(target=_work, args=(self._jobs,), name="pointsplat-gl", daemon=True)
                self._thread.start()
            self._jobs.put((job, future))
        return future

    def prepare(self) -> None:
        """Make the context, so that it is there when the first job comes. Where none can be made, a job says so."""
        self.submit(lambda renderer: None)

    def release(self) -> None:
        """Run the queued jobs, free the context and end the thread; a later job starts another thread."""
        with self._lock:
            thread, self._thread = self._thread, None
            if thread is not None:
                self._jobs.put(None)
        if thread is not None:
            thread.join()


def _work(jobs: queue.SimpleQueue) -> None:
    """Run jobs on this thread, with a context that the first job makes, or a later one if that failed."""
    device: Any = None
    renderer: Renderer | None = None
    while (item := jobs.get()) is not None:
        job, future = item
        try:
            if renderer is None:
                device = _make_device()
                renderer = Renderer(device, STORE)
            future.set_result(job(renderer))
        except BaseException as error:
            future.set_exception(error)
        # The data of a picture must not stay alive here until the next job.
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
