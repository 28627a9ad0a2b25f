"""Ends a process that has loaded bpy without the interpreter's own shutdown.

Blender 4.5 as a Python package hangs there while an engine, a handler or a timer is still registered;
a test that fails half-way may leave one behind.
"""

import os
import sys

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
