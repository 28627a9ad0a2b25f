"""The interface of the renderer's resources that a frame uses."""

from __future__ import annotations

from typing import Protocol

from ...core.lod.cost import Costs
from ..cache.device_cache import DeviceCache
from ..cache.store import Store
from ..device.protocol import Device
from .targets import Pool


class FrameResources(Protocol):
    """The device of a frame, its costs, and what stays on it between frames."""

    @property
    def device(self) -> Device:
        """The device that draws."""
        ...

    @property
    def costs(self) -> Costs:
        """What drawing on this device costs; decides between points and triangles."""
        ...

    @property
    def store(self) -> Store:
        """The cache of geometry that is prepared for drawing, on the CPU."""
        ...

    @property
    def kept(self) -> DeviceCache:
        """Geometry that stays on the device from frame to frame."""
        ...

    @property
    def pool(self) -> Pool:
        """Textures and targets that frames borrow and give back."""
        ...
