"""Draws opaque splats into the visibility buffer, exactly: balls as ellipsoids, others as elliptical disks.

Small splats are drawn by one compute invocation each (Günther et al. 2013; Schütz et al. 2021), in two passes of
atomics: the least depth of each sub-sample, then the lowest number among the splats that have it, so that the result
does not depend on the order of threads. Those that cover many cells are listed and rasterised before that, into the
same textures. Without image atomics all are rasterised.
"""

from __future__ import annotations

import numpy as np

from ....core.lod.balls.covered import WIDER
from ....core.numeric.lattice import Lattice
from ....core.numeric.record import value_record
from ....shading.interface import Block, Interface
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..grouping.groups import Groups, Leaders
from ..pages.point_page import BALL_PAGE_FIELDS, POINT_SAMPLERS, PageDraw, PointOptions, attributes, page_block
from ..pages.splat_page import COVERED
from ..shading.lighting import SAMPLE_FIELDS
from ..uniforms import RECTANGLE_FIELDS, Fields, SampleView
from .buffer import (
    DEPTH_ONLY_DEFINE,
    DEPTH_OUTPUT,
    LATTICE_DEFINE,
    LATTICE_FIELDS,
    OUTPUTS,
    DepthBuffer,
    VisibilityBuffer,
    member_defines,
    offset_defines,
    rank_defines,
)
from .in_picture import splats_in_picture

MOST_CELLS = 512  # of a splat that a compute invocation draws: a ball of 3 pixels in radius
LISTED = 1 << 18  # splats that a list holds; where more cover many cells, the rasteriser is given all
VERTICES = 6  # of a rectangle
FIRST: Fields = (("int", "first_index"),)
RUN: Fields = (("int", "first_splat"),)  # of a whole page: where a run of its splats begins, which ends before `splats`
LIST_SIZE: Fields = (("int", "list_size"),)
# Ranks of a pixel's sub-samples are this multiple of their numbers modulo how many there are, by p of the lattice: of
# all multiples those by which parts of circles of 0.3 to 1.2 pixels are covered with the least deviation.
RANK_STEP = {1: 1, 2: 2, 4: 10}


@value_record
class SplatKind:
    """The shader variant of the splats of one page."""

    options: PointOptions
    whole: bool  # all splats of the page are drawn, as one instance
    balls: bool  # all are balls, also in view space
    ball_page: bool  # the page has no extents
    lattice: Lattice
    nodes: bool  # all are nodes over balls
    partly: bool  # a fraction of some is covered; then none is a node over balls

    @property
    def defines(self) -> tuple[tuple[str, str], ...]:
        ranks: tuple[tuple[str, str], ...] = ()
        if self.nodes or self.partly:
            ranks = rank_defines(self.lattice, RANK_STEP[self.lattice.p])
        if self.partly:
            ranks += (("PS_COVERED", str(COVERED)),)
        if self.nodes:
            ranks += (("PS_WIDER", str(WIDER)),)
        named = {
            "PS_ONE_INSTANCE": self.options.one_instance,
            "PS_CULL": self.options.cull and not self.nodes,
            "PS_ELLIPSES": self.options.ellipses and not (self.balls or self.nodes),
            "PS_NODES": self.nodes,
            "PS_PARTLY": self.partly,
            "PS_DIRECT": self.whole,
            "PS_ROUND": self.balls,
            "PS_BALL_PAGE": self.ball_page,
        }
        return (LATTICE_DEFINE, *((name, "1") for name, on in named.items() if on), *ranks)

    @property
    def samplers(self) -> tuple[tuple[str, str], ...]:
        instances = () if self.options.one_instance else (("FLOAT_2D", "ps_instances"),)
        missing = {"ps_blocks": self.whole, "ps_extent": self.ball_page}
        read = tuple(sampler for sampler in POINT_SAMPLERS if not missing.get(sampler[1], False))
        cull = (("FLOAT_2D", "ps_materials"),) if self.options.cull and not self.nodes else ()
        return (*read, *((("FLOAT_2D", "ps_moments"),) if self.nodes else ()), *instances, *cull)

    def block(self, name: str, *groups: Fields) -> Block:
        """The uniforms of a pass."""
        own = (*(BALL_PAGE_FIELDS if self.ball_page else ()), *(SAMPLE_FIELDS if self.nodes or self.partly else ()))
        return page_block(name, self.options, LATTICE_FIELDS, own, *groups, whole=self.whole)


