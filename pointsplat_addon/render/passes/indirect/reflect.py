"""Brings what rays have met to all groups whose lobes it lies in: shaders/indirect/reflect.frag."""

from __future__ import annotations

from ....shading.interface import Interface
from ..uniforms import CAMERA_FIELDS, block

REFLECT_BLOCK = block("Reflect", CAMERA_FIELDS, (("vec4", "to_eye"),))  # of all, where the camera has no perspective
READ = ("ps_list", "ps_places", "ps_rays", "ps_in_cells", "ps_shown", "ps_ends", "ps_kinds", "ps_of_pixels")
REFLECT = Interface(
    "reflect", fragment="indirect/reflect.frag", block=REFLECT_BLOCK, outputs=(("vec4", "out_mirrored"),),
    samplers=tuple(("FLOAT_2D", name) for name in READ),
)  # fmt: skip
