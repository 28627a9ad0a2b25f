"""Draws the world where nothing else is, and adds it to the sums over samples."""

from __future__ import annotations

from ....shading.interface import Block, Interface
from ..uniforms import BACKDROP_FIELDS, CAMERA_FIELDS, Fields, block
from .averages import averaged_defines, averaged_outputs
from .lighting import LIGHT_FIELDS, SAMPLE_FIELDS, fog_defines, lighting_defines, lighting_samplers
from .terms import Term


def world_block(name: str, world: tuple[str, ...], *groups: Fields) -> Block:
    """The uniforms of a pass that draws the world, with further fields."""
    fog: Fields = (*LIGHT_FIELDS, *(SAMPLE_FIELDS if "PS_SHADOW_SAMPLE" in world else ())) if "PS_FOG" in world else ()
    return block(name, CAMERA_FIELDS, BACKDROP_FIELDS if "PS_BACKDROP" in world else (), fog, *groups)


def term_defines(world: tuple[str, ...], term: Term | None) -> tuple[str, ...]:
    """Names of the defines of shaders that draw the world, or only fog: without that, all of it belongs to one term."""
    return () if term is None or "PS_FOG" not in world else term.defines


def background_program(
    world: tuple[str, ...],
    transparent: bool,
    passes: frozenset[str],
    coverage: bool = False,
    everywhere: bool = False,
    combined: bool = True,
    grouped: bool = False,
    mattes: bool = False,
    trained: bool = False,
    term: Term | None = None,
) -> Interface:
    """Returns the program that draws the world, of which `world` says what it is, PS_BACKDROP that it is out of focus.
    `coverage`: edges let some of it through. `everywhere`: nothing is before it. `combined`: the picture, not only
    passes beside it. `grouped`: behind the open sub-samples of pixels, and with `mattes` behind these.
    `trained`: in display values. `term`: of light, that is drawn alone."""
    drawn = not transparent and "PS_BACKDROP" not in world
    named = {"PS_BACKGROUND": drawn, "PS_COVERAGE": coverage, "PS_EVERYWHERE": everywhere,
             "PS_AUXILIARY_ONLY": not combined, "PS_GROUPED": grouped, "PS_MATTES": mattes,
             "PS_TRAINED": trained and (drawn or "PS_BACKDROP" in world)}  # fmt: skip
    names = (*averaged_defines(passes), *(name for name, on in named.items() if on), *term_defines(world, term))
    read = () if everywhere or grouped else ("ps_centre", "ps_shape") if coverage else ("ps_centre",)
    codes = (("UINT_2D", "ps_second"),) if grouped and not mattes else ()
    return Interface(
        "background", fragment="shading/background.frag", block=world_block("Background", world),
        outputs=averaged_outputs(passes, combined), samplers=(*(("FLOAT_2D", name) for name in read), *codes,
        *lighting_samplers(world)),
        defines=(*lighting_defines(world), *fog_defines(world), *((name, "1") for name in names)),
    )  # fmt: skip
