"""Brings the depths of one view from a light into its place in the texture of all maps."""

from __future__ import annotations

from ....shading.interface import Interface
from ...device.protocol import Device, Target
from ..uniforms import RECTANGLE_FIELDS, Fields, block
from ..visibility.buffer import DepthBuffer

PLACE_FIELDS: Fields = (("ivec2", "corner"), ("float", "near"))  # corner: of the place, in texels
BLOCK = block("KeepDepths", RECTANGLE_FIELDS, PLACE_FIELDS)
PROGRAM = Interface(
    "shadow maps",
    vertex="common/rectangle.vert",
    fragment="shadow/keep_depths.frag",
    block=BLOCK,
    samplers=(("UINT_2D", "ps_depths"),),
    outputs=(("float", "out_depth"),),
)


def keep_depths(
    device: Device, depths: DepthBuffer, near: float, corner: tuple[int, int], size: tuple[int, int], maps: Target
) -> None:
    """Copies the first `size` (columns, rows) texels of depths, which count from `near`, to `corner` in `maps`."""
    width, height = maps.colors[0].size
    (x, y), (columns, rows) = corner, size
    rectangle = x / width, y / height, (x + columns) / width, (y + rows) / height
    record = BLOCK.record(rectangle=rectangle, corner=corner, near=near)
    device.draw(PROGRAM, maps, uniforms=record, textures=depths.textures, vertices=6)
