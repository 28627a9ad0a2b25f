"""Points: uploaded once as pages of textures, sent to pixels as blocks of consecutive splats.

A page holds the splats of several point sets. Texture by texture, one texel a splat:
  place           xyz relative to the set's origin; packed normal (pack_normal; -1: a ball)
  extent          half-axes (major, minor; negative: stands apart), packed major axis, material row
  color           base colour                    \\  where any set of the scene has them
  surface         roughness, metallic             |
  emission        emitted radiance                |
  shading_normal  packed normal, -1: the splat's  /
A block is up to 2^shift consecutive splats of one instance: texel (x, y) of the first one, count, instance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...core.scene.materials import MaterialTable
from ...shading.interface import Interface
from ..device.packing import PAGE_WIDTH, paged
from ..device.protocol import EMPTY, Device, Target, Texture
from ..prepare.point_sets import Layer, PointSet
from .common import FRAME, GBuffer, Variant
from .pages import SplatPage, extent, facets, filled, place, shading_normal
from .tiles import TILE_DEFINE, Region

LONG_BLOCK, SHORT_BLOCK = 6, 3  # log2 of the splats in a block: ranges of many splats, and of few
DRAWN_LIMIT = 2**31 - 2**20  # indices of drawn splats are 32-bit

POINT_SAMPLERS = (("FLOAT_2D", "ps_blocks"), ("FLOAT_2D", "ps_place"), ("FLOAT_2D", "ps_extent"))


@dataclass(frozen=True)
class PointOptions:
    """Shader variants of the point passes."""

    shading_normal: bool = False
    facets: bool = False  # some splats have several normals
    cull: bool = False
    holdout: bool = False
    ellipses: bool = False  # some splats are not round
    one_instance: bool = False
    apart: bool = False  # some splats close no surface with others
    depth: bool = False  # polygons share the G-buffer
    coarse: bool = False  # nodes are so wide that gaps between them show


class Page(SplatPage):
    """Splats of opaque points."""

    def __init__(
        self, device: Device, sets: list[PointSet], variant: Variant, options: PointOptions, table: MaterialTable
    ) -> None:
        super().__init__(device, sets)
        clouds = self.clouds
        self.upload("place", "RGBA32F", 4, [place(c) for c in clouds])
        self.upload("extent", "RGBA32F", 4, [
            extent(c, points=len(points.cloud)) for c, points in zip(clouds, sets, strict=True)
        ])  # fmt: skip
        if variant.color:
            self.upload("color", "RGBA16F", 4, [filled(c, "color", table.base_color) for c in clouds])
        if variant.surface:
            constants = np.stack([table.roughness, table.metallic], axis=1)
            self.upload("surface", "RG32F", 2, [filled(c, "surface", constants) for c in clouds])
        if variant.emission:
            self.upload("emission", "RGBA16F", 4, [filled(c, "emission", table.emission) for c in clouds])
        if options.facets:
            self.upload("facets", "RGBA32F", 4, [facets(c) for c in clouds])
        if options.shading_normal:
            self.upload("shading_normal", "R32F", 1, [shading_normal(c) for c in clouds])
        self.clouds = []


def blocks(layer: Layer, first: dict[int, int]) -> tuple[np.ndarray, int]:
    """The cut as blocks, (B, 4) float32, and the log2 of a block's size. `first` is each point set's first splat in the
    page; sets that it lacks are skipped."""
    cut = layer.cut
    base = np.full(max(layer.point_sets, default=-1) + 2, -1)
    base[list(first)] = list(first.values())
    start = base[layer.set_of_instance[cut.instance]]
    mine = start >= 0
    instance, begin, count = cut.instance[mine], start[mine] + cut.first[mine], cut.count[mine]
    mean = count.mean() if len(count) else 0.0
    shift = LONG_BLOCK if mean >= 1 << (LONG_BLOCK - 1) else SHORT_BLOCK
    number = (count + (1 << shift) - 1) >> shift
    owner = np.repeat(np.arange(len(count)), number)
    step = (np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)) << shift
    at = begin[owner] + step
    rows = np.empty((len(owner), 4), np.float32)
    rows[:, 0], rows[:, 1] = at % PAGE_WIDTH, at // PAGE_WIDTH
    rows[:, 2] = np.minimum(count[owner] - step, 1 << shift)
    rows[:, 3] = instance[owner]
    return rows, shift


def instance_rows(view_from_object: np.ndarray, origin: np.ndarray, holdout: np.ndarray | None) -> np.ndarray:
    """(4 I, 4) float32: three rows of each matrix, with the origin (I, 3) of its cloud taken in; holdout."""
    rows = np.zeros((len(view_from_object), 4, 4))
    rows[:, :3] = with_origin(view_from_object, origin)[:, :3]
    if holdout is not None:
        rows[:, 3, 0] = holdout
    return np.nan_to_num(rows, nan=0.0, posinf=0.0, neginf=0.0).reshape(-1, 4).astype(np.float32)


def with_origin(view_from_object: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Matrices (I, 4, 4) that take positions relative to `origin` (I, 3); in float64, so that nothing cancels."""
    moved = view_from_object.copy()
    moved[:, :3, 3] += np.einsum("iab,ib->ia", view_from_object[:, :3, :3], origin)
    return moved


