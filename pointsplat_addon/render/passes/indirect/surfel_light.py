"""Lights surfels by the lamps: shaders/indirect/surfel_light.frag."""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..shading.lighting import LIGHT_FIELDS, SAMPLE_FIELDS, lighting_defines, lighting_samplers
from ..uniforms import block
from .pages import paged_texture

WIDTH = 2048  # surfels in a row, of two texels each
TAPS = 4  # points of wide lights


def surfel_light_program(lighting: tuple[str, ...], medium: bool = False) -> Interface:
    """Returns the program that lights surfels; `lighting`: as of shade_program, without the world. `medium`: that
    lights places in media instead."""
    sampled = "PS_SHADOW_SAMPLE" in lighting
    taps = (("PS_SHADOW_TAPS", str(TAPS)),) if sampled else ()
    return Interface(
        "surfel_light", fragment="indirect/surfel_light.frag",
        block=block("SurfelLight", LIGHT_FIELDS, *((SAMPLE_FIELDS,) if sampled else ())),
        outputs=(("vec4", "out_light"),),
        samplers=(("FLOAT_2D", "ps_surfels"), *lighting_samplers(lighting)),
        defines=(*lighting_defines(lighting), *taps, *((("PS_MEDIUM", "1"),) if medium else ())),
    )  # fmt: skip


def lit_surfels(
    device: Device,
    lighting: tuple[str, ...],
    lights: int,
    position: np.ndarray,
    normal: np.ndarray,
    textures: dict[str, Texture],
    medium: bool = False,
) -> np.ndarray:
    """Returns the irradiance over pi, (N, 3) float32, of surfels whose places and normals (N, 3) are in view space.

    `medium`: the mean radiance over all directions instead, at places in media; normals are read as not 0.
    """
    count = len(position)
    zero = np.zeros(count, np.float32)
    surfels = paged_texture(device, np.column_stack([position, zero, normal, zero]), WIDTH)
    found = device.texture((WIDTH, surfels.size[1]), "RGBA32F")
    target = device.target([found])
    try:
        program = surfel_light_program(lighting, medium)
        assert program.block is not None
        values = {"light_count": lights, "sample_index": 0}
        record = program.block.record(**{name: values[name] for _, name in program.block.fields})
        device.draw(program, target, uniforms=record, textures={**textures, "ps_surfels": surfels})
        return device.read(found).reshape(-1, 4)[:count, :3]
    finally:
        for item in (target, found, surfels):
            item.release()
