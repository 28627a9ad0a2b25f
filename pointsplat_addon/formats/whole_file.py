"""Files of caches: written whole or not at all, and the oldest deleted where they need too much space."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from .file_lock import SUFFIX as LOCK_SUFFIX

Part = bytes | memoryview


def write_whole(target: Path, parts: Iterable[Part]) -> None:
    """Writes parts of a file one after another. Readers see the whole file or none, also where the machine fails: the
    file gets its name when its bytes are on the disk.

    The folder is made if it is missing. Raises OSError where it cannot be written.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            for part in parts:
                file.write(part)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def trim(folder: Path | str, most: int, suffixes: Sequence[str]) -> int:
    """Deletes the least recently used files with one of these suffixes, and their locks, until at most `most` bytes
    remain; returns how many bytes were deleted."""
    files = []
    for path in (path for suffix in suffixes for path in Path(folder).glob("*" + suffix)):
        with contextlib.suppress(OSError):
            files.append((path.stat(), path))
    files.sort(key=lambda entry: max(entry[0].st_atime, entry[0].st_mtime))
    total, deleted = sum(stat.st_size for stat, _ in files), 0
    for stat, path in files:
        if total - deleted <= most:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            deleted += stat.st_size
            path.with_suffix(LOCK_SUFFIX).unlink(missing_ok=True)  # who holds it goes on: see file_lock.held
    return deleted
