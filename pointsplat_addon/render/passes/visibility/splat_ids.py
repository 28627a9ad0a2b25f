"""Draws opaque splats into the visibility buffer, exactly: balls as ellipsoids, others as elliptical disks.

Small splats are drawn by one compute invocation each (Günther et al. 2013; Schütz et al. 2021), in two passes of
atomics: the least depth of each sub-sample, then the lowest number among the splats that have it, so that the result
does not depend on the order of threads. Those that cover many cells are listed and rasterised before that, into the
same textures. Without image atomics all are rasterised.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Device, Target, Texture
from ..gbuffer import GBuffer, Variant
from ..pages.point_page import POINT_SAMPLERS, PageDraw, PointOptions, attributes, page_block
from ..uniforms import Fields, SampleView
from .buffer import LATTICE_DEFINE, LATTICE_FIELDS, OUTPUTS, VisibilityBuffer, sub_sample_defines
from .groups import Groups, Leaders

MOST_CELLS = 512  # of a splat that a compute invocation draws: a ball of 3 pixels in radius
LISTED = 1 << 18  # splats that a list holds; where more cover many cells, the rasteriser is given all
VERTICES = 6  # of a rectangle
FIRST: Fields = (("int", "first_index"),)
LIST_SIZE: Fields = (("int", "list_size"),)


def _defines(options: PointOptions) -> tuple[tuple[str, str], ...]:
    named = {
        "PS_ONE_INSTANCE": options.one_instance,
        "PS_CULL": options.cull,
        "PS_ELLIPSES": options.ellipses,
    }
    return (LATTICE_DEFINE, ("PS_MOST_CELLS", str(MOST_CELLS)), *((name, "1") for name, on in named.items() if on))


def _samplers(options: PointOptions) -> tuple[tuple[str, str], ...]:
    instances = () if options.one_instance else (("FLOAT_2D", "ps_instances"),)
    return (*POINT_SAMPLERS, *instances, *((("FLOAT_2D", "ps_materials"),) if options.cull else ()))


def cover_program(options: PointOptions, step: str) -> Interface:
    """Returns the compute program of one `step`: LIST, DEPTH or IDENTIFY."""
    images = {"LIST": ("list", "list_length"), "DEPTH": ("depths",), "IDENTIFY": ("ids",)}[step]
    own = {"LIST": LIST_SIZE, "DEPTH": (), "IDENTIFY": FIRST}[step]
    return Interface(
        "cover",
        compute="visibility/splat.comp",
        block=page_block("Cover", options, LATTICE_FIELDS, own),
        samplers=(*_samplers(options), *((("UINT_2D", "ps_depths"),) if step == "IDENTIFY" else ())),
        images=tuple(("R32UI", name) for name in images),
        defines=(*_defines(options), (f"PS_{step}", "1")),
    )


def raster_program(options: PointOptions, listed: bool) -> Interface:
    """Returns the program that rasterises splats. `listed`: those of a list; else all of a page's blocks."""
    return Interface(
        "cover",
        vertex="visibility/splat.vert",
        fragment="visibility/splat_ids.frag",
        block=page_block("RasterSplats", options, LATTICE_FIELDS, FIRST),
        samplers=(*_samplers(options), *((("UINT_2D", "ps_list"),) if listed else ())),
        varyings=(("flat", "uint", "v_index"),),
        outputs=OUTPUTS,
        defines=(*_defines(options), *((("PS_LISTED", "1"),) if listed else ())),
        depth=True,
    )


def keys_program(options: PointOptions) -> Interface:
    """Returns the program that writes the keys of the surfaces that compute invocations have drawn."""
    return Interface(
        "cover",
        fragment="visibility/splat_ids.frag",
        block=page_block("SplatKeys", options, LATTICE_FIELDS, FIRST),
        samplers=(*_samplers(options), ("UINT_2D", "ps_ids")),
        outputs=(("uint", "out_key"),),
        defines=(*_defines(options), ("PS_KEYS", "1")),
    )


