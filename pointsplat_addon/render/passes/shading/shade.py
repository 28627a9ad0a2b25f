"""Deferred shading into accumulators, the passes that are not averaged, and what shading reads.

Material table, four texels a row: base colour, alpha; emission, anisotropy; culls, roughness, metallic, index of
refraction that stands for IOR and specular level; what hair is besides (core.hair.texel).
"""

from __future__ import annotations

from ....shading.interface import Interface
from ..gbuffer import Variant
from ..uniforms import FRAME
from .averages import _averaged_defines, _averaged_outputs
from .lighting import ENOUGH_CELLS, LAMP_POINTS, MOST_LAMP_POINTS, lighting_defines, lighting_samplers

MIST_EXPONENT = {"LINEAR": 1.0, "QUADRATIC": 2.0, "INVERSE_QUADRATIC": 0.5}


def shade_program(
    variant: Variant,
    lighting: tuple[str, ...],
    materials: tuple[str, ...],
    passes: frozenset[str],
    samples: int = 1,
    coverage: bool = False,
    lines: bool = False,
    focus: bool = False,
    combined: bool = True,
    coarse: bool = False,
) -> Interface:
    """`lighting`, `materials`: the PS_ names of what shines and of what surfaces do with it. Wide lamps are looked at
    from as many points as the `samples` of a picture leave over from LAMP_POINTS. `coverage`: edges are soft.
    `lines`: there are strands. `focus`: only what is in focus, with its depth. `combined`: the picture, not only passes
    beside it. `coarse`: nodes are so wide that they would lie in the shadow of what they stand for."""
    read = variant.samplers(only=("place", "shape", "normal", "color", "emission"))
    flags = {"PS_COVERAGE": coverage, "PS_LINES": lines and variant.normal, "PS_FOCUS": focus,
             "PS_BESIDE": not combined,
             "PS_COARSE": coarse and any("SHADOW" in name for name in lighting)}  # fmt: skip
    names = (*variant.defines, *materials, *_averaged_defines(passes), *(name for name, on in flags.items() if on))
    points = min(max(LAMP_POINTS // samples, 1), MOST_LAMP_POINTS)
    taps = (("PS_SHADOW_TAPS", str(points)),) if "PS_SHADOW_SAMPLE" in lighting else ()
    taps += (("PS_SHADOW_ONE_CELL", "1"),) if taps and samples >= ENOUGH_CELLS else ()
    return Interface(
        "shade", fragment="shading/shade.frag", block=FRAME,
        outputs=(*_averaged_outputs(passes, combined), *((("vec4", "out_focus"),) if focus else ())),
        samplers=(*read, ("FLOAT_2D", "ps_materials"), *lighting_samplers(lighting)),
        defines=(*lighting_defines(lighting), *taps, *((name, "1") for name in names)),
    )  # fmt: skip
