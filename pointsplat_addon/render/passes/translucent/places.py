"""Blends narrow translucent splats at a few places of each pixel, where one opaque thing or nothing lies behind them.

The places are those of a lattice of fewer sub-samples. Splats are widened by a Gaussian that is narrower than the pixel
filter, their masses kept, so that the places miss none of them. What is opaque is blurred as they are, and what both
show goes through weights that blur by the rest of the filter (`weights_of_blurred`): together that is the pixel filter,
within 2 % of it. Only where optical depths change by much within a tenth of a pixel is their transmittance another than
that of what is blurred; such tiles, and those with edges of what is opaque, are looked at in each sub-sample: cells.py.
"""

from __future__ import annotations

from ....core.numeric.lattice import FEW
from ....shading.interface import Interface
from ..tiles import TILE_DEFINE
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS
from .cells import CORNER_FIELD

PLACES = FEW
DEVIATION = 0.25  # pixels: of the Gaussian by which splats are widened
LEAST_FILTER = 1.4  # size of the pixel filter from which it is wide enough to leave weights for the rest of it
EXPAND_PLACES = block(
    "ExpandPlaces", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELD, RECTANGLE_FIELDS, (("ivec2", "low"), ("ivec2", "high"))
)
DIFFERENCE_PLACES = block(
    "DifferencePlaces", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELD,
    (("ivec2", "size_of_tile"), ("int", "sub_samples"), ("int", "neighbours")),
)  # fmt: skip
EXPAND_PLACES_PROGRAM = Interface(
    "expand", vertex="common/rectangle.vert", fragment="translucent/expand_places.frag", block=EXPAND_PLACES,
    samplers=tuple(("FLOAT_2D", name) for name in ("ps_opaque", "ps_place", "ps_wanted")),
    outputs=(("vec4", "out_layer"), ("vec4", "out_opaque"), ("float", "out_place")),
    defines=(LATTICE_DEFINE, TILE_DEFINE, ("PS_DEVIATION", repr(DEVIATION))),
)  # fmt: skip
DIFFERENCE_PLACES_PROGRAM = Interface(
    "difference", fragment="translucent/difference_places.frag", block=DIFFERENCE_PLACES,
    samplers=tuple(("FLOAT_2D", name) for name in ("ps_layer", "ps_opaque", "ps_members", "ps_weights")),
    outputs=(("vec4", "out_difference"),), defines=(LATTICE_DEFINE,),
)  # fmt: skip
