"""Groups of sub-samples that are shaded together, their list, and the sub-sample that stands for each of them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ....core.numeric.lattice import Lattice
from ....core.numeric.segments import owners, ranges
from ....shading.interface import Block, Interface
from ...device.packing import PAGE_WIDTH
from ...device.protocol import EMPTY, Device, Target, Texture, releases_on_failure
from ..uniforms import CAMERA_FIELDS, Fields, SampleView, block
from ..visibility.buffer import (
    LATTICE_DEFINE,
    LATTICE_FIELDS,
    RASTERISED,
    VisibilityBuffer,
    member_defines,
)

OPEN = 0x2000000  # in a pixel's second word: shaders/lib/visibility/groups.glsl
COUNT_SHIFT = 21  # of a pixel's number of groups in its second word: shaders/lib/visibility/groups.glsl
GROUP_BLOCK = block("Group", CAMERA_FIELDS, LATTICE_FIELDS)
CENTRAL_DEFINE = ("PS_CENTRAL", "1")
LEADER_SAMPLERS = (("UINT_2D", "ps_leaders"), ("UINT_2D", "ps_leader_depths"), ("UINT_2D", "ps_members"))
Rectangle = tuple[float, float, float, float]  # low and high corner
WHOLE: Rectangle = (0.0, 0.0, 1.0, 1.0)
# What lib/visibility/listed.glsl reads where pixels take the place of a list.
CORNER_FIELDS: Fields = (("ivec2", "corner"),)
LIST_SAMPLER = ("FLOAT_2D", "ps_list")
SORTED_FROM = 1 << 20  # texels that draws would look at for nothing


def group_program(lattice: Lattice) -> Interface:
    """Returns the program that groups the sub-samples of each pixel."""
    return Interface(
        "group", fragment="grouping/group.frag", block=GROUP_BLOCK,
        samplers=(("UINT_2D", "ps_depths"), ("UINT_2D", "ps_keys")),
        outputs=(("uint", "out_first"), ("uint", "out_second")),
        defines=(LATTICE_DEFINE, ("PS_SUB_SAMPLES", str(lattice.count)), *member_defines(lattice)),
    )  # fmt: skip


def _leader_block(central: bool) -> Block:
    return block("Leader", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELDS if central else ())


def leader_program(lattice: Lattice, central: bool) -> Interface:
    """Returns the program that finds the sub-sample which stands for each group of the list; `central`: the one at each
    pixel's centre."""
    read = ("ps_ids", "ps_depths", *(() if central else ("ps_first", "ps_second")))
    return Interface(
        "group", fragment="grouping/leader.frag", block=_leader_block(central),
        samplers=(*(("UINT_2D", name) for name in read), *(() if central else (LIST_SAMPLER,))),
        outputs=(("uint", "out_leader"), ("uint", "out_depth"), ("uint", "out_member")),
        defines=(LATTICE_DEFINE, *((CENTRAL_DEFINE,) if central else member_defines(lattice))),
    )  # fmt: skip


class Leaders:
    """The sub-samples that stand for groups: of a list, or those at the centres of pixels."""

    @releases_on_failure
    def __init__(self, device: Device, size: tuple[int, int], central: bool = False) -> None:
        """`size`: (columns, rows) of the list, or of the picture."""
        self.size, self.central = size, central
        self.textures: dict[str, Texture] = {name: device.texture(size, "R32UI") for _, name in LEADER_SAMPLERS}
        self.target: Target = device.target(list(self.textures.values()))
        self.list: Texture | None = None
        # Of leaders at the centres of pixels: where in the picture their tile's own pixels lie, from 0 to 1, and where
        # it begins, in pixels.
        self.place: tuple[Rectangle, tuple[int, int]] = (WHOLE, (0, 0))

    @property
    def defines(self) -> tuple[tuple[str, str], ...]:
        """Of programs that read them."""
        return (CENTRAL_DEFINE,) if self.central else ()

    @property
    def fields(self) -> Fields:
        """Of programs that read them."""
        return CORNER_FIELDS if self.central else ()

    @property
    def samplers(self) -> tuple[tuple[str, str], ...]:
        """Of programs that read them."""
        return (*LEADER_SAMPLERS, *(() if self.central else (LIST_SAMPLER,)))

    @property
    def bound(self) -> dict[str, Texture]:
        """The textures by sampler name."""
        return self.textures if self.list is None else {**self.textures, "ps_list": self.list}

    def release(self) -> None:
        for item in (self.target, *self.textures.values()):
            item.release()


