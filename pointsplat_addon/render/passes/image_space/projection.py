"""Projects splats to pixels and finds the nearest splat of each pixel (Marroquim et al. 2008, section 3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.numeric.record import value_record
from ....shading.interface import Block, Interface
from ...device.packing import paged
from ...device.protocol import EMPTY, Device, Target, Texture
from ..gbuffer import Variant
from ..pages.point_page import POINT_SAMPLERS, PageDraw, PointOptions, attributes, page_block
from ..tiles import TILE_DEFINE, Region
from ..uniforms import SampleView


@value_record
class PointPrograms:
    """Interfaces of the passes that bring points to pixels."""

    nearest: Interface
    identify: Interface
    mark: Interface
    raster: Interface
    resolve: Interface


def programs(variant: Variant, options: PointOptions) -> PointPrograms:
    """The programs of one variant; which of them are compiled depends on the device."""
    instances = () if options.one_instance else (("FLOAT_2D", "ps_instances"),)
    cull = (("FLOAT_2D", "ps_materials"),) if options.cull else ()
    common = (*POINT_SAMPLERS, *instances)
    names = (
        ("PS_ONE_INSTANCE", options.one_instance),
        ("PS_CULL", options.cull),
        ("PS_ELLIPSES", options.ellipses),
        ("PS_DISCONNECTED", options.disconnected),
        ("PS_COARSE", options.coarse),
    )
    defines = tuple((name, "1") for name, on in names if on)
    nearest = Interface(
        "project",
        compute="image_space/project.comp",
        block=page_block("Project", options),
        samplers=(*common, *cull),
        images=(("R32UI", "depth"),),
        defines=defines,
    )
    identify = Interface(
        "identify",
        compute="image_space/project.comp",
        block=_indexed(options),
        samplers=(*common, *cull, ("UINT_2D", "ps_depth")),
        images=(("R32UI", "ids"),),
        defines=(*defines, ("PS_IDENTIFY", "1")),
    )
    mark = Interface(
        "mark",
        compute="image_space/project.comp",
        block=page_block("Project", options),
        samplers=(*common, *cull, ("FLOAT_2D", "ps_tiles")),
        images=(("R32UI", "marks"),),
        defines=(*defines, ("PS_MARK", "1"), TILE_DEFINE),
    )
    raster = Interface(
        "project",
        vertex="image_space/project.vert",
        fragment="image_space/project.frag",
        block=_indexed(options),
        samplers=(*common, *cull),
        varyings=(
            ("flat", "uint", "ps_id"),
            ("flat", "float", "ps_order"),
            *((("flat", "vec3", "ps_ellipse"), ("flat", "vec2", "ps_centre")) if options.disconnected else ()),
        ),
        outputs=(("uint", "id"),),
        depth=True,
        defines=defines,
    )
    samplers, named = attributes(variant, options)
    flags = {
        "PS_DEPTH": options.depth,
        "PS_ELLIPSES": options.ellipses,
        "PS_DISCONNECTED": options.disconnected,
        "PS_COARSE": options.coarse,
    }
    resolve = Interface(
        "resolve",
        fragment="image_space/resolve.frag",
        block=_indexed(options),
        samplers=(*samplers, ("UINT_2D", "ps_ids")),
        outputs=variant.front_outputs,
        defines=(*variant.front_defines, *named, *((name, "1") for name, on in flags.items() if on)),
        depth=options.depth,
    )
    return PointPrograms(nearest, identify, mark, raster, resolve)


def _indexed(options: PointOptions) -> Block:
    """With the index of the page's first splat among all that are drawn."""
    return page_block("ProjectIndexed", options, (("int", "first_index"),))


def record_of(program: Interface, draw: PageDraw, view: SampleView) -> np.ndarray:
    """Returns the uniforms of one of the programs of points."""
    assert program.block is not None
    own = {"first_index": draw.first_index}
    names = {name for _, name in program.block.fields}
    return draw.record(view, program.block, **{name: value for name, value in own.items() if name in names})


class Projection:
    """Finds which splat of the cut each pixel shows."""

    def __init__(self, device: Device, options: PointOptions, size: tuple[int, int]) -> None:
        self.device, self.programs = device, programs(Variant(), options)
        self.ids = device.texture(size, "R32UI")
        self.depth = device.texture(size, "R32UI") if device.limits.image_atomics else None
        self.raster_target: Target | None = None if self.depth else device.target([self.ids], depth=True)

    def run(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Writes the index of the nearest splat of each pixel into `ids`."""
        if self.depth is None:
            self._rasterise(draws, view, shared)
            return
        self.device.fill(self.depth)
        self.device.fill(self.ids)
        steps = ((self.programs.nearest, {"depth": self.depth}), (self.programs.identify, {"ids": self.ids}))
        for program, images in steps:
            for draw in draws:
                self.device.dispatch(
                    program,
                    -(-draw.elements // program.local_size),
                    uniforms=record_of(program, draw, view),
                    textures={**shared, **draw.textures, "ps_depth": self.depth},
                    images=images,
                )

    def within(
        self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture], region: Region
    ) -> list[PageDraw]:
        """Returns the draws without blocks that have no splat in the region; the caller frees their `blocks`.

        Without image atomics blocks cannot be told apart, and all are kept.
        """
        if self.depth is None or region.mask is None:
            return draws
        program, found, index = self.programs.mark, [], 0
        for draw in draws:
            assert draw.blocks is not None  # only the visibility buffer draws whole pages
            marks = self.device.texture(draw.blocks.size, "R32UI")
            self.device.fill(marks)
            self.device.dispatch(
                program,
                -(-draw.elements // program.local_size),
                uniforms=record_of(program, draw, view),
                textures={**shared, **draw.textures, "ps_tiles": region.mask},
                images={"marks": marks},
            )
            marked = self.device.read(marks).reshape(-1)[: draw.count] != EMPTY
            marks.release()
            rows = self.device.read(draw.blocks).reshape(-1, 4)[: draw.count][marked]
            if len(rows):
                size, data = paged(rows, 4)
                texture = self.device.texture(size, "RGBA32F", data)
                found.append(replace(draw, blocks=texture, count=len(rows), first_index=index))
                index += found[-1].elements
        return found

    def _rasterise(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Without image atomics: one-pixel points through the depth test."""
        assert self.raster_target is not None
        self.device.clear(self.raster_target)
        for draw in draws:
            self.device.draw(
                self.programs.raster,
                self.raster_target,
                uniforms=record_of(self.programs.raster, draw, view),
                textures={**shared, **draw.textures},
                vertices=draw.elements,
                primitive="POINTS",
                depth_test=True,
            )

    def release(self) -> None:
        if self.raster_target is not None:
            self.raster_target.release()
        self.ids.release()
        if self.depth is not None:
            self.depth.release()
