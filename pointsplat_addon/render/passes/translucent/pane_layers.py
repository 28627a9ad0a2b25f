"""Composes layers of panes front to back in all sub-samples, over what the visibility buffer shows (Everitt 2001).

Of each cell a layer has the nearest triangle behind those of the layers before: a group of sub-samples with a radiance
L, an alpha a and the share of light T that passes, of each channel. With P, the product of all T before it, the picture
gains P a L, and in the end P times what is opaque. Sub-samples of which hardly anything behind can be seen are closed.
Translucent splats before, between and behind panes come in between: before_panes.py.
"""

from __future__ import annotations

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ..shading.terms import TRANSMISSION, Term
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS
from .before_panes import NOTHING, Found

COMPOSE = block("PaneLayer", CAMERA_FIELDS, LATTICE_FIELDS)
# Where in the sums the pixels lie that are drawn, from 0 to 1, and where in them the tile begins, in pixels.
FILTER = block(
    "PaneFilter", CAMERA_FIELDS, LATTICE_FIELDS, RECTANGLE_FIELDS,
    (("ivec2", "corner"), ("int", "sub_samples"), ("int", "neighbours")),
)  # fmt: skip
CODES = (("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"))
# Of each cell: radiance and the share of light that is hidden so far, of each channel, and the least depth of the next
# layer, its bits inverted; 0: there is none.
STATE = {"ps_light": "RGBA32F", "ps_hidden": "RGBA32F", "ps_following": "R32UI"}
CENTRED = ("vec4", "out_seen"), ("vec4", "out_bare"), ("float", "out_left")  # beside what changes
BARE = {"ps_bare": "RGBA32F"}  # among captured splats, the radiance without these


def _listed(places: bool) -> tuple[tuple[str, str], ...]:
    return (LATTICE_DEFINE, *((("PS_PLACES", "1"),) if places else ()))


def compose_program(places: bool, term: Term | None = None, splats: Found = NOTHING) -> Interface:
    """Returns the program that puts a layer behind those before it. `places`: the list of its groups is not in the
    order of the pixels. `term`: of light, that is drawn alone; what panes transmit is the colour of theirs. `splats`:
    the translucent ones before it."""
    transmitted = term is not None and term.color and term.light == TRANSMISSION
    read = (
        "ps_light",
        "ps_hidden",
        "ps_starts",
        "ps_numbers",
        *(() if transmitted else ("ps_combined",)),
        "ps_through",
        *(("ps_bare",) if splats.centred else ()),
        *splats.samplers(False),
    )
    return Interface(
        "compose", fragment="panes/layer.frag", block=COMPOSE,
        samplers=(*CODES, ("UINT_2D", "ps_depths"),
                  *(("FLOAT_2D", name) for name in (*read, *(("ps_places",) if places else ())))),
        outputs=(("vec4", "out_light"), ("vec4", "out_hidden"), ("uint", "out_following"),
                 *((("vec4", "out_bare"),) if splats.centred else ())),
        defines=(*_listed(places), *((("PS_TRANSMITTED", "1"),) if transmitted else ()), *splats.defines(False),
                 *((("PS_CENTRED", "1"),) if splats.centred else ())),
    )  # fmt: skip


def change_program(behind: bool, places: bool, splats: Found = NOTHING) -> Interface:
    """Returns the program that writes what all layers change in each cell. `behind`: open sub-samples show something.
    `places`: the list of opaque groups is not in the order of the pixels. `splats`: the translucent ones before them.
    """
    read = ("ps_light", "ps_hidden", "ps_starts", "ps_numbers", "ps_combined")
    read += (*(("ps_behind",) if behind else ()), *(("ps_places",) if places else ()))
    read += (*(("ps_bare",) if splats.centred else ()), *splats.samplers(True))
    return Interface(
        "change", fragment="panes/change.frag", block=COMPOSE,
        samplers=(*CODES, *(("FLOAT_2D", name) for name in read)),
        outputs=(("vec4", "out_change"), *(CENTRED if splats.centred else ())),
        defines=(*_listed(places), *((("PS_BEHIND", "1"),) if behind else ()), *splats.defines(True),
                 *((("PS_CENTRED", "1"),) if splats.centred else ())),
    )  # fmt: skip


def filter_program(lattice: Lattice, centred: bool = False) -> Interface:
    """Returns the program that adds the changes in the cells of pixels and of their neighbours to the sums, by the
    weights of the pixel filter. `centred`: among captured splats, which have it in them."""
    read = ("ps_change", "ps_members", "ps_weights", *(("ps_seen", "ps_bare", "ps_left") if centred else ()))
    return Interface(
        "filter panes", vertex="common/rectangle.vert", fragment="panes/filter.frag", block=FILTER,
        samplers=tuple(("FLOAT_2D", name) for name in read),
        outputs=(("vec4", "out_combined"),),
        defines=(LATTICE_DEFINE, *((("PS_CENTRED", "1"),) if centred else ())),
    )  # fmt: skip
