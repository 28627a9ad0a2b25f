"""The device memory of one frame: what it owns, what lasts as long as one view, and what it shares by key."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...cache.device_cache import DeviceCache
from ...cache.keys import Key
from ...device.packing import paged
from ...device.protocol import Texture


class UploadScope:
    """Owns the uploads of one frame until its release; those by key stay in the cache for the next frame."""

    def __init__(self, kept: DeviceCache) -> None:
        self.kept, self.device = kept, kept.device
        self._used = kept.begin()
        self._owned: list[Any] = []
        self._of_view: list[Any] = []

    def lookup(self, key: Key, make: Callable[[], Any]) -> Any:
        """Returns what `make` puts on the device, made once for `key`; it stays at least as long as the frame."""
        self._used.add(key)
        return self.kept.lookup(key, make)

    def own(self, item: Any) -> Any:
        """Takes an item that is released with the frame, and returns it."""
        self._owned.append(item)
        return item

    def texture(self, rows: np.ndarray, channels: int = 4) -> Texture:
        """Uploads rows (N, channels) as a texture that is released with the frame."""
        size, data = paged(rows, channels)
        return self.own(self.device.texture(size, "RGBA32F" if channels == 4 else "RG32F", data))

    def view_texture(self, rows: np.ndarray) -> Texture:
        """Uploads rows (H, W, 4) or (N, 4) as a texture that is released with the view."""
        size, data = ((rows.shape[1], rows.shape[0]), rows.reshape(-1)) if rows.ndim == 3 else paged(rows, 4)
        self._of_view.append(self.device.texture(size, "RGBA32F", data))
        return self._of_view[-1]

    def own_for_view(self, item: Any) -> Any:
        """Takes an item that is released with the view, and returns it."""
        self._of_view.append(item)
        return item

    def release_view(self) -> None:
        """Frees what depends on the view alone."""
        for item in self._of_view:
            item.release()
        self._of_view.clear()

    def release(self) -> None:
        """Frees what only this frame needs."""
        self.kept.end(self._used)
        self.release_view()
        for item in self._owned:
            item.release()
        self._owned.clear()
