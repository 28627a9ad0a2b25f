"""Writes the ellipse and the attributes of each pixel's splat into the G-buffer."""

from __future__ import annotations

from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer
from ..pages.point_page import PageDraw
from ..tiles import Region
from ..uniforms import SampleView
from .projection import record_of


def resolve(
    device: Device,
    program: Interface,
    ids: Texture,
    draws: list[PageDraw],
    view: SampleView,
    shared: dict[str, Texture],
    out: GBuffer,
    region: Region,
) -> None:
    """Writes the ellipses and attributes of the identified splats; pixels without one stay as they are."""
    for draw in draws:
        region.draw(
            device,
            program,
            out.target,
            uniforms=record_of(program, draw, view),
            textures={**shared, **draw.textures, "ps_ids": ids},
            depth_test=program.depth,
        )
