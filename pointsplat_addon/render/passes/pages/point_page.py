"""Pages of opaque splats, and the blocks of consecutive splats that a view draws of them.

A page holds the splats of several point sets. Texture by texture, one texel a splat:
  position        xyz relative to the set's origin; packed normal (octahedral; -1: a ball)
  extent          half-axes (major, minor; negative: a disconnected splat), packed major axis, material row
  color           base colour                    \\  where any set of the scene has them
  surface         roughness, metallic             |
  emission        emitted radiance                |
  shading_normal  packed normal, -1: the splat's  /
  velocity        object units a frame, where a pass asks for it
A page of balls alone, all of one material, keeps their radius in the place of the packed normal, and has no extent,
where the visibility buffer draws it and all of each is covered.
Pages of nodes that stand for several balls (core/lod/balls) hold their shapes instead of extents:
  position        xyz; -1 - saturation
  extent          xx, xy, xz of the shape, material row
  moments         yy, yz, zz of the shape, total area
A block is up to 2^shift consecutive splats of one instance: texel (x, y) of the first one, count, instance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....core.numeric.record import value_record
from ....core.numeric.segments import owners, ranks
from ....core.scene.materials import MaterialTable
from ....shading.interface import Block
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Device, Texture
from ...prepare.point_sets import Layer, PointSet
from ..gbuffer import Variant
from ..uniforms import CAMERA_FIELDS, ONE_INSTANCE_FIELDS, Fields, SampleView, Values, block
from .splat_page import (
    SplatPage,
    Write,
    extent,
    facets,
    filled,
    position_and_normal,
    position_and_radius,
    row_bounds,
    shading_normal,
    velocity,
)

LONG_BLOCK, SHORT_BLOCK = 6, 3  # log2 of the splats in a block: ranges of many splats, and of few
# What lib/data/splat.glsl reads where a view draws all splats of a page, as one instance; else it reads the blocks.
WHOLE_FIELDS: Fields = (("int", "splats"), ("int", "only_instance"))
BLOCK_FIELDS: Fields = (
    ("int", "block_count"),
    ("int", "block_shift"),  # log2 of the splats in a block
)
BALL_PAGE_FIELDS: Fields = (("int", "ball_material"),)  # row of the material of a page without extents
POINT_SAMPLERS = (("FLOAT_2D", "ps_blocks"), ("FLOAT_2D", "ps_position"), ("FLOAT_2D", "ps_extent"))


@value_record
class PointOptions:
    """Shader variants of the point passes."""

    shading_normal: bool = False
    facets: bool = False  # some splats have several normals
    velocity: bool = False  # a pass asks how splats move, and some do
    cull: bool = False
    holdout: bool = False
    ellipses: bool = False  # some splats are not round
    one_instance: bool = False
    disconnected: bool = False  # some splats close no surface with others
    depth: bool = False  # polygons share the G-buffer
    coarse: bool = False  # nodes are so wide that gaps between them show


class Page(SplatPage):
    """A page of opaque splats."""

    def __init__(
        self,
        device: Device,
        sets: list[PointSet],
        variant: Variant,
        options: PointOptions,
        table: MaterialTable,
        small: bool = False,
    ) -> None:
        """`small`: without extents where it can be, for the visibility buffer."""
        super().__init__(device, sets)
        clouds = self.clouds
        self.balls = all(cloud.normal is None for cloud in clouds)
        self.nodes = all(points.shape is not None for points in sets)  # or none is
        self.partly = any(cloud.share is not None for cloud in clouds)  # a fraction of some splats is covered
        # Of a page without extents; else -1.
        self.ball_material = _ball_material(sets) if small and not self.nodes else -1
        # Boxes around rows of splats, (R, 2, 3), and their largest radii, (R,), where one set fills more than one row.
        several = len(sets) == 1 and self.count > PAGE_WIDTH
        self.bounds, self.widest = row_bounds(clouds[0], sets[0].shape) if several else (None, None)
        if self.nodes:
            self.upload("position", "RGBA32F", [node_position(points) for points in sets])
            self.upload("extent", "RGBA32F", [node_extent(points) for points in sets])
            self.upload("moments", "RGBA32F", [points.shape[:, 3:7] for points in sets if points.shape is not None])
        elif self.ball_material >= 0:
            self.upload("position", "RGBA32F", [position_and_radius(c) for c in clouds])
        else:
            self.upload("position", "RGBA32F", [position_and_normal(c) for c in clouds])
            self.upload("extent", "RGBA32F", [
                extent(c, points=len(points.cloud)) for c, points in zip(clouds, sets, strict=True)
            ])  # fmt: skip
        if variant.color:
            self.upload("color", "RGBA16F", [filled(c, "color", table.base_color) for c in clouds])
        if variant.surface:
            constants = np.stack([table.roughness, table.metallic], axis=1)
            self.upload("surface", "RG32F", [filled(c, "surface", constants) for c in clouds])
        if variant.emission:
            self.upload("emission", "RGBA16F", [filled(c, "emission", table.emission) for c in clouds])
        if options.facets:
            self.upload("facets", "RGBA32F", [facets(c) for c in clouds])
        if options.shading_normal:
            self.upload("shading_normal", "R32F", [shading_normal(c) for c in clouds])
        if options.velocity:
            self.upload("velocity", "RGBA32F", [velocity(c) for c in clouds])
        self.clouds = []


def node_position(points: PointSet) -> Write:
    """Writes (N, 4) of nodes: position relative to the cloud's origin, -1 - saturation."""
    shape, position = points.shape, points.cloud.position
    assert shape is not None

    def write(out: np.ndarray, block: slice) -> None:
        for channel, column in enumerate(position.T):
            out[:, channel] = column[block]
        out[:, 3] = -1 - shape[block, 7]

    return write


