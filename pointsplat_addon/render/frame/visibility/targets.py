"""The textures that a picture of many sub-samples is drawn into."""

from __future__ import annotations

from typing import Any

from ....core.numeric.lattice import lattice_of
from ....core.numeric.pixel_filter import filter_reach
from ...device.owned import Owned
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ...passes.gbuffer import GBuffer
from ...passes.grouping.centre import CentreDepths
from ...passes.grouping.groups import Groups, Leaders
from ...passes.shading.averages import averaged
from ...passes.translucent.blend import COARSE
from ...passes.visibility.buffer import VisibilityBuffer
from ...plan.plan import Plan
from .tiles import picture_tiles


class VisibilityTargets:
    """The textures of one picture: of its sub-samples, and lists of what its groups are and show."""

    @releases_on_failure
    def __init__(
        self, device: Device, plan: Plan, passes: frozenset[str], size: tuple[int, int], most_cells: int
    ) -> None:
        """`size`: (width, height) of the picture in pixels. `most_cells`: of a tile, see cells_of_tile."""
        self._device, self._plan, self._owned = device, plan, []
        focus = ["ps_focus"] if plan.defocus else []
        self._names = [*(["ps_combined"] if plan.picture else []), *map(_sampler, averaged(passes)), *focus]
        lattice = lattice_of(plan.sub_samples)
        margin = filter_reach(plan.filter_size)
        self.size = size
        self.tiles = picture_tiles(size, lattice, device.limits.texture_size, most_cells, margin)
        self.size_of_tile = of_tile = self.tiles[0].size
        self.buffer = self._own(VisibilityBuffer(device, lattice, of_tile))
        self.groups = self._own(Groups(device, self.buffer))
        self.central: GBuffer | None = None  # of what lies under the pixels' centres, for passes that are not averaged
        self.central_leaders: Leaders | None = None
        self.depths: CentreDepths | None = None  # of what lies there, where only its depth is shown
        if plan.central and not plan.data:
            self.depths = CentreDepths(device, size)
        elif plan.central:
            self.central = GBuffer(device, plan.data_variant, size)
            self.central_leaders = self._own(Leaders(device, of_tile, central=True))
        self.behind: Texture | None = None  # what open sub-samples show
        if plan.background and plan.picture:
            self.behind = behind = self._own(device.texture(of_tile, "RGBA32F"))
            self.behind_target: Target = self._own(device.target([behind]))
        self._translucent: LayerTargets | None = None
        self._lists: _Lists | None = None
        self._lists_of_panes: _Lists | None = None

    @property
    def translucent(self) -> LayerTargets:
        """What translucent splats are blended in, made where it is first asked for."""
        made = self._translucent
        if made is None:
            self._translucent = made = LayerTargets(self._device, self._plan, self.size_of_tile)
            self._own(made)
        return made

    def lists(self, size: tuple[int, int]) -> _Lists:
        """Returns the attributes and the shading of groups, for a list of this size; those of before where they fit."""
        self._lists = self._fitting(self._lists, size)
        return self._lists

    def lists_of_panes(self, size: tuple[int, int]) -> _Lists:
        """Returns the same for a layer of panes."""
        self._lists_of_panes = self._fitting(self._lists_of_panes, size)
        return self._lists_of_panes

    def _fitting(self, lists: _Lists | None, size: tuple[int, int]) -> _Lists:
        """Returns lists of this size: those of before if they fit, which are released otherwise."""
        if lists is not None and lists.size == size:
            return lists
        if lists is not None:
            lists.release()
        return _Lists(self._device, self._plan, self._names, size)

    def _own(self, item: Any) -> Any:
        self._owned.append(item)
        return item

    def release_cells(self) -> None:
        """Releases all but what lies under the pixels' centres, which is shown with the picture."""
        for lists in (self._lists, self._lists_of_panes):
            if lists is not None:
                lists.release()
        self._lists = self._lists_of_panes = None
        for item in reversed(self._owned):
            item.release()
        self._owned.clear()
        self._translucent = None

    def release(self) -> None:
        self.release_cells()
        for centres in (self.central, self.depths):
            if centres is not None:
                centres.release()


class LayerTargets:
    """A layer of each pixel, over which translucent splats are blended, and what they change in all of them."""

    @releases_on_failure
    def __init__(self, device: Device, plan: Plan, size: tuple[int, int]) -> None:
        """`size`: (width, height) of a tile in pixels."""
        assert plan.translucent is not None
        self._owned = owned = Owned(device)
        self.layer, self.difference = (owned.texture(size, "RGBA32F") for _ in range(2))
        self.opaque = None if plan.translucent.centred else owned.texture(size, "RGBA32F")
        # Depth, group; with mattes what shadows leave of the light on them.
        self.place = owned.texture(size, "RGBA32F" if plan.translucent.mattes else "RG32F")
        # The share of a pixel's alpha that holdouts take away.
        self.cut = owned.texture(size, "RGBA32F") if plan.translucent.holdout else None
        opaque = [] if self.opaque is None else [self.opaque]
        self.expanded = owned.target(self.layer, *opaque, self.place)
        self.place_target = owned.target(self.place)
        self.difference_target = owned.target(self.difference)
        self.blended = owned.target(self.layer, *([] if self.cut is None else [self.cut]))
        if self.cut is not None:
            self.cut_target = owned.target(self.cut)
        if plan.coarse:
            self.coarse = owned.texture((-(-size[0] // COARSE), -(-size[1] // COARSE)), "RGBA32F")
            self.coarse_target = owned.target(self.coarse)

    def release(self) -> None:
        self._owned.release()


class _Lists:
    """Attributes of groups, and what they show; one texel a group."""

    @releases_on_failure
    def __init__(self, device: Device, plan: Plan, names: list[str], size: tuple[int, int]) -> None:
        self.size = size
        self.surfaces = GBuffer(device, plan.variant, size)
        self.shaded = {name: device.texture(size, "RGBA32F") for name in names}
        self.target: Target = device.target(list(self.shaded.values()))
        self.matte_target: Target | None = None  # the picture, and what shadows leave of the light on mattes
        if plan.matte_light.lit:
            self.shaded["ps_matte"] = matte = device.texture(size, "RGBA32F")
            self.matte_target = device.target([self.shaded["ps_combined"], matte])

    def release(self) -> None:
        targets = (self.target, *(() if self.matte_target is None else (self.matte_target,)))
        for item in (*targets, *self.shaded.values(), self.surfaces):
            item.release()


def _sampler(key: str) -> str:
    """The name of the sampler of a shaded pass."""
    return {"normal": "ps_normal_pass"}.get(key, f"ps_{key}")
