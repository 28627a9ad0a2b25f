"""Draws the picture so far, and its depth, into a viewport."""

from __future__ import annotations

import numpy as np

from ....core.scene.camera import Camera
from ....shading.interface import Block, Interface
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


def present_record(
    surface: bool, camera: Camera, size: tuple[int, int], corner: tuple[int, int], sample_weight: float
) -> np.ndarray:
    """The uniforms of `present_program`."""
    m = camera.clip_from_view
    depth = {"clip_from_depth": (m[2, 2], m[2, 3], m[3, 2], m[3, 3])} if surface else {}
    return present_block(surface).record(size=size, corner=corner, sample_weight=sample_weight, **depth)


def present_program(surface: bool, adaptive: bool = False) -> Interface:
    """The finished picture into the viewport. `surface`: something has a depth. `adaptive`: pixels differ in how many
    samples they have (render/passes/tiles.py)."""
    named = {"ps_centre": surface, "ps_counts": adaptive}
    return Interface(
        "present", vertex="output/present.vert", fragment="output/present.frag", block=present_block(surface),
        samplers=(("FLOAT_2D", "ps_combined"), *(("FLOAT_2D", name) for name, on in named.items() if on)),
        varyings=(("smooth", "vec2", "v_uv"),), outputs=(("vec4", "out_color"),), depth=True,
        defines=((("PS_SURFACES", "1"),) if surface else ()) + ((TILE_DEFINE,) if adaptive else ()),
    )  # fmt: skip