def node_extent(points: PointSet) -> Write:
    """Writes (N, 4) of nodes: xx, xy, xz of the shape, material row."""
    shape, material = points.shape, points.cloud.material
    assert shape is not None

    def write(out: np.ndarray, block: slice) -> None:
        for column in range(3):
            out[:, column] = shape[block, column]
        out[:, 3] = 0 if material is None else material[block]

    return write


def _ball_material(sets: list[PointSet]) -> int:
    """Returns the row of the material of point sets that are round balls of one material alone; else -1."""
    if any(points.hierarchy is not None or not points.cloud.round_balls or points.cloud.share is not None
           for points in sets):  # fmt: skip
        return -1
    rows = {row for points in sets for row in points.cloud.material_rows().tolist()}
    return rows.pop() if len(rows) == 1 else -1


def blocks(layer: Layer, first: dict[int, int]) -> tuple[np.ndarray, int]:
    """Returns a cut as blocks, (B, 4) float32, and the log2 of a block's size. `first` is each point set's first splat
    in the page; sets that it lacks are skipped."""
    cut = layer.cut
    base = np.full(max(layer.point_sets, default=-1) + 2, -1)
    base[list(first)] = list(first.values())
    start = base[layer.set_of_instance[cut.instance]]
    mine = start >= 0
    instance, begin, count = cut.instance[mine], start[mine] + cut.first[mine], cut.count[mine]
    mean = count.mean() if len(count) else 0.0
    shift = LONG_BLOCK if mean >= 1 << (LONG_BLOCK - 1) else SHORT_BLOCK
    number = (count + (1 << shift) - 1) >> shift
    owner = owners(number)
    step = ranks(number) << shift
    at = begin[owner] + step
    rows = np.empty((len(owner), 4), np.float32)
    rows[:, 0], rows[:, 1] = at % PAGE_WIDTH, at // PAGE_WIDTH
    rows[:, 2] = np.minimum(count[owner] - step, 1 << shift)
    rows[:, 3] = instance[owner]
    return rows, shift


def instance_rows(
    view_from_object: np.ndarray, origin: np.ndarray, holdout: np.ndarray | None, some: np.ndarray | None = None
) -> np.ndarray:
    """Returns the texels of instances, (4 I, 4) float32: three rows of each matrix, which takes positions relative to
    the origin (I, 3) of its cloud; holdout. `some`: (n,) int, those that are drawn; others are zeros. None: all."""
    some = np.arange(len(view_from_object)) if some is None else some
    rows = np.zeros((len(view_from_object), 4, 4), np.float32)
    of_some = np.zeros((len(some), 4, 4))
    of_some[:, :3] = with_origin(view_from_object[some], origin[some])[:, :3]
    if holdout is not None:
        of_some[:, 3, 0] = holdout[some]
    rows[some] = np.nan_to_num(of_some, nan=0.0, posinf=0.0, neginf=0.0)
    return rows.reshape(-1, 4)


def with_origin(view_from_object: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Returns matrices (I, 4, 4) float64 that take positions relative to `origin` (I, 3)."""
    moved = view_from_object.copy()
    moved[:, :3, 3] += np.einsum("iab,ib->ia", view_from_object[:, :3, :3], origin)
    return moved


def attributes(
    variant: Variant, options: PointOptions
) -> tuple[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...]]:
    """Returns samplers and defines of a program that brings splats with their attributes into a G-buffer."""
    samplers = [*POINT_SAMPLERS]
    if not options.one_instance:
        samplers.append(("FLOAT_2D", "ps_instances"))
    has = {"ps_color": variant.color, "ps_surface": variant.surface, "ps_emission": variant.emission,
           "ps_velocity": variant.velocity}  # fmt: skip
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


def page_block(name: str, options: PointOptions, *groups: Fields, whole: bool = False) -> Block:
    """The uniform block of a pass that draws the blocks of a page, or a `whole` page, with further fields.

    `name`: as for `block`.
    """
    transform = ONE_INSTANCE_FIELDS if options.one_instance else ()
    return block(name, CAMERA_FIELDS, WHOLE_FIELDS if whole else BLOCK_FIELDS, transform, *groups)


@dataclass
class PageDraw:
    """What one view draws of one page."""

    page: Page
    blocks: Texture | None  # None: all splats of the page are drawn, as one instance
    count: int  # blocks
    shift: int
    first_index: int  # of this page's splats among all that are drawn
    transform: Values  # of ONE_INSTANCE_FIELDS, where there is only one instance; else none
    whole: int = -1  # the instance as which all splats of the page are drawn; -1: there is no such one
    view_from_page: np.ndarray | None = None  # (4, 4), of that one

    @property
    def textures(self) -> dict[str, Texture]:
        """What the passes of points read, by sampler name."""
        return self.page.textures if self.blocks is None else {**self.page.textures, "ps_blocks": self.blocks}

    @property
    def elements(self) -> int:
        return self.count << self.shift

    @property
    def splats(self) -> int:
        """How many splats the page has."""
        return self.page.count

    def record(self, view: SampleView, block: Block, **own: object) -> np.ndarray:
        """The record of a pass whose block is a `page_block`."""
        known = {
            "block_count": self.count,
            "block_shift": self.shift,
            "splats": self.splats,
            "only_instance": self.whole,
            "ball_material": self.page.ball_material,
        }
        names = {name for _, name in block.fields}
        known = {name: value for name, value in known.items() if name in names}
        return view.record(block, **{**known, **self.transform, **own})
