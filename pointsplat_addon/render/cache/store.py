"""Points and everything that is computed from geometry, cached by content for all views, frames and threads."""

from __future__ import annotations

from collections.abc import Callable, Set
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from ...core.lod.hierarchy import Hierarchy, build
from ...core.scene.cloud import PointCloud
from .cache import Cache
from .keys import Key, streamed_names
from .on_disk import NOWHERE

MOST_BYTES = 4 << 30


class Store(Cache):
    """A cache that can also make items on a thread of its own, and remembers the finest spacings asked for."""

    def __init__(self, limit: int = MOST_BYTES) -> None:
        """`limit`: bytes of arrays."""
        super().__init__(limit)
        self.build_hierarchy: Callable[[PointCloud], Hierarchy] = build  # or one that reads known ones from disk
        self.on_disk = NOWHERE  # what shadows and light need that processes share
        self._spacing: dict[Key, float] = {}
        self._worker: ThreadPoolExecutor | None = None
        self._pending: dict[Key, Future] = {}
        self._failed: dict[Key, Exception] = {}  # what was raised while an item was made on the store's thread
        self._streamed: dict[str, frozenset[str]] = {}  # what kinds of views drew last of scans read by pages

    def make_later(self, key: Key, make: Callable[[], Any]) -> None:
        """Runs `make` once on the store's thread; `key` is in the store when it has run."""
        with self._lock:
            if key in self._items or key in self._pending:
                return
            self._worker = self._worker or ThreadPoolExecutor(1, thread_name_prefix="PointSplat builds")
            self._pending[key] = self._worker.submit(self._make, key, make)

    def made_later(self, key: Key, make: Callable[[], Any]) -> bool:
        """Returns whether `key` is in the store; else it will be, as by `make_later`. Raises what `make` has raised."""
        with self._lock:
            if (error := self._failed.pop(key, None)) is not None:
                raise error
            self.make_later(key, make)
            return key in self._items

    def _make(self, key: Key, make: Callable[[], Any]) -> None:
        try:
            self.lookup(key, make)
        except Exception as error:
            with self._lock:
                self._failed[key] = error
            raise
        finally:
            with self._lock:
                self._pending.pop(key, None)

    @property
    def building(self) -> bool:
        """Whether an item is being made on the store's thread, or waits for it."""
        with self._lock:
            return bool(self._pending)

    def forget_streamed(self, view: str, drawn: Set[str]) -> None:
        """Drops what was made of what views drew of scans read by pages before: a view that moves draws other pages
        each time. `view`: a kind of views. `drawn`: content keys of what one of these draws of them now."""
        with self._lock:
            self._streamed[view] = frozenset(drawn)
            stays = frozenset().union(*self._streamed.values())
            self.drop({key for key in self._items if not stays.issuperset(streamed_names(key))})

    def finest_spacing(self, key: Key, spacing: float) -> float:
        """Returns the finer of `spacing` and what was asked for `key` before: samples are only ever refined."""
        with self._lock:
            self._spacing[key] = min(spacing, self._spacing.get(key, np.inf))
            return self._spacing[key]

    def clear(self) -> None:
        """Drops all items; what is being made is finished first."""
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            worker.shutdown(wait=True, cancel_futures=True)
        with self._lock:
            super().clear()
            self._spacing.clear()
            self._pending.clear()
            self._failed.clear()