def cover_program(kind: SplatKind, step: str) -> Interface:
    """Returns the compute program of one `step`: LIST, DEPTH or IDENTIFY."""
    images = {"LIST": ("list", "list_length"), "DEPTH": ("depths",), "IDENTIFY": ("ids", "keys")}[step]
    own = {"LIST": LIST_SIZE, "DEPTH": (), "IDENTIFY": FIRST}[step]
    return Interface(
        "cover",
        compute="visibility/splat.comp",
        block=kind.block("Cover", own, RUN if kind.whole else ()),
        samplers=(*kind.samplers, *((("UINT_2D", "ps_depths"),) if step == "IDENTIFY" else ())),
        images=tuple(("R32UI", name) for name in images),
        defines=(
            *kind.defines,
            ("PS_MOST_CELLS", str(MOST_CELLS)),
            *(((f"PS_{step}", "1"),) if step != "DEPTH" else ()),
        ),
    )


def raster_program(kind: SplatKind, listed: bool, identified: bool = True) -> Interface:
    """Returns the program that rasterises splats. `listed`: those of a list; else all of a page's. `identified`: into a
    visibility buffer; else into depths alone."""
    return Interface(
        "cover",
        vertex="visibility/splat.vert",
        fragment="visibility/splat_ids.frag",
        block=kind.block("RasterSplats", FIRST if identified else ()),
        samplers=(*kind.samplers, *((("UINT_2D", "ps_list"),) if listed else ())),
        varyings=(("flat", "uint", "v_index"),),
        outputs=OUTPUTS if identified else DEPTH_OUTPUT,
        defines=(
            *kind.defines,
            *((("PS_LISTED", "1"),) if listed else ()),
            *(() if identified else (DEPTH_ONLY_DEFINE,)),
        ),
        depth=True,
    )


def surface_program(kind: SplatKind, variant: Variant, leaders: Leaders) -> Interface:
    """Returns the program that writes the attributes of splats that stand for groups of sub-samples."""
    samplers, named = attributes(variant, kind.options)
    added = tuple(sampler for sampler in samplers if sampler not in POINT_SAMPLERS and sampler[1] != "ps_instances")
    disks = variant.normal and not (kind.balls or kind.nodes)
    averaged = ("ps_ids",) if variant.color or variant.emission or disks else ()
    averaged += ("ps_keys",) if variant.spread else ()
    averaged += ("ps_first", "ps_second") if averaged else ()
    read = (*leaders.samplers, *(("UINT_2D", name) for name in (() if leaders.central else averaged)))
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="grouping/splat_surface.frag",
        block=kind.block("SplatSurface", FIRST, RECTANGLE_FIELDS, leaders.fields),
        samplers=(*kind.samplers, *added, *read),
        outputs=variant.outputs(),
        defines=(
            *kind.defines,
            *((name, "1") for name in variant.defines),
            *(entry for entry in named if entry[0] != "PS_ONE_INSTANCE"),
            *offset_defines(kind.lattice),
            *(member_defines(kind.lattice) if averaged and not leaders.central else ()),
            *leaders.defines,
        ),
    )


