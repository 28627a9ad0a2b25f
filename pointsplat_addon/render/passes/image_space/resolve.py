"""TODO: say what this module is."""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer
from ..pages.point_page import PageDraw
from ..tiles import Region


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
