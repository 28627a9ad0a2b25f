"""The textures that a picture of many sub-samples is drawn into."""

from __future__ import annotations

from typing import Any

from ....core.numeric.lattice import FEW, MANY, Lattice
from ...device.protocol import Device, Target, releases_on_failure
from ...passes.gbuffer import GBuffer
from ...passes.shading.averages import averaged
from ...passes.visibility.buffer import VisibilityBuffer
from ...passes.visibility.groups import Groups
from ...plan.plan import Plan


def lattice_of(sub_samples: int) -> Lattice:
    """Returns the lattice with so many sub-samples."""
    return next(lattice for lattice in (FEW, MANY) if lattice.count == sub_samples)


class VisibilityTargets:
    """The textures that a picture of many sub-samples is drawn into."""

    @releases_on_failure
    def __init__(self, device: Device, plan: Plan, passes: frozenset[str], size: tuple[int, int]) -> None:
        """`size`: (width, height) of the picture in pixels."""
        self._owned: list[Any] = []
        self.buffer = self._own(VisibilityBuffer(device, lattice_of(plan.sub_samples), size))
        self.groups = self._own(Groups(device, self.buffer))
        self.surfaces = self._own(GBuffer(device, plan.variant, size))
        self.central: GBuffer | None = None  # of what lies under the pixels' centres, for passes that are not averaged
        if plan.central:
            self.central = self._own(GBuffer(device, plan.data_variant, size))
        names = [*(["combined"] if plan.picture else []), *averaged(passes)]
        self.shaded = {_shaded_name(name): self._own(device.texture(size, "RGBA32F")) for name in names}
        self.shaded_target: Target = self._own(device.target(list(self.shaded.values())))

    def _own(self, item: Any) -> Any:
        self._owned.append(item)
        return item

    def release(self) -> None:
        for item in reversed(self._owned):
            item.release()


def _shaded_name(key: str) -> str:
    return {"normal": "ps_normal_pass"}.get(key, f"ps_{key}")
