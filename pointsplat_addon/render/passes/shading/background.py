"""TODO: say what this module is."""

from __future__ import annotations

from ....shading.interface import Interface
from ..uniforms import FRAME
from .averages import _averaged_defines, _averaged_outputs
from .lighting import lighting_samplers


def background_program(
    world: tuple[str, ...],
    transparent: bool,
    passes: frozenset[str],
    coverage: bool = False,
    everywhere: bool = False,
    combined: bool = True,
) -> Interface:
    """The world behind everything, of which `world` says what it is, PS_BACKDROP that it is out of focus. `coverage`:
    edges let some of it through. `everywhere`: nothing is before it. `combined`: the picture, not only passes beside
    it."""
    drawn = not transparent and "PS_BACKDROP" not in world
    named = {"PS_BACKGROUND": drawn, "PS_COVERAGE": coverage, "PS_EVERYWHERE": everywhere,
             "PS_BESIDE": not combined}  # fmt: skip
    names = (*world, *_averaged_defines(passes), *(name for name, on in named.items() if on))
    read = () if everywhere else ("ps_place", "ps_shape") if coverage else ("ps_place",)
    return Interface(
        "background", fragment="shading/background.frag", block=FRAME, outputs=_averaged_outputs(passes, combined),
        samplers=(*(("FLOAT_2D", name) for name in read), *lighting_samplers(world)),
        defines=tuple((name, "1") for name in names),
    )  # fmt: skip
