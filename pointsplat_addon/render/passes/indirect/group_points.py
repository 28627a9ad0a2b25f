"""Where the groups of a list are, and how they are turned: shaders/indirect/group_points.frag."""

from __future__ import annotations

from ....shading.interface import Interface
from ..gbuffer import Variant
from ..uniforms import CAMERA_FIELDS, block

GROUP_POINTS_BLOCK = block("GroupPoints", CAMERA_FIELDS, (("mat4", "tree_from_view"),))


def group_points_program(variant: Variant, mirrors: bool = False) -> Interface:
    """Returns the program for G-buffers of a variant, which has normals. `mirrors`: also where each mirrors the
    eye to."""
    read = (
        *variant.samplers(only=("centre", "shape", "normal")),
        ("FLOAT_2D", "ps_list"),
        ("FLOAT_2D", "ps_materials"),
    )
    return Interface(
        "group_points", fragment="indirect/group_points.frag", block=GROUP_POINTS_BLOCK, samplers=read,
        outputs=(("vec4", "out_place"), ("vec4", "out_up"), *((("vec4", "out_ray"),) if mirrors else ())),
        defines=tuple((f"PS_{name}", "1") for name, on in (("SURFACE", variant.surface), ("MIRRORS", mirrors)) if on),
    )  # fmt: skip
