"""Layers of panes as a light sees them: what of the next layer lies behind, and what passes up to one."""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.protocol import Device, Target, Texture
from ..uniforms import RECTANGLE_FIELDS, block
from ..visibility.buffer import DEPTH_OUTPUT
from .keep_depths import PLACE_FIELDS

SHARES_BLOCK = block("KeepShares", RECTANGLE_FIELDS, PLACE_FIELDS)
KEEP_SHARES = Interface(
    "shadow maps", vertex="common/rectangle.vert", fragment="shadow/keep_shares.frag", block=SHARES_BLOCK,
    samplers=(("FLOAT_2D", "ps_shares"),), outputs=DEPTH_OUTPUT,
)  # fmt: skip
FOLLOWING = Interface(
    "shadow maps", fragment="shadow/following.frag", samplers=(("UINT_2D", "ps_depths"),), outputs=DEPTH_OUTPUT
)


def keep_shares(device: Device, shares: np.ndarray, corner: tuple[int, int], maps: Target) -> None:
    """Writes the bits of shares of light (H, W) float32 at `corner` in `maps`."""
    (rows, columns), (width, height), (x, y) = shares.shape, maps.colors[0].size, corner
    rectangle = x / width, y / height, (x + columns) / width, (y + rows) / height
    texture = device.texture((columns, rows), "R32F", shares.reshape(-1))
    try:
        record = SHARES_BLOCK.record(rectangle=rectangle, corner=corner)
        device.draw(KEEP_SHARES, maps, uniforms=record, textures={"ps_shares": texture}, vertices=6)
    finally:
        texture.release()


def mark_following(device: Device, depths: Texture, following: Target) -> None:
    """Writes of which depths on the layer behind one may be, as PS_PEELED reads it, where that one has `depths`."""
    device.draw(FOLLOWING, following, textures={"ps_depths": depths})