class Groups:
    """The groups of all pixels of a picture, in a list."""

    def __init__(self, device: Device, buffer: VisibilityBuffer) -> None:
        self._device, self._buffer = device, buffer
        self.codes: dict[str, Texture] = {}  # of each pixel's sub-samples; empty before they are grouped
        self._target: Target | None = None
        self.leaders: Leaders | None = None
        self.starts: Texture | None = None  # of each pixel's groups in the order of pixels
        self.places: Texture | None = None  # in the list, of groups in the order of pixels; None: there
        self._list: Texture | None = None
        # By the first number of each draw, its first entry in the list and the one after its last; None: the list is in
        # pixel order.
        self.ranges: dict[int, tuple[int, int]] | None = None
        self.total = 0
        self.entries = np.zeros((0, 2), np.float32)  # of the list: the pixel of each group, and its layer in that
        self._counts = np.zeros(0, np.uint32)  # of groups by pixel
        self._open = np.zeros(0, np.bool_)

    def group(self, view: SampleView) -> None:
        """Groups the sub-samples of all pixels, and lists the groups."""
        device, buffer = self._device, self._buffer
        record = view.record(GROUP_BLOCK, **buffer.values)
        if self._target is None:
            for name in ("ps_first", "ps_second"):
                if name not in self.codes:  # which it is where memory ran out between the two
                    self.codes[name] = device.texture(buffer.size, "R32UI")
            self._target = device.target(list(self.codes.values()))
        device.draw(group_program(buffer.lattice), self._target, uniforms=record, textures=buffer.textures)
        second = device.read(self.codes["ps_second"]).reshape(-1)
        counts = (second >> COUNT_SHIFT) & 7
        ends = np.cumsum(counts, dtype=np.int64)
        self.total = int(ends[-1])
        self._counts, self._open = counts, second & OPEN != 0
        self._forget()
        self.starts = device.texture(buffer.size, "R32F", (ends - counts).astype(np.float32))
        # Pixel and group in it; float32 holds the numbers of a tile's pixels exactly.
        self.entries = np.empty((self.total, 2), np.float32)
        self.entries[:, 0] = owners(counts, np.float32)
        self.entries[:, 1] = ranges(np.zeros(len(counts), np.int32), counts, np.int32)
        rows = max(-(-self.total // PAGE_WIDTH), 1)
        if self.leaders is None or not rows <= self.leaders.size[1] <= 2 * rows:
            if self.leaders is not None:
                self.leaders.release()
            self.leaders = Leaders(device, (PAGE_WIDTH, rows + rows // 8))
        self._upload(self.entries)
        self.lead(view, self.leaders)

    @property
    def layers(self) -> np.ndarray:
        """(H, W) int64: how many groups each pixel has, with what is open in it."""
        width, height = self._buffer.size
        return (self._counts + self._open).astype(np.int64).reshape(height, width)

    @property
    def covered(self) -> np.ndarray:
        """(H, W) int64: how many groups each pixel has, without what is open in it."""
        width, height = self._buffer.size
        return self._counts.astype(np.int64).reshape(height, width)

    def sort(self, view: SampleView, first_ids: list[int]) -> None:
        """Sorts the list by what draws the groups' leaders, where that pays.

        first_ids: the lowest number of the triangles or segments of each draw, rising; splats have lower ones.
        """
        assert self.leaders is not None
        if (len(first_ids) - 1) * self.total < SORTED_FROM:
            return
        ids = self._device.read(self.leaders.textures["ps_leaders"]).reshape(-1)[: self.total]
        numbers = np.where(ids == EMPTY, 0, ids & ~np.uint32(RASTERISED))
        owner = np.searchsorted(np.asarray(first_ids), numbers, side="right") * (ids != EMPTY)
        order = np.argsort(owner.astype(np.uint16), kind="stable")
        place = np.empty(self.total, np.float32)
        place[order] = np.arange(self.total)
        self.entries = self.entries[order]
        self._upload(self.entries)
        self.places = self._paged(place[:, None], "R32F")
        self.lead(view, self.leaders)
        ends = np.searchsorted(owner[order], np.arange(1, len(first_ids) + 2)).tolist()
        self.ranges = dict(zip(first_ids, pairwise(ends), strict=True))

    def rectangle(self, leaders: Leaders, first_id: int) -> Rectangle | None:
        """Returns the rectangle of texels, from 0 to 1, that a draw may have to write; None: there are none.

        first_id: its lowest number.
        """
        if leaders.central:
            return leaders.place[0]
        if self.ranges is None:
            return WHOLE
        (columns, rows), (first, end) = leaders.size, self.ranges[first_id]
        return None if first == end else (0.0, (first // columns) / rows, 1.0, (-(-end // columns)) / rows)

    def lead(self, view: SampleView, leaders: Leaders) -> None:
        """Finds the sub-samples that stand for groups."""
        program = leader_program(self._buffer.lattice, leaders.central)
        listed = {} if leaders.list is None else {"ps_list": leaders.list}
        textures = {**self._buffer.textures, **self.codes, **listed}
        self._device.draw(
            program,
            leaders.target,
            uniforms=view.record_of(program.block, corner=(0, 0), **self._buffer.values),
            textures=textures,
        )

    def _upload(self, entries: np.ndarray) -> None:
        """Uploads the list, (total, 2) float32."""
        assert self.leaders is not None
        if self._list is not None:
            self._list.release()
        width, height = self.leaders.size
        rows = np.empty((width * height, 2), np.float32)
        rows[: self.total], rows[self.total :] = entries, (0, -1)
        self._list = self.leaders.list = self._device.texture(self.leaders.size, "RG32F", rows.reshape(-1))

    def _paged(self, values: np.ndarray, format: str) -> Texture:
        height = max(-(-len(values) // PAGE_WIDTH), 1)
        data = np.zeros((PAGE_WIDTH * height, values.shape[1]), np.float32)
        data[: len(values)] = values
        return self._device.texture((PAGE_WIDTH, height), format, data.reshape(-1))

    def _forget(self) -> None:
        for item in (self.starts, self.places):
            if item is not None:
                item.release()
        self.starts = self.places = self.ranges = None

    def release(self) -> None:
        self._forget()
        for item in (self._list, self.leaders, self._target, *self.codes.values()):
            if item is not None:
                item.release()
