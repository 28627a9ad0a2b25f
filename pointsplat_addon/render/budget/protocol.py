"""What pictures within a budget need of the renderer, and of a clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ...core.scene.scene import Scene
from ..cache.device_cache import DeviceCache
from ..cache.store import Store
from ..device.protocol import Device
from ..frame.frame import Frame
from ..indirect.known_sites import Slices
from ..indirect.light import IndirectLight
from ..plan.request import Request, Result
from .pacing import Pacers
from .watch import Watch

Progress = Callable[[float, str], None]  # called with the finished fraction and a text for the user
Seconds = Callable[[], float]  # a clock, such as time.perf_counter


class SampleRenderer(Protocol):
    """Draws pictures on one device, with as many samples as a watch asks for."""

    @property
    def device(self) -> Device:
        """The device that draws."""
        ...

    @property
    def store(self) -> Store:
        """What is prepared of scenes."""
        ...

    @property
    def kept(self) -> DeviceCache:
        """What stays on the device from picture to picture."""
        ...

    @property
    def pacers(self) -> Pacers:
        """What was measured of the scenes that were drawn within a budget of time."""
        ...

    def draw(
        self,
        scene: Scene,
        request: Request,
        progress: Progress,
        cancelled: Callable[[], bool],
        watch: Watch | None = None,
    ) -> Result:
        """Draws samples of a picture until there are enough, or `watch` says so."""
        ...

    def start(
        self, scene: Scene, request: Request, slices: Slices | None = None, known: IndirectLight | None = None
    ) -> Frame:
        """Prepares a picture that is then drawn sample by sample. Cancelled: `slices` put gathering off. `known`:
        nothing is gathered, but estimated from this light."""
        ...
