"""What translucent splats send from before the panes of a layer, and what they let through (render/frame/panes).

With L(d) the light that splats send from nearer than d, over nothing, and T(d) the share of light that they let
through, what lies between two depths sends L(b) - L(a), which passes the panes before it: P, the product of what these
let through. A sum over such parts is one over depths (Abel): L(d) counts by the fall of P at the pane in d, and up to
what is opaque by the last P. So splats are drawn over nothing once for each layer of panes, up to its depths, and once
up to what is opaque. Where panes are they are looked at once for each group of sub-samples, at its middle's depth, and
what is narrower than a pixel is widened, its mass kept; only where such a splat hides much in itself, sub-samples look
at it one by one, as they do where no panes are. Where the light that passes is coloured, optical depths are added up,
channel by channel.

Captured splats have the pixel filter in them, and are looked at in pixels' centres alone. Near panes a pixel shows the
mean S of its own sub-samples among them, since what they send and hide would otherwise be filtered twice. Without them
its own sub-samples show B, and those that the pixel filter takes in F: as far as splats let through what is opaque, the
pixel gains F - B, so that edges that are seen between them are filtered. Elsewhere they are blended as without panes.
"""

from __future__ import annotations

from ....core.numeric.record import value_record
from ....shading.interface import Interface
from ..grouping.groups import LIST_SAMPLER
from ..tiles import TILE_DEFINE
from ..uniforms import CAMERA_FIELDS, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS

OPEN_LAYER = -1  # of what no group covers
PLACE = block("PanePlace", CAMERA_FIELDS, (("int", "layer"),))
PLACE_CELLS = block("PanePlaceCells", CAMERA_FIELDS, LATTICE_FIELDS)
KEEP = block("PaneKeep", CAMERA_FIELDS, (("int", "layer"),))
LOW_PASS = 0.25  # pixels^2: variance by which splats before panes are widened where one place in a pixel is not enough
DENSE = 0.3  # optical depth through the middle of a splat from which that would hide too much
CODES = (("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"))


@value_record
class Found:
    """Where in a tile of the picture splats are: variants of the programs that read what they send and hide."""

    narrow: bool  # in some they are looked at in each sub-sample
    wide: bool  # in some once for each group
    tint: bool  # what they hide differs between the channels
    centred: bool = False  # some are captured, which have the pixel filter in them

    def samplers(self, open_too: bool) -> tuple[str, ...]:
        """Names of the textures of floats that are read; `open_too`: of what is open, too."""
        names = ("", "_depths") if self.tint else ("",)
        cells = (*(f"ps_cells{name}" for name in names), "ps_narrow") if self.narrow else ()
        lists = (*(f"ps_listed{name}" for name in names),) if self.wide else ()
        return *cells, *lists, *(f"ps_open{name}" for name in names if self.wide and open_too)

    def defines(self, open_too: bool) -> tuple[tuple[str, str], ...]:
        """The defines of programs that read them (lib/translucent/before.glsl). `open_too`: as of `samplers`."""
        flags = {"PS_IN_CELLS": self.narrow, "PS_LISTED": self.wide, "PS_OPEN_TOO": self.wide and open_too}
        flags |= {"PS_TINT": self.tint}
        tile = (TILE_DEFINE,) if self.narrow else ()
        return *tile, *((name, "1") for name, on in flags.items() if on)


NOTHING = Found(False, False, False)


def place_program(places: bool) -> Interface:
    """Returns the program that writes the depth of a layer of each pixel: of a group, or behind all for what is open.
    `places`: the list of groups is not in the order of the pixels."""
    read = ("ps_starts", "ps_wanted", *(("ps_places",) if places else ()))
    return Interface(
        "expand", fragment="panes/place.frag", block=PLACE,
        samplers=(*CODES, ("UINT_2D", "ps_leader_depths"), *(("FLOAT_2D", name) for name in read)),
        outputs=(("float", "out_place"),), defines=(TILE_DEFINE, *((("PS_PLACES", "1"),) if places else ())),
    )  # fmt: skip


def place_cells_program(open_too: bool) -> Interface:
    """Returns the program that writes the depth of each sub-sample; `open_too`: behind all for what is open."""
    return Interface(
        "expand", fragment="panes/place_cells.frag", block=PLACE_CELLS,
        samplers=(("UINT_2D", "ps_depths"), ("FLOAT_2D", "ps_wanted")), outputs=(("float", "out_place"),),
        defines=(LATTICE_DEFINE, TILE_DEFINE, *((("PS_OPEN_TOO", "1"),) if open_too else ())),
    )  # fmt: skip


def keep_program(tint: bool) -> Interface:
    """Returns the program that brings what was drawn for a layer of pixels into the list of groups."""
    names = ("ps_layer", *(("ps_layer_depths",) if tint else ()))
    return Interface(
        "compose", fragment="panes/keep.frag", block=KEEP,
        samplers=(LIST_SAMPLER, *(("FLOAT_2D", name) for name in names)),
        outputs=(("vec4", "out_listed"), *((("vec4", "out_listed_depths"),) if tint else ())),
        defines=(("PS_TINT", "1"),) if tint else (),
    )  # fmt: skip
