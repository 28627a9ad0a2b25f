"""What a frame takes from its renderer."""

from __future__ import annotations

from typing import Protocol

from ...core.lod.cost import Costs
from ..device.protocol import Device
from .targets import Pool
from .uploads import Kept


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
    def kept(self) -> Kept:
        """Geometry that stays on the device from frame to frame."""
        ...

    @property
    def pool(self) -> Pool:
        """Targets that frames borrow."""
        ...
