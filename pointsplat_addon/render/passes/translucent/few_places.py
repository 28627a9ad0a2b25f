"""Blends narrow translucent splats at a few places of each pixel, where one opaque thing or nothing lies behind them.

The places are those of a lattice of fewer sub-samples. Splats are widened by a Gaussian that is narrower than the pixel
filter, their masses kept, so that the places miss none of them. What is opaque is blurred as they are, and what both
change goes through weights that blur by the rest of the filter (`weights_of_blurred`): together that is the pixel
filter. Where depths change evenly within such a Gaussian, the mean of exp(-depth) is known from their slope
(shaders/translucent/places/change.frag). Where they change by much and unevenly, where single splats are dense, and at
edges of what is opaque each sub-sample is looked at: cells.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.numeric.lattice import FEW, Lattice
from ....core.numeric.record import value_record
from ....core.splat.kernel import SUPPORT
from ....shading.interface import Interface
from ..tiles import TILE_DEFINE
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS
from .cells import CORNER_FIELD
from .centres import Centres


@value_record
class Places:
    """Where in pixels splats are looked at, and by how much these are widened."""

    lattice: Lattice
    deviation: float  # pixels: of the Gaussian by which splats are widened
    # What splats leave times the square of the change of depths from pixel to pixel, up to which widening is right.
    steep: float

    @property
    def defines(self) -> tuple[tuple[str, str], ...]:
        return (("PS_DEVIATION", repr(self.deviation)),)


PLACES = Places(FEW, 0.12, 0.2)
DENSE = 0.2  # optical depth through the middle of a splat from which widening it would change what it hides
MOST_EXACT = 0.5  # share of the pixels that need each sub-sample, up to which the others are drawn apart
LEAST_FILTER = 1.4  # size of the pixel filter from which it is wide enough to leave weights for the rest of it
EXPAND_PLACES = block(
    "ExpandPlaces", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELD, RECTANGLE_FIELDS, (("ivec2", "low"), ("ivec2", "high"))
)
DIFFERENCE_PLACES = block(
    "DifferencePlaces", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELD,
    (("ivec2", "size_of_tile"), ("int", "sub_samples"), ("int", "neighbours")),
)  # fmt: skip
DIFFERENCE_PLACES_PROGRAM = Interface(
    "difference", fragment="translucent/places/difference.frag", block=DIFFERENCE_PLACES,
    samplers=tuple(("FLOAT_2D", name) for name in ("ps_change", "ps_members", "ps_weights")),
    outputs=(("vec4", "out_difference"),), defines=(LATTICE_DEFINE,),
)  # fmt: skip
CHANGE_PLACES = block("ChangePlaces", (("float", "spacing"),))
PART_DEFINE, PART_SAMPLER = ("PS_PART", "1"), ("FLOAT_2D", "ps_part")  # only where that is not 0 is anything added


def expand_places_program(places: Places) -> Interface:
    """Returns the program that writes what is opaque at the places, and its depth."""
    return Interface(
        "expand", vertex="common/rectangle.vert", fragment="translucent/places/expand.frag", block=EXPAND_PLACES,
        samplers=tuple(("FLOAT_2D", name) for name in ("ps_opaque", "ps_place", "ps_wanted")),
        outputs=(("vec4", "out_opaque"), ("float", "out_place")),
        defines=(LATTICE_DEFINE, TILE_DEFINE, *places.defines),
    )  # fmt: skip


def change_places_program(places: Places) -> Interface:
    """Returns the program that writes what splats change at the places."""
    return Interface(
        "difference", fragment="translucent/places/change.frag", block=CHANGE_PLACES,
        samplers=tuple(("FLOAT_2D", name) for name in ("ps_layer", "ps_opaque", "ps_place")),
        outputs=(("vec4", "out_change"),), defines=places.defines,
    )  # fmt: skip


def in_part(program: Interface) -> Interface:
    """Returns the program that adds differences in some pixels alone: where ps_part is not 0."""
    return replace(program, samplers=(*program.samplers, PART_SAMPLER), defines=(*program.defines, PART_DEFINE))


def steep_pixels(centre: np.ndarray, shape: np.ndarray, centres: Centres, steep: float) -> np.ndarray:
    """Returns in which pixels optical depths change too fast for splats to be widened, or splats are too dense for
    that, (H, W) bool.

    centre, shape: (N, 4) as the pass `light` left them. centres: of these. `steep`: of the places.
    """
    inner = slice(centres.reach, -centres.reach)
    with np.errstate(all="ignore"):
        area = np.sqrt(shape[:, 0] * shape[:, 2] - shape[:, 1] * shape[:, 1])
        mass = centre[:, 3] * area * np.float32(np.pi * SUPPORT / 5)
    depth = _smooth(centres.sums(mass))
    change = sum(np.square(np.gradient(depth, axis=axis)) for axis in (0, 1) if depth.shape[axis] > 1)
    found = change * np.exp(-depth) > steep
    if (dense := centre[:, 3] > DENSE).any():
        found |= replace(centres, pixel=np.where(dense, centres.pixel, -1)).touched()
    return found[inner, inner]


def _smooth(values: np.ndarray) -> np.ndarray:
    """Returns values (H, W), each with a quarter of its neighbours along both axes."""
    rows = np.pad(values, [(1, 1), (0, 0)], mode="edge")
    rows = 0.25 * rows[:-2] + 0.5 * rows[1:-1] + 0.25 * rows[2:]
    columns = np.pad(rows, [(0, 0), (1, 1)], mode="edge")
    return 0.25 * columns[:, :-2] + 0.5 * columns[:, 1:-1] + 0.25 * columns[:, 2:]
