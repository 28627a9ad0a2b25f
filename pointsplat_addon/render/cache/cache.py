"""The one kind of cache: items by key up to a limit of bytes, the least recently used dropped first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence, Set
from typing import Any

import numpy as np

from .keys import Key


class Cache:
    """Items by key, shared by threads."""

    def __init__(self, limit: int, dispose: Callable[[Any], None] = lambda item: None) -> None:
        """`limit`: bytes. `dispose`: is called with every item that is dropped."""
        self.limit = limit
        self._dispose = dispose
        self._bytes = 0
        self._items: OrderedDict[Key, tuple[Any, int]] = OrderedDict()
        self._lock = threading.RLock()

    def __contains__(self, key: Key) -> bool:
        with self._lock:
            return key in self._items

    def keys(self) -> set[Key]:
        """Those of all items."""
        with self._lock:
            return set(self._items)

    @property
    def nbytes(self) -> int:
        """Bytes that count against the limit: of the arrays that items hold."""
        return self._bytes

    def lookup(self, key: Key, make: Callable[[], Any]) -> Any:
        """Returns the item of `key`; makes it first if there is none. Two threads may both make it; the first stays."""
        with self._lock:
            if key in self._items:
                self._items.move_to_end(key)
                return self._items[key][0]
        item = make()
        with self._lock:
            if key not in self._items:
                size = item_bytes(item)
                self._items[key] = item, size
                self._bytes += size
                self._added(key)
            return self._items[key][0] if key in self._items else item

    def lookup_all(self, keys: Sequence[Key], make: Callable[[list[int]], Sequence[Any]]) -> list[Any]:
        """Returns the items of `keys`. `make`: of those that there are none of, by their rows, all at once."""
        with self._lock:
            found = {key: self._items[key][0] for key in keys if key in self._items}
            for key in found:
                self._items.move_to_end(key)
        missing = {key: row for row, key in enumerate(keys) if key not in found}
        if missing:
            for key, item in zip(missing, make(list(missing.values())), strict=True):
                found[key] = self.lookup(key, lambda item=item: item)
        return [found[key] for key in keys]

    def trim(self, in_use: Set[Key] = frozenset()) -> None:
        """Drops items that are not `in_use`, least recently used first, until the rest fits the limit."""
        with self._lock:
            if self.nbytes <= self.limit:
                return  # before the keys are listed: each of many small items would list all of them
            for key in list(self._items):
                if key not in in_use:
                    self.drop({key})
                    if self.nbytes <= self.limit:
                        return

    def drop(self, keys: Set[Key]) -> None:
        """Drops the items of these keys."""
        with self._lock:
            for key in keys:
                item, size = self._items.pop(key)
                self._bytes -= size
                self._dispose(item)

    def clear(self) -> None:
        """Drops all items."""
        with self._lock:
            for item, _ in self._items.values():
                self._dispose(item)
            self._items.clear()
            self._bytes = 0

    def _added(self, key: Key) -> None:
        """Makes room for a new item, which stays even if it is larger than the limit."""
        self.trim({key})


def item_bytes(item: Any) -> int:
    """Bytes of the arrays that an item, or the items of a tuple, hold."""
    if isinstance(item, tuple):
        return sum(item_bytes(part) for part in item)
    size = getattr(item, "nbytes", 0)
    return int(size) if isinstance(size, int | np.integer) else 0
