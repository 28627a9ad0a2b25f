"""Ends a process that has loaded bpy without the interpreter's own shutdown.

Blender 4.5 as a Python package hangs there while an engine, a handler or a timer is still registered;
a test that fails half-way may leave one behind.
"""

import os
import sys
from collections.abc import Iterator

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
    yield
    pointsplat_addon.unregister()
