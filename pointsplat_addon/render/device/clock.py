"""What the passes of one picture take, and whether it is still wanted after each of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from .protocol import Device, Timer

MOST_OPEN = 64  # timers that wait to be read, of the last samples: a viewport may draw thousands, and read none


class Cancelled(Exception):  # noqa: N818 - not an error
    """The picture is not wanted any more."""


@dataclass
class Clock:
    """Measures time by pass; each reading waits for the device. It must be released: timers are the device's."""

    device: Device
    cancelled: Callable[[], bool] = lambda: False
    slow: bool = True
    spent: dict[str, float] = field(default_factory=dict)
    _open: deque[tuple[str, Timer]] = field(default_factory=deque)

    def run(self, name: str, work: Callable[[], None]) -> None:
        """Runs one pass and times it. Cancelled: the picture is not wanted any more."""
        timer = self.device.start_timer()
        self._open.append((name, timer))
        try:
            work()
        finally:  # a shader that fails must not leave the device timing
            self.device.stop_timer(timer)
        self.settle(0 if self.slow else MOST_OPEN)
        if self.slow:
            self.check()

    def check(self) -> None:
        """Raises Cancelled where the picture is not wanted any more."""
        if self.cancelled():
            raise Cancelled

    def settle(self, left: int = 0) -> None:
        """Reads all timers but the last `left`."""
        while len(self._open) > left:
            name, timer = self._open.popleft()
            self.spent[name] = self.spent.get(name, 0.0) + timer.milliseconds()

    def release(self) -> None:
        """Gives the unread timers back."""
        for _, timer in self._open:
            timer.release()
        self._open.clear()
