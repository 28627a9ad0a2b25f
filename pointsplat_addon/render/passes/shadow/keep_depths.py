"""Brings the depths of one view from a light, or what belongs to them, to their place in the texture of all maps."""

from __future__ import annotations

from ....shading.interface import Interface
from ...device.protocol import Device, Target, Texture
from ..uniforms import RECTANGLE_FIELDS, Fields, block
from ..visibility.buffer import DEPTH_OUTPUT

PLACE_FIELDS: Fields = (("ivec2", "corner"),)  # of the place, in texels
BLOCK = block("KeepDepths", RECTANGLE_FIELDS, PLACE_FIELDS)
PROGRAM = Interface(
    "shadow maps",
    vertex="common/rectangle.vert",
    fragment="shadow/keep_depths.frag",
    block=BLOCK,
    samplers=(("UINT_2D", "ps_depths"),),
    outputs=DEPTH_OUTPUT,
)


def keep_depths(device: Device, depths: Texture, corner: tuple[int, int], size: tuple[int, int], maps: Target) -> None:
    """Copies the first `size` (columns, rows) texels of depths to `corner` in `maps`."""
    width, height = maps.colors[0].size
    (x, y), (columns, rows) = corner, size
    rectangle = x / width, y / height, (x + columns) / width, (y + rows) / height
    record = BLOCK.record(rectangle=rectangle, corner=corner)
    device.draw(PROGRAM, maps, uniforms=record, textures={"ps_depths": depths}, vertices=6)
