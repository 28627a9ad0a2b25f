"""Brings what receivers have gathered to all groups of a list: shaders/indirect/interpolate.frag."""

from __future__ import annotations

from ....shading.interface import Interface
from ..uniforms import CAMERA_FIELDS, block
from .pages import RECEIVER_WIDTH

TILE = 4  # pixels along the side of the squares that have receivers of their own
INTERPOLATE_BLOCK = block("Interpolate", CAMERA_FIELDS)
READ = (
    "ps_list",
    "ps_places",
    "ps_ups",
    "ps_tiles",
    "ps_receivers",
    "ps_receiver_pixels",
    "ps_found_diffuse",
    "ps_found_glossy",
)
INTERPOLATE = Interface(
    "interpolate", fragment="indirect/interpolate.frag", block=INTERPOLATE_BLOCK,
    samplers=tuple(("FLOAT_2D", name) for name in READ),
    outputs=(("vec4", "out_gathered"), ("vec4", "out_mirrored")),
    defines=(("PS_TILE", str(TILE)), ("PS_RECEIVER_WIDTH", str(RECEIVER_WIDTH))),
)  # fmt: skip