def attributes(
    variant: Variant, options: PointOptions
) -> tuple[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...]]:
    """Samplers and defines of a program that brings splats with their attributes into a G-buffer."""
    samplers = [*POINT_SAMPLERS]
    if not options.one_instance:
        samplers.append(("FLOAT_2D", "ps_instances"))
    has = {"ps_color": variant.color, "ps_surface": variant.surface, "ps_emission": variant.emission}
    samplers += [("FLOAT_2D", name) for name, on in has.items() if on]
    if variant.normal:
        kinds = {"ps_shading_normal": options.shading_normal, "ps_facets": options.facets}
        samplers += [("FLOAT_2D", name) for name, on in kinds.items() if on]
    named = {
        "PS_SHADING_NORMAL": options.shading_normal and variant.normal,
        "PS_FACETS": options.facets and variant.normal,
        "PS_HOLDOUT": options.holdout,
        "PS_ONE_INSTANCE": options.one_instance,
    }
    return tuple(samplers), tuple((name, "1") for name, on in named.items() if on)


@dataclass(frozen=True)
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
        ("PS_APART", options.apart),
        ("PS_COARSE", options.coarse),
    )
    defines = tuple((name, "1") for name, on in names if on)
    nearest = Interface(
        "project",
        compute="image_space/project.comp",
        block=FRAME,
        samplers=(*common, *cull),
        images=(("R32UI", "depth"),),
        defines=defines,
    )
    identify = Interface(
        "identify",
        compute="image_space/project.comp",
        block=FRAME,
        samplers=(*common, *cull, ("UINT_2D", "ps_depth")),
        images=(("R32UI", "ids"),),
        defines=(*defines, ("PS_IDENTIFY", "1")),
    )
    mark = Interface(
        "mark",
        compute="image_space/project.comp",
        block=FRAME,
        samplers=(*common, *cull, ("FLOAT_2D", "ps_tiles")),
        images=(("R32UI", "marks"),),
        defines=(*defines, ("PS_MARK", "1"), TILE_DEFINE),
    )
    raster = Interface(
        "project",
        vertex="image_space/project.vert",
        fragment="image_space/project.frag",
        block=FRAME,
        samplers=(*common, *cull),
        varyings=(
            ("flat", "uint", "ps_id"),
            ("flat", "float", "ps_order"),
            *((("flat", "vec3", "ps_ellipse"), ("flat", "vec2", "ps_centre")) if options.apart else ()),
        ),
        outputs=(("uint", "id"),),
        depth=True,
        defines=defines,
    )
    samplers, named = attributes(variant, options)
    flags = {
        "PS_DEPTH": options.depth,
        "PS_ELLIPSES": options.ellipses,
        "PS_APART": options.apart,
        "PS_COARSE": options.coarse,
    }
    resolve = Interface(
        "resolve",
        fragment="image_space/resolve.frag",
        block=FRAME,
        samplers=(*samplers, ("UINT_2D", "ps_ids")),
        outputs=variant.front_outputs,
        defines=(*variant.front_defines, *named, *((name, "1") for name, on in flags.items() if on)),
        depth=options.depth,
    )
    return PointPrograms(nearest, identify, mark, raster, resolve)


