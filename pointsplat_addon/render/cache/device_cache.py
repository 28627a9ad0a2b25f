"""What stays on the device from one frame to the next."""

from __future__ import annotations

from collections.abc import Callable, Set
from itertools import count
from typing import Any

from ..device.protocol import Device, released_on_failure
from .cache import Cache
from .keys import Key, Kind, streamed_names

MOST_BYTES = 4 << 30  # of geometry that stay on the device after their frame
# Shadow maps of what has moved are of no use to any other frame: an animation would fill MOST_BYTES with them.
CHANGING = frozenset({Kind.SHADOW_MAP_TEXTURE, Kind.PANE_TEXTURE})
MOST_CHANGING = 2  # of these that stay, for what is drawn by turns


class DeviceCache(Cache):
    """Textures and buffers of one device by content.

    Several frames may be in the making: two viewports, or a picture and what it is compared with. What they use stays.
    """

    def __init__(self, device: Device, limit: int = MOST_BYTES) -> None:
        """`limit`: bytes that may be allocated on the device while something unused is still there."""
        super().__init__(limit, dispose=lambda item: item.release())
        self.device = device
        self._in_use: list[set[Key]] = []  # by each frame in the making

    @property
    def nbytes(self) -> int:
        """All bytes on the device, those of render targets included."""
        return self.device.bytes_allocated()

    def begin(self) -> set[Key]:
        """Returns the set to which a frame adds the keys of what it uses, which stays until its `end`."""
        self._in_use.append(set())
        return self._in_use[-1]

    def end(self, used: set[Key]) -> None:
        """Ends the frame that began with the set `used`; further calls do nothing."""
        self._in_use = [other for other in self._in_use if other is not used]

    def own_key(self, kind: Kind) -> Key:
        """A key for an item that changes with the view: the first numbered one that no frame in the making uses."""
        taken = set().union(*self._in_use)
        return next(key for key in (Key(kind, number) for number in count()) if key not in taken)

    def lookup(self, key: Key, make: Callable[[], Any]) -> Any:
        """Returns what is on the device for `key`; uploads it with `make` if it is not. Nothing stays if that fails,
        nor what `make` has looked up for the first time."""

        def make_whole() -> Any:
            before = self.keys()
            try:
                with released_on_failure(self.device):
                    return make()
            except BaseException:
                self.drop(self.keys() - before)
                raise

        return super().lookup(key, make_whole)

    def forget_streamed(self, but: Set[str] = frozenset()) -> None:
        """Frees what shows other pages of scans than a frame in the making does, and shadow maps that none uses. `but`:
        content keys of what else stays."""
        self.forget({key for key in self.keys() if key.kind in CHANGING or not but.issuperset(streamed_names(key))})

    def forget(self, keys: Set[Key]) -> None:
        """Frees those of the items that no frame in the making uses."""
        self.drop((keys & self.keys()).difference(*self._in_use))

    def trim_unused(self) -> None:
        """Frees what no frame in the making uses, least recently used first, until the rest fits; of shadow maps all
        but a few."""
        used = set().union(*self._in_use)
        with self._lock:
            changing = [key for key in self._items if key.kind in CHANGING and key not in used]
            self.drop(set(changing[:-MOST_CHANGING]))
        self.trim(used)

    def _added(self, key: Key) -> None:
        """Nothing is freed while a frame uploads: `trim_unused` is called when it has what it needs."""
