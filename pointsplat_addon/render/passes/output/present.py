"""Draws the picture so far, and its depth, into a viewport."""

from __future__ import annotations

from ....core.scene.camera import Camera
from ....shading.interface import Block, Interface
from ...device.protocol import Device, Texture
from ..tiles import TILE_DEFINE
from ..uniforms import Fields, block


def present_block(surface: bool) -> Block:
    """The uniforms of the pass `present`."""
    own: Fields = (
        ("ivec2", "size"),  # of the viewport in pixels
        ("ivec2", "corner"),  # of what it shows in the picture
        ("float", "sample_weight"),  # 1 over the samples of a pixel
    )
    # Clip z = x view z + y, clip w = z view z + w.
    depth: Fields = (("vec4", "clip_from_depth"),)
    return block("Present", own, depth if surface else ())


def present_program(surface: bool, adaptive: bool = False, smooth: bool = False) -> Interface:
    """Returns the program that draws the picture into the viewport.

    `surface`: something has a depth. `adaptive`: pixels differ in how many samples they have (render/passes/tiles.py).
    `smooth`: they are wider than the viewport's.
    """
    named = {"ps_centre": surface, "ps_counts": adaptive}
    return Interface(
        "present", vertex="output/present.vert", fragment="output/present.frag", block=present_block(surface),
        samplers=(("FLOAT_2D", "ps_combined"), *(("FLOAT_2D", name) for name, on in named.items() if on)),
        varyings=(("smooth", "vec2", "v_uv"),), outputs=(("vec4", "out_color"),), depth=True,
        defines=((("PS_SURFACES", "1"),) if surface else ()) + ((TILE_DEFINE,) if adaptive else ())
        + ((("PS_SMOOTH", "1"),) if smooth else ()),
    )  # fmt: skip


def draw_picture(
    device: Device,
    camera: Camera,
    corner: tuple[int, int],
    combined: Texture,
    sample_weight: float,
    centre: Texture | None = None,
    counts: Texture | None = None,
    size: tuple[int, int] | None = None,
    smooth: bool = False,
) -> None:
    """Draws a picture and its depth into the framebuffer that is bound, in the viewport that is set.

    `corner`: of the viewport in the texture `combined`. `sample_weight`: 1 over the samples in that. `centre`: of the
    G-buffer, where something has a depth. `counts`: samples of each tile, where they differ. `size`: of the viewport in
    pixels of the picture; None: that of the camera's window. `smooth`: these are wider than the viewport's, and colours
    change evenly between their centres.
    """
    _, _, *window = camera.window
    m = camera.clip_from_view
    depth = {"clip_from_depth": (m[2, 2], m[2, 3], m[3, 2], m[3, 3])} if centre is not None else {}
    program = present_program(centre is not None, counts is not None, smooth)
    record = present_block(centre is not None).record(
        size=size or window, corner=corner, sample_weight=sample_weight, **depth
    )
    given = {"ps_combined": combined, "ps_centre": centre, "ps_counts": counts}
    textures = {name: texture for name, texture in given.items() if texture is not None}
    device.draw(program, None, uniforms=record, textures=textures)