@dataclass
class PageDraw:
    """What one view draws of one page."""

    page: Page
    blocks: Texture
    count: int  # blocks
    shift: int
    first_index: int  # of this page's splats among all that are drawn
    uniforms: dict[str, object]

    @property
    def elements(self) -> int:
        return self.count << self.shift

    def fill(self, record: np.ndarray) -> np.ndarray:
        record["page"][0, :3] = self.first_index, self.count, self.shift
        for name, value in self.uniforms.items():
            record[name][0] = value
        return record


class Projection:
    """Which splat of the cut each pixel shows."""

    def __init__(self, device: Device, options: PointOptions, size: tuple[int, int]) -> None:
        self.device, self.programs = device, programs(Variant(), options)
        self.ids = device.texture(size, "R32UI")
        self.depth = device.texture(size, "R32UI") if device.limits.image_atomics else None
        self.raster_target: Target | None = None if self.depth else device.target([self.ids], depth=True)

    def run(self, draws: list[PageDraw], record: np.ndarray, shared: dict[str, Texture]) -> None:
        if self.depth is None:
            self._rasterise(draws, record, shared)
            return
        self.device.fill(self.depth)
        self.device.fill(self.ids)
        steps = ((self.programs.nearest, {"depth": self.depth}), (self.programs.identify, {"ids": self.ids}))
        for program, images in steps:
            for draw in draws:
                self.device.dispatch(
                    program,
                    -(-draw.elements // program.local_size),
                    uniforms=draw.fill(record),
                    textures={**shared, **draw.page.textures, "ps_blocks": draw.blocks, "ps_depth": self.depth},
                    images=images,
                )

    def within(
        self, draws: list[PageDraw], record: np.ndarray, shared: dict[str, Texture], region: Region
    ) -> list[PageDraw]:
        """The draws without the blocks that have no splat in the region; the caller frees their `blocks`.

        Without image atomics blocks cannot be told apart, and all are kept.
        """
        if self.depth is None or region.mask is None:
            return draws
        program, found, index = self.programs.mark, [], 0
        for draw in draws:
            marks = self.device.texture(draw.blocks.size, "R32UI")
            self.device.fill(marks)
            self.device.dispatch(
                program,
                -(-draw.elements // program.local_size),
                uniforms=draw.fill(record),
                textures={**shared, **draw.page.textures, "ps_blocks": draw.blocks, "ps_tiles": region.mask},
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

    def _rasterise(self, draws: list[PageDraw], record: np.ndarray, shared: dict[str, Texture]) -> None:
        """Without image atomics: one-pixel points through the depth test."""
        assert self.raster_target is not None
        self.device.clear(self.raster_target)
        for draw in draws:
            self.device.draw(
                self.programs.raster,
                self.raster_target,
                uniforms=draw.fill(record),
                textures={**shared, **draw.page.textures, "ps_blocks": draw.blocks},
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


def resolve(
    device: Device,
    program: Interface,
    ids: Texture,
    draws: list[PageDraw],
    record: np.ndarray,
    shared: dict[str, Texture],
    out: GBuffer,
    region: Region,
) -> None:
    """The identified splats' ellipses and attributes; pixels without one stay as they are."""
    for draw in draws:
        region.draw(
            device,
            program,
            out.target,
            uniforms=draw.fill(record),
            textures={**shared, **draw.page.textures, "ps_blocks": draw.blocks, "ps_ids": ids},
            depth_test=program.depth,
        )
