"""A scan in a file, open or not: which file it is, what is wrong with it, and what was read of it."""

from __future__ import annotations

import itertools
import threading
import weakref
from collections.abc import Callable
from pathlib import Path

from ..core.scene.scene import PageLook
from ..formats.hierarchies.opening import open_pages
from ..formats.hierarchies.source import PageSource
from ..formats.points.reader import PointFileError
from .page import Page, make_page
from .tree import PageTree

NUMBERS = itertools.count(1)


class PagedScan:
    """A scan that is read by pages. Threads of the pool open and read it; whoever draws asks what is known of it."""

    def __init__(self, path: Path, opened: Callable[[Path], PageSource] = open_pages) -> None:
        """`opened`: opens the file. Nothing is read yet."""
        self.path = path
        self.number = next(NUMBERS)  # of the file as it was opened: another one where it has changed
        self.source: PageSource | None = None
        self.tree: PageTree | None = None
        self.failure = ""  # why it cannot be opened; empty: it is open, or was not tried
        self.damaged: dict[int, str] = {}  # pages that cannot be read, and why
        self.read_pages = self.read_bytes = 0
        self._opened, self._stamp = opened, None
        self._lock = threading.Lock()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know of the file, each thing once."""
        name = self.path.name
        if self.failure:
            return (self.failure,)
        if not self.damaged:
            return ()
        first = next(iter(self.damaged.values()))
        return (f"{name}: {len(self.damaged):,} of its pages cannot be read, and coarser ones stand in: {first}",)

    def refresh(self) -> bool:
        """Opens the file if it is not open, or is another one than before; returns whether anything has changed.
        Called by threads that may wait for a disk."""
        with self._lock:
            try:
                stat = self.path.stat()
                stamp = stat.st_mtime_ns, stat.st_size, stat.st_ino
                if stamp == self._stamp:
                    return False
                source = self._opened(self.path)
                tree = PageTree(source.directory)
            except (OSError, PointFileError, MemoryError) as error:
                what = str(error) if isinstance(error, PointFileError) else f"{self.path.name}: {_reason(error)}"
                changed, self.failure, self._stamp = what != self.failure, what, None
                return changed
            before, self.source, self.tree = self.source, source, tree
            self.number, self.failure, self.damaged, self._stamp = next(NUMBERS), "", {}, stamp
        if before is not None:
            before.close()
        return True

    def read(self, page: int, look: PageLook) -> Page | None:
        """Reads a page in a look; None: it cannot be read, which is noted."""
        source, tree, number = self.source, self.tree, self.number
        if source is None or tree is None:
            return None
        try:
            elements = source.read(page)
            made = make_page(tree, page, elements, look)
        except Exception as error:  # a damaged page may hold anything
            what = str(error) or type(error).__name__
            if number == self.number:
                self.damaged[page] = what
            return None
        self.read_pages += 1
        self.read_bytes += int(source.directory.nbytes[page])
        return made


def _reason(error: BaseException) -> str:
    if isinstance(error, FileNotFoundError):
        return "is missing"
    return (error.strerror if isinstance(error, OSError) else "") or str(error) or type(error).__name__


_SCANS: weakref.WeakValueDictionary[Path, PagedScan] = weakref.WeakValueDictionary()
_LOCK = threading.Lock()


def scan_at(path: Path) -> PagedScan:
    """Returns the scan of a path, the same for all who hold it."""
    with _LOCK:
        found = _SCANS.get(path)
        if found is None:
            found = _SCANS[path] = PagedScan(path)
        return found