def surface_program(variant: Variant, options: PointOptions, lattice: Lattice, leaders: Leaders) -> Interface:
    """Returns the program that writes the attributes of splats that stand for groups of sub-samples."""
    samplers, named = attributes(variant, options)
    cull = (("FLOAT_2D", "ps_materials"),) if options.cull else ()
    averaged = ("ps_ids", "ps_first", "ps_second") if variant.color or variant.emission else ()
    read = (*leaders.samplers, *(("UINT_2D", name) for name in (() if leaders.central else averaged)))
    return Interface(
        "attributes",
        fragment="visibility/splat_surface.frag",
        block=page_block("SplatSurface", options, LATTICE_FIELDS, FIRST),
        samplers=(*samplers, *cull, *read),
        outputs=variant.outputs(),
        defines=(
            *_defines(options),
            *((name, "1") for name in variant.defines),
            *(entry for entry in named if entry[0] != "PS_ONE_INSTANCE"),
            *sub_sample_defines(lattice),
            *leaders.defines,
        ),
    )


class SplatCover:
    """Draws the opaque splats of one picture into its visibility buffer."""

    def __init__(self, device: Device, options: PointOptions, buffer: VisibilityBuffer, wide: bool) -> None:
        """`wide`: some splats may cover more than MOST_CELLS cells."""
        self._device, self._options, self._buffer = device, options, buffer
        self._atomics = device.limits.image_atomics
        self._listing = wide and self._atomics
        if self._listing:
            self._list = device.texture((PAGE_WIDTH, LISTED // PAGE_WIDTH), "R32UI")
            self._length = device.texture((1, 1), "R32UI")
        self._keys: Target = device.target([buffer.keys])

    def rasterise(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws splats that cover many cells; without image atomics, all. Comes before `cover`."""
        for draw in draws:
            count = self._listed(draw, view, shared) if self._listing else 0
            if self._atomics and count == 0:
                continue
            listed = self._atomics and count <= LISTED
            program = raster_program(self._options, listed)
            textures = {**self._textures(draw, shared), **({"ps_list": self._list} if listed else {})}
            self._device.draw(
                program,
                self._buffer.target,
                uniforms=self._record(program, draw, view),
                textures=textures,
                vertices=VERTICES * (count if listed else draw.elements),
                depth_test=True,
            )

    def cover(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws all other splats, nearer than what is there."""
        if not self._atomics:
            return
        buffer = self._buffer
        for step, images in (("DEPTH", {"depths": buffer.depths}), ("IDENTIFY", {"ids": buffer.ids})):
            program = cover_program(self._options, step)
            for draw in draws:
                self._dispatch(program, draw, view, {**self._textures(draw, shared), **buffer.textures}, images)
        program = keys_program(self._options)
        for draw in draws:
            self._device.draw(
                program,
                self._keys,
                uniforms=self._record(program, draw, view),
                textures={**self._textures(draw, shared), "ps_ids": buffer.ids},
            )

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
        program = surface_program(variant, self._options, self._buffer.lattice, leaders)
        for draw in draws:
            read = {**leaders.bound, **groups.codes, "ps_ids": self._buffer.ids}
            self._device.draw(
                program,
                out.target,
                uniforms=self._record(program, draw, view),
                textures={**self._textures(draw, shared), **read},
            )

    def _listed(self, draw: PageDraw, view: SampleView, shared: dict[str, Texture]) -> int:
        """Lists the splats of a page that cover many cells, and returns how many there are."""
        program = cover_program(self._options, "LIST")
        self._device.fill(self._list)
        self._device.fill(self._length)
        images = {"list": self._list, "list_length": self._length}
        self._dispatch(program, draw, view, self._textures(draw, shared), images)
        return (int(self._device.read(self._length)[0, 0]) + 1) & 0xFFFFFFFF

    def _dispatch(
        self,
        program: Interface,
        draw: PageDraw,
        view: SampleView,
        textures: dict[str, Texture],
        images: dict[str, Texture],
    ) -> None:
        groups, record = -(-draw.elements // program.local_size), self._record(program, draw, view)
        self._device.dispatch(program, groups, uniforms=record, textures=textures, images=images)

    def _textures(self, draw: PageDraw, shared: dict[str, Texture]) -> dict[str, Texture]:
        return {**shared, **draw.page.textures, "ps_blocks": draw.blocks}

    def _record(self, program: Interface, draw: PageDraw, view: SampleView, **own: object) -> np.ndarray:
        assert program.block is not None
        known = {**self._buffer.values, "first_index": draw.first_index, "list_size": LISTED, **own}
        names = {name for _, name in program.block.fields}
        return draw.record(view, program.block, **{name: value for name, value in known.items() if name in names})

    def release(self) -> None:
        self._keys.release()
        if self._listing:
            self._list.release()
            self._length.release()
