"""Where the groups of a list are, and how they are turned: shaders/indirect/places.frag."""

from __future__ import annotations

from ....shading.interface import Interface
from ..gbuffer import Variant
from ..uniforms import CAMERA_FIELDS, block

PLACES_BLOCK = block("Places", CAMERA_FIELDS, (("mat4", "tree_from_view"),))


def places_program(variant: Variant) -> Interface:
    """Returns the program for G-buffers of a variant, which has normals."""
    read = (
        *variant.samplers(only=("centre", "shape", "normal")),
        ("FLOAT_2D", "ps_list"),
        ("FLOAT_2D", "ps_materials"),
    )
    names = tuple(name for name in variant.defines if name in ("PS_NORMAL", "PS_SURFACE"))
    return Interface(
        "gather", fragment="indirect/places.frag", block=PLACES_BLOCK, samplers=read,
        outputs=(("vec4", "out_place"), ("vec4", "out_up")),
        defines=(("PS_GROUPED", "1"), *((name, "1") for name in names)),
    )  # fmt: skip
