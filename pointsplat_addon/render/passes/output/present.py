"""TODO: say what this module is."""

from __future__ import annotations

from ....shading.interface import Interface
from ..tiles import TILE_DEFINE
from ..uniforms import FRAME


def present_program(surface: bool, adaptive: bool = False) -> Interface:
    """The finished picture into the viewport. `surface`: something has a depth. `adaptive`: pixels differ in how many
    samples they have (render/passes/tiles.py)."""
    named = {"ps_place": surface, "ps_counts": adaptive}
    return Interface(
        "present", vertex="output/present.vert", fragment="output/present.frag", block=FRAME,
        samplers=(("FLOAT_2D", "ps_combined"), *(("FLOAT_2D", name) for name, on in named.items() if on)),
        varyings=(("smooth", "vec2", "v_place"),), outputs=(("vec4", "out_color"),), depth=True,
        defines=((("PS_SURFACES", "1"),) if surface else ()) + ((TILE_DEFINE,) if adaptive else ()),
    )  # fmt: skip
