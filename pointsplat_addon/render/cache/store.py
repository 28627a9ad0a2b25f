"""Points and what is made of them, kept by content and shared by all views, frames and threads."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.lod.cut import Cut
from ...core.lod.hierarchy import Hierarchy, build
from ...core.scene.cloud import PointCloud


@dataclass(frozen=True, eq=False)
class PointSet:
    """Splats of one geometry: all points, or points and nodes."""

    key: tuple
    cloud: PointCloud
    hierarchy: Hierarchy | None = None
    family: tuple = ()  # what other poses of the same samples share

    def __len__(self) -> int:
        return len(self.cloud) + (len(self.hierarchy) if self.hierarchy else 0)


@dataclass(frozen=True, eq=False)
class Layer:
    """Points that one view draws together."""

    # By geometry row; coarser ones of the same geometry, for instances farther away, follow after all rows.
    point_sets: dict[int, PointSet]
    set_of_instance: np.ndarray  # (I,) int: key of point_sets; -1: not drawn as points
    cut: Cut


@dataclass
class Store:
    """Clouds and hierarchies by content, least recently used first; shared by threads."""

    limit: int = 4 << 30  # bytes
    nbytes: int = 0
    build: Callable[[PointCloud], Hierarchy] = build  # or one that knows hierarchies from before
    _items: OrderedDict[tuple, tuple[Any, int]] = field(default_factory=OrderedDict)
    _spacing: dict[tuple, float] = field(default_factory=dict)
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _worker: ThreadPoolExecutor | None = None
    _pending: dict[tuple, Future] = field(default_factory=dict)

    def __contains__(self, key: tuple) -> bool:
        with self._lock:
            return key in self._items

    def lookup(self, key: tuple, make: Callable[[], Any]) -> Any:
        """What is kept under `key`, made first where there is nothing. Two threads may make it; the first one stays."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key][0]
        item = make()
        with self._lock:
            if key not in self._items:
                self._items[key] = item, _nbytes(item)
                self.nbytes += self._items[key][1]
                self._trim()
            return self._items[key][0] if key in self._items else item

    def later(self, key: tuple, make: Callable[[], Any]) -> None:
        """Have `make` run on a thread of the store's own, once; `key` is there when it has."""
        with self._lock:
            if key in self._items or key in self._pending:
                return
            self._worker = self._worker or ThreadPoolExecutor(1, thread_name_prefix="PointSplat builds")
            self._pending[key] = self._worker.submit(self._build, key, make)

    def _build(self, key: tuple, make: Callable[[], Any]) -> None:
        try:
            self.lookup(key, make)
        finally:
            with self._lock:
                self._pending.pop(key, None)

    @property
    def building(self) -> bool:
        with self._lock:
            return bool(self._pending)

    def finest(self, key: tuple, spacing: float) -> float:
        """The finer of `spacing` and what was asked for `key` before: samples are only ever refined."""
        with self._lock:
            self._spacing[key] = min(spacing, self._spacing.get(key, np.inf))
            return self._spacing[key]

    def clear(self) -> None:
        """Forget everything; what is being built is finished first."""
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            worker.shutdown(wait=True, cancel_futures=True)
        with self._lock:
            self._items.clear()
            self._spacing.clear()
            self._pending.clear()
            self.nbytes = 0

    def _trim(self) -> None:
        while self.nbytes > self.limit and len(self._items) > 1:
            _, (_, size) = self._items.popitem(last=False)
            self.nbytes -= size


def _nbytes(item: Any) -> int:
    """Bytes of the arrays that an item, or the items of a tuple, hold."""
    if isinstance(item, tuple):
        return sum(_nbytes(part) for part in item)
    size = getattr(item, "nbytes", 0)
    return int(size) if isinstance(size, int | np.integer) else 0


STORE = Store()
