"""Blender's fixtures, and an end of processes that have loaded bpy without the interpreter's own shutdown.

Blender 4.5 as a Python package hangs there while an engine, a handler or a timer is still registered;
a test that fails half-way may leave one behind.
"""

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest

_EXIT_STATUS = pytest.StashKey[int]()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[_EXIT_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    status = config.stash.get(_EXIT_STATUS, None)
    # No status: pytest stopped before the session (a usage error), so no test has loaded Blender.
    if status is None or "bpy" not in sys.modules:
        return
    config.get_terminal_writer().flush()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


@pytest.fixture
def empty_file() -> Iterator[None]:
    """An empty file in which the extension is registered."""
    import bpy

    import pointsplat_addon

    pointsplat_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    yield
    pointsplat_addon.unregister()


@pytest.fixture(scope="module")
def blender() -> Iterator[Any]:
    """A renderer on Blender's gpu."""
    from pointsplat_addon.devices.blender_gpu import BlenderDevice
    from pointsplat_addon.render.renderer import Renderer
    from tests.support.blender.devices import start_gpu

    start_gpu()
    renderer = Renderer(BlenderDevice())
    yield renderer
    renderer.release()
    assert renderer.device.bytes_allocated() == 0
    renderer.device.release()


@pytest.fixture(scope="module")
def opengl() -> Iterator[Callable[[Any, bool], Any]]:
    """A function that draws a case with moderngl, on a thread of its own as in a render; its second argument says
    whether with image atomics."""
    from pointsplat_addon.devices.opengl import OpenGLDevice
    from pointsplat_addon.render.renderer import Renderer
    from tests.support.blender.devices import pictures

    with ThreadPoolExecutor(1) as thread:
        renderer = thread.submit(lambda: Renderer(OpenGLDevice())).result()
        limits = renderer.device.limits

        def draw(case: Any, atomics: bool) -> Any:
            renderer.device.limits = replace(limits, image_atomics=atomics)
            return pictures(renderer, case)

        yield lambda case, atomics: thread.submit(draw, case, atomics).result()
        thread.submit(renderer.release).result()
        thread.submit(renderer.device.release).result()
