"""A lock among processes, also of several machines that share a folder: the system frees it where its owner dies."""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Iterator
from pathlib import Path

LOG = logging.getLogger(__name__)
SUFFIX = ".lock"
POLL = 0.1  # seconds

if os.name == "nt":
    import msvcrt

    def _take(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _take(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # by NFS a lock of the server, too


@contextlib.contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold the lock of a file, which is made if it is missing and stays there, empty; wait for its owner before.

    Where the folder cannot be written or its file system has no locks, that is logged and nothing is held: what is
    made under a lock must be right without it.
    """
    handle = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
        _wait(handle)
    except OSError as error:
        LOG.warning("%s cannot be locked: %s", path, error)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)  # frees the lock


def _wait(handle: int) -> None:
    """OSError: the file system has no locks."""
    while True:
        try:
            return _take(handle)
        except (BlockingIOError, PermissionError):  # someone has it; Windows says it by the second
            time.sleep(POLL)
