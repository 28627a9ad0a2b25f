"""The textures that one picture is drawn into, reused from frame to frame: allocating them costs as much as a pass."""

from __future__ import annotations

from typing import Any

from ..device.protocol import Device, Target, Texture, releases_on_failure
from ..passes.image_space.projection import Projection
from ..passes.output.eye_dome import EyeDome
from ..passes.shading import averages, data
from ..passes.translucent.blend import COARSE
from ..plan.plan import Plan
from .surfels import Surfels, make_surfels
from .visibility.targets import VisibilityTargets


class Targets:
    """The textures and targets that a sample is drawn into, and the sums over samples."""

    @releases_on_failure
    def __init__(
        self, device: Device, plan: Plan, passes: frozenset[str], size: tuple[int, int], count: int, most_cells: int
    ) -> None:
        """Allocates textures of `size` (width, height) pixels; `count`: levels of the pyramid above the G-buffer;
        `most_cells`: of a tile of the visibility buffer."""
        self._owned: list[Any] = []
        self._device = device
        self._allocate(plan, passes, size, count, most_cells)

    def _allocate(self, plan: Plan, passes: frozenset[str], size: tuple[int, int], count: int, most_cells: int) -> None:
        device = self._device
        self.visibility: VisibilityTargets | None = None
        if plan.sub_samples and (plan.solid or plan.translucent is not None):
            self.visibility = self._own(VisibilityTargets(device, plan, passes, size, most_cells))
        self.projection: Projection | None = None
        if plan.points and plan.ewa is None and not plan.sub_samples:
            self.projection = self._own(Projection(device, plan.options, size))
        self.surfels: Surfels | None = None
        if plan.shaded.solid and not plan.sub_samples:
            self.surfels = self._own(make_surfels(device, plan.shaded, plan.variant, size, count))
        self.data_surfels = self.surfels
        self.sums: list[Texture] = [
            self._own(device.texture(size, "RGBA32F")) for _ in range(plan.picture + len(averages.averaged(passes)))
        ]
        if self.sums:
            self.sum_target: Target = self._own(device.target(self.sums))
            # Translucent splats are drawn over the opaque picture of each sample, which is then added to the sums.
            self.shade_target: Target = self.sum_target
        if (plan.translucent is not None or plan.panes) and not plan.defocus:
            self.combined_target: Target = self._own(device.target(self.sums[:1]))
        if plan.defocus:
            # The parts in focus are summed with their depth; at the end the picture is composed of them and the rest.
            self.focus: Texture = self._own(device.texture(size, "RGBA32F"))
            self.sum_target = self.shade_target = self._own(device.target([*self.sums, self.focus]))
            self.seen: Texture = self._own(device.texture(size, "RGBA32F"))
            self.seen_target: Target = self._own(device.target([self.seen]))
        if plan.painter and plan.points:
            # Passes that are not painted have a separate G-buffer.
            self.data_surfels = self._own(make_surfels(device, plan, plan.data_variant, size, count))
            if len(self.sums) > plan.picture:
                self.averages_target: Target = self._own(device.target(self.sums[plan.picture :]))
        self.eye_dome = self._own(EyeDome(device, size)) if plan.eye_dome else None
        self.layer: Texture | None = None
        self.depth: Texture | None = None
        if plan.translucent is not None and not plan.defocus and self.visibility is None:
            self.layer = layer = self._own(device.texture(size, "RGBA32F"))
            # The share of a pixel's alpha that holdouts take away.
            self.cut: Texture | None = self._own(device.texture(size, "RGBA32F")) if plan.translucent.holdout else None
            self.layer_target: Target = self._own(device.target([layer] if self.cut is None else [layer, self.cut]))
            further = [] if plan.painter and plan.points else self.sums[1:]
            self.shade_target = self._own(device.target([layer, *further]))
            if plan.coarse:
                size_of_coarse = (-(-size[0] // COARSE), -(-size[1] // COARSE))
                self.coarse: Texture = self._own(device.texture(size_of_coarse, "RGBA32F"))
                self.coarse_target: Target = self._own(device.target([self.coarse]))
            if plan.translucent.opaque:
                self.depth = depth = self._own(device.texture(size, "R32F"))
                self.depth_target: Target = self._own(device.target([depth]))
        self.data: list[Texture] = []
        if plan.data:
            self.data = [self._own(device.texture(size, "RGBA32F")) for _ in data.data(passes)]
            self.data_target: Target = self._own(device.target(self.data))
            # Identities cannot be averaged, and motion and positions are read once: they have a separate G-buffer, so
            # that samples do not write channels which only one of them needs.
            shared = self.data_surfels is self.surfels and not plan.sub_samples
            if plan.data_variant != plan.variant and shared:
                self.data_surfels = self._own(make_surfels(device, plan, plan.data_variant, size, count))

    def _own(self, item: Any) -> Any:
        self._owned.append(item)
        return item

    def release(self) -> None:
        for item in self._owned:
            item.release()
        self._owned.clear()


class Pool:
    """Keeps the targets that were given back last, for the next frame to borrow."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._idle: tuple[tuple, Targets] | None = None

    def make_room(self, plan: Plan, passes: frozenset[str], size: tuple[int, int], count: int, most_cells: int) -> None:
        """Releases idle targets that do not match: what is uploaded before others are borrowed may need their place."""
        if self._idle is not None and self._idle[0] != self._key(plan, passes, size, count, most_cells):
            self.release()

    def borrow(
        self, plan: Plan, passes: frozenset[str], size: tuple[int, int], count: int, most_cells: int
    ) -> tuple[tuple, Targets]:
        """Returns the key to give targets back with, and the targets for a plan; idle ones if they match."""
        self.make_room(plan, passes, size, count, most_cells)
        if self._idle is not None:
            idle, self._idle = self._idle, None
            return idle
        made = Targets(self.device, plan, passes, size, count, most_cells)
        return self._key(plan, passes, size, count, most_cells), made

    @staticmethod
    def _key(plan: Plan, passes: frozenset[str], size: tuple[int, int], count: int, most_cells: int) -> tuple:
        """What decides the targets of a plan."""
        return (size, count, most_cells,
               plan.sub_samples, plan.filter_size, plan.central, plan.background, plan.points, plan.ewa, plan.polygons,
               plan.spheres, plan.lines, plan.variant, plan.options,
               plan.painter and plan.data_variant, plan.defocus, plan.panes, plan.picture, plan.eye_dome,
               averages.averaged(passes), plan.matte_light.lit,
               None if plan.translucent is None else
               (plan.translucent.opaque, plan.translucent.holdout, plan.translucent.centred, plan.coarse,
                plan.translucent.mattes),
               (plan.data_variant, data.data(passes)) if plan.data else None)  # fmt: skip

    def give_back(self, key: tuple, targets: Targets) -> None:
        """Keeps targets for the next frame, and releases those that were kept before."""
        self.release()
        self._idle = key, targets

    def release(self) -> None:
        if self._idle is not None:
            self._idle[1].release()
        self._idle = None
