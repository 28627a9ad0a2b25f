"""Draws balls that are wide on the screen into the G-buffer: each pixel's ray meets them exactly."""

from __future__ import annotations

from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..pages.point_page import PageDraw, PointOptions, attributes, page_block
from ..uniforms import SampleView

VERTICES = 6  # of a rectangle


def program(variant: Variant, options: PointOptions) -> Interface:
    """Returns the program for one variant of the G-buffer."""
    samplers, defines = attributes(variant, options)
    rows = tuple(("flat", "vec3", name) for name in ("v_centre", "v_row0", "v_row1", "v_row2", "v_element"))
    return Interface(
        "spheres",
        vertex="visibility/sphere.vert",
        fragment="visibility/sphere.frag",
        block=page_block("Spheres", options),
        samplers=samplers,
        varyings=rows,
        outputs=variant.front_outputs,
        defines=(*variant.front_defines, *defines),
        depth=True,
    )


def draw(
    device: Device,
    program: Interface,
    draws: list[PageDraw],
    view: SampleView,
    shared: dict[str, Texture],
    out: GBuffer,
) -> None:
    """Draws all wide balls of the cut into the G-buffer."""
    assert program.block is not None
    for part in draws:
        device.draw(
            program,
            out.target,
            uniforms=part.record(view, program.block),
            textures={**shared, **part.textures},
            vertices=VERTICES * part.elements,
            depth_test=True,
        )
