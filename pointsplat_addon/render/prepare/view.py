"""The inputs that all steps of preparing a view share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field

from ...core.lod.cost import Costs
from ...core.numeric.record import record
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ...core.splat.blur import Blur
from ..cache.store import Store


@record
class View:
    """A scene as one camera sees it, with the settings, caches and costs for preparing it, and the warnings so far."""

    scene: Scene
    camera: Camera
    settings: Settings
    samples: int  # how often the view will be drawn
    interactive: bool  # it is drawn many times, the first time at once
    moving: bool  # and finely once nothing moves
    store: Store
    check: Callable[[], None]  # called between geometries; may raise to stop
    costs: Costs  # of drawing on the device
    few: bool  # sub-samples are drawn at once, see lattice_for
    blur: Blur | None  # of splats that are out of focus; None: no primitive becomes such splats
    coarse: bool = False  # the time budget does not allow one sample at the requested tolerance
    warnings: list[str] = field(default_factory=list)  # steps append to it; there may be duplicates

    @property
    def remembers(self) -> bool:
        """Whether what earlier views have left in the store may decide what is drawn. A final picture is the same,
        to the bit, whatever was drawn before it, on this machine or another; one with a budget never is."""
        return self.interactive or self.settings.budget != "NONE"