class SplatDepths:
    """Draws the depths of opaque splats."""

    def __init__(
        self, device: Device, options: PointOptions, buffer: DepthBuffer, wide: bool, round_balls: bool
    ) -> None:
        """`wide`: some splats may cover more than MOST_CELLS cells. `round_balls`: all balls stay round."""
        self._device, self._options, self._round_balls = device, options, round_balls
        self._depths, self._identified = buffer, isinstance(buffer, VisibilityBuffer)
        self._atomics = device.limits.image_atomics
        self._listing = wide and self._atomics
        if self._listing:
            self._list = device.texture((PAGE_WIDTH, LISTED // PAGE_WIDTH), "R32UI")
            self._length = device.texture((1, 1), "R32UI")

    def rasterise(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws splats that cover many cells; without image atomics, all. Comes before `cover`."""
        for draw in draws:
            count = self._listed(draw, view, shared) if self._listing else 0
            if self._atomics and count == 0:
                continue
            listed = self._atomics and count <= LISTED
            program = raster_program(self._kind(draw), listed, self._identified)
            textures = {**self._textures(draw, shared), **({"ps_list": self._list} if listed else {})}
            self._device.draw(
                program,
                self._depths.target,
                uniforms=self._record(program, draw, view),
                textures=textures,
                vertices=VERTICES * (count if listed else draw.elements),
                depth_test=True,
            )

    def cover(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws all other splats, nearer than what is there."""
        if self._atomics:
            self._cover("DEPTH", draws, view, shared, {"depths": self._depths.depths})

    def _cover(
        self,
        step: str,
        draws: list[PageDraw],
        view: SampleView,
        shared: dict[str, Texture],
        images: dict[str, Texture],
    ) -> None:
        """Runs one step of the compute shaders over all splats."""
        for draw in draws:
            program = cover_program(self._kind(draw), step)
            self._dispatch(program, draw, view, {**self._textures(draw, shared), **self._depths.textures}, images)

    def _kind(self, draw: PageDraw) -> SplatKind:
        page = draw.page
        round_balls = self._round_balls and page.balls and not (page.nodes or page.partly)
        lattice, alone = self._depths.lattice, page.ball_material >= 0
        return SplatKind(self._options, draw.whole >= 0, round_balls, alone, lattice, page.nodes, page.partly)

    def _listed(self, draw: PageDraw, view: SampleView, shared: dict[str, Texture]) -> int:
        """Lists the splats of a page that cover many cells, and returns how many there are."""
        program = cover_program(self._kind(draw), "LIST")
        # The side of a square of so many cells, in pixels, without the cells at its ends.
        wide = (MOST_CELLS**0.5 - 2) / np.hypot(self._depths.lattice.p, self._depths.lattice.q)
        if not splats_in_picture(draw, view, wide):
            return 0
        self._device.fill(self._list)
        self._device.fill(self._length)
        images = {"list": self._list, "list_length": self._length}
        self._dispatch(program, draw, view, self._textures(draw, shared), images, wide)
        return (int(self._device.read(self._length)[0, 0]) + 1) & 0xFFFFFFFF

    def _dispatch(
        self,
        program: Interface,
        draw: PageDraw,
        view: SampleView,
        textures: dict[str, Texture],
        images: dict[str, Texture],
        wide: float = 0.0,
    ) -> None:
        """Runs a program over the splats of a page that a view shows. `wide`: see splats_in_picture."""
        for first, last in splats_in_picture(draw, view, wide):
            record = self._record(program, draw, view, first_splat=first, splats=last)
            groups = -(-(last - first) // program.local_size)
            self._device.dispatch(program, groups, uniforms=record, textures=textures, images=images)

    def _textures(self, draw: PageDraw, shared: dict[str, Texture]) -> dict[str, Texture]:
        return {**shared, **draw.textures}

    def _record(self, program: Interface, draw: PageDraw, view: SampleView, **own: object) -> np.ndarray:
        assert program.block is not None
        known = {**self._depths.values, "first_index": draw.first_index, "list_size": LISTED, **own}
        names = {name for _, name in program.block.fields}
        return draw.record(view, program.block, **{name: value for name, value in known.items() if name in names})

    def release(self) -> None:
        if self._listing:
            self._list.release()
            self._length.release()


class SplatCover(SplatDepths):
    """Draws the opaque splats of one picture into its visibility buffer."""

    def __init__(
        self, device: Device, options: PointOptions, buffer: VisibilityBuffer, wide: bool, round_balls: bool
    ) -> None:
        """`wide`: some splats may cover more than MOST_CELLS cells. `round_balls`: all balls stay round."""
        super().__init__(device, options, buffer, wide, round_balls)
        self._buffer = buffer

    def identify(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws the numbers of what `cover` has drawn."""
        if self._atomics:
            self._cover("IDENTIFY", draws, view, shared, {"ids": self._buffer.ids, "keys": self._buffer.keys})

    def write_attributes(
        self,
        variant: Variant,
        draws: list[PageDraw],
        view: SampleView,
        shared: dict[str, Texture],
        groups: Groups,
        leaders: Leaders,
        out: GBuffer,
    ) -> None:
        """Writes the attributes of the splats that stand for groups."""
        for draw in draws:
            program = surface_program(self._kind(draw), variant, leaders)
            read = {**leaders.bound, **groups.codes, "ps_ids": self._buffer.ids, "ps_keys": self._buffer.keys}
            self._device.draw(
                program,
                out.target,
                uniforms=self._record(program, draw, view, rectangle=leaders.place[0], corner=leaders.place[1]),
                textures={**self._textures(draw, shared), **read},
                vertices=6,
            )
