"""Groups of sub-samples that are shaded together, and the sub-sample that stands for each of them."""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import Device, Texture, releases_on_failure
from ..tiles import EVERYWHERE, TILE, TILE_DEFINE, Region
from ..uniforms import CAMERA_FIELDS, SampleView, block
from .buffer import LATTICE_DEFINE, LATTICE_FIELDS, VisibilityBuffer, sub_sample_defines

MOST_GROUPS = 7  # of a pixel: shaders/lib/visibility/groups.glsl
OPEN = 7  # the code of sub-samples that nothing covers
GROUP_BLOCK = block("Group", CAMERA_FIELDS, LATTICE_FIELDS)
LEADER_BLOCK = block("Leader", CAMERA_FIELDS, LATTICE_FIELDS, (("int", "layer"),))
BUSIEST = Interface(
    "group", fragment="visibility/busiest.frag", samplers=(("UINT_2D", "ps_second"),),
    outputs=(("float", "out_count"),), defines=(TILE_DEFINE,),
)  # fmt: skip
LEADER_SAMPLERS = (("UINT_2D", "ps_leaders"), ("UINT_2D", "ps_leader_depths"), ("UINT_2D", "ps_members"))


def group_program(lattice: Lattice) -> Interface:
    """Returns the program that groups the sub-samples of each pixel."""
    return Interface(
        "group", fragment="visibility/group.frag", block=GROUP_BLOCK,
        samplers=(("UINT_2D", "ps_depths"), ("UINT_2D", "ps_keys")),
        outputs=(("uint", "out_first"), ("uint", "out_second")), defines=(LATTICE_DEFINE, *sub_sample_defines(lattice)),
    )  # fmt: skip


def leader_program(lattice: Lattice, central: bool) -> Interface:
    """Returns the program that finds the sub-sample which stands for each pixel's group of one layer; `central`: the one
    at the pixel's centre."""
    read = ("ps_ids", "ps_depths", *(() if central else ("ps_first", "ps_second")))
    return Interface(
        "group", fragment="visibility/leader.frag", block=LEADER_BLOCK,
        samplers=tuple(("UINT_2D", name) for name in read),
        outputs=(("uint", "out_leader"), ("uint", "out_depth"), ("uint", "out_member")),
        defines=(LATTICE_DEFINE, *sub_sample_defines(lattice), *((("PS_CENTRAL", "1"),) if central else ())),
    )  # fmt: skip


class Groups:
    """The groups of a picture's pixels, in layers: each pixel has a group in the first ones, as many as it has."""

    @releases_on_failure
    def __init__(self, device: Device, buffer: VisibilityBuffer) -> None:
        self._device, self._buffer = device, buffer
        size = buffer.size
        self._program = group_program(buffer.lattice)
        self.codes = {name: device.texture(size, "R32UI") for name in ("ps_first", "ps_second")}
        self._target = device.target(list(self.codes.values()))
        self.leaders = {name: device.texture(size, "R32UI") for _, name in LEADER_SAMPLERS}
        self._leader_target = device.target(list(self.leaders.values()))
        self._tiles = -(-size[0] // TILE), -(-size[1] // TILE)
        self._count = device.texture(self._tiles, "R32F")
        self._count_target = device.target([self._count])
        self._masks: list[Texture] = []

    def group(self, view: SampleView) -> None:
        """Groups the sub-samples of all pixels."""
        record = view.record(GROUP_BLOCK, **self._buffer.values)
        self._device.draw(self._program, self._target, uniforms=record, textures=self._buffer.textures)
        self._device.draw(BUSIEST, self._count_target, textures=self.codes)
        self._counts = self._device.read(self._count)[..., 0]
        self._forget_masks()

    @property
    def layers(self) -> int:
        """How many groups the busiest pixel has."""
        return int(self._counts.max())

    @property
    def open(self) -> bool:
        """Whether nothing covers some sub-sample."""
        return bool((self._counts % 1 > 0).any())

    def region(self, layer: int, beyond: int = 0) -> Region:
        """Returns the tiles in which some pixel has a group of a layer, or for OPEN an open sub-sample, and those up to
        so many tiles beyond."""
        mask = self._counts % 1 > 0 if layer == OPEN else self._counts.astype(int) > layer
        if beyond:
            padded = np.pad(mask, beyond)
            mask = np.lib.stride_tricks.sliding_window_view(padded, (2 * beyond + 1,) * 2).any(axis=(2, 3))
        if mask.all():
            return EVERYWHERE
        self._masks.append(self._device.texture(self._tiles, "R32F", mask.astype(np.float32).reshape(-1)))
        return Region(self._masks[-1])

    def lead(self, view: SampleView, layer: int, region: Region, central: bool = False) -> None:
        """Finds the sub-samples that stand for the groups of a layer; `central`: those at the pixels' centres."""
        program = leader_program(self._buffer.lattice, central)
        if region is not EVERYWHERE:
            self._device.clear(self._leader_target)
        record = view.record(LEADER_BLOCK, layer=layer, **self._buffer.values)
        textures = {**self._buffer.textures, **self.codes}
        region.draw(self._device, program, self._leader_target, uniforms=record, textures=textures)

    def _forget_masks(self) -> None:
        for mask in self._masks:
            mask.release()
        self._masks.clear()

    def release(self) -> None:
        self._forget_masks()
        for item in (self._target, *self.codes.values(), self._leader_target, *self.leaders.values(),
                     self._count_target, self._count):  # fmt: skip
            item.release()
