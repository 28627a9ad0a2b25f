"""Deferred shading: the G-buffer to scene-linear radiance and averaged passes, added to the sums over samples."""

from __future__ import annotations

from dataclasses import replace

from ....core.numeric.lattice import Lattice
from ....core.scene.scene import Scene
from ....shading.interface import Block, Interface
from ..gbuffer import Variant
from ..uniforms import CAMERA_FIELDS, LENS_FIELDS, Fields, Values, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS, member_defines
from .averages import averaged, averaged_defines, averaged_outputs
from .lighting import (
    ENOUGH_CELLS,
    FIRST_LIGHT_POINTS,
    LIGHT_FIELDS,
    LIGHT_POINTS,
    MOST_LIGHT_POINTS,
    POINTS_OF_MEDIUM,
    POINTS_OF_STRAND,
    SAMPLE_FIELDS,
    lighting_defines,
    lighting_samplers,
    looks_at_points,
)

MIST_EXPONENT = {"LINEAR": 1.0, "QUADRATIC": 2.0, "INVERSE_QUADRATIC": 0.5}
MIST_FIELDS: Fields = (("float", "mist_start"), ("float", "mist_scale"), ("float", "mist_exponent"))
FOCUS_OUTPUT = (
    "vec4",
    "out_focus",
)  # the share of a texel that is in focus, in the second channel; in the first, times its depth
WORLD_FIELDS: Fields = (("mat4", "world_from_view"),)
HIT_SAMPLERS = (("FLOAT_2D", "ps_hit_places"), ("FLOAT_2D", "ps_hit_rays"))
INDIRECT_SAMPLERS = (("FLOAT_2D", "ps_gathered_light"), ("FLOAT_2D", "ps_mirrored_light"))
# The sub-samples of groups, at which shadows are looked up in maps.
FOOTPRINT_SAMPLERS = tuple(("UINT_2D", name) for name in ("ps_depths", "ps_keys", "ps_first", "ps_second"))


def _block(passes: frozenset[str], lighting: tuple[str, ...], focus: bool, combined: bool, footprint: bool) -> Block:
    """The uniforms of one variant."""
    wanted = (
        (LIGHT_FIELDS, combined),
        (SAMPLE_FIELDS, "PS_SHADOW_SAMPLE" in lighting),
        (LENS_FIELDS, focus),
        (MIST_FIELDS, "mist" in averaged(passes)),
        (WORLD_FIELDS, "normal" in averaged(passes)),
        (LATTICE_FIELDS, footprint),
    )
    return block("Shade", CAMERA_FIELDS, *(fields for fields, on in wanted if on))


def shade_values(scene: Scene) -> Values:
    """Values of the fields that depend on the scene."""
    mist = scene.mist
    return {
        "light_count": len(scene.lights),
        "mist_start": mist.start,
        "mist_scale": 1 / max(mist.depth, 1e-6),
        "mist_exponent": MIST_EXPONENT[mist.falloff],
    }


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
    lattice: Lattice | None = None,
    indirect: bool = False,
    mattes: bool = False,
    hits: bool = False,
) -> Interface:
    """Returns the program that shades. `lighting`, `materials`: the PS_ names of what shines and of what surfaces do
    with it. Wide lights are sampled at as many points as the `samples` of a picture leave over from LIGHT_POINTS.
    `coverage`: edges are soft. `lines`: there are strands. `focus`: only what is in focus, with its depth. `combined`:
    the picture, not only passes beside it. `coarse`: nodes are so wide that they would lie in the shadow of what they
    stand for. `lattice`: surfels are groups of sub-samples of this one. `indirect`: textures tell what they
    receive from the world and from each other. `mattes`: some groups are, which `matte_program` shades.
    `hits`: surfels are what rays have met."""
    grouped = lattice is not None
    by_members = {"PS_SHADOW_MAPS", "PS_SHADOW_PANES", "PS_SHADOW_FACES"}
    footprint = lattice if combined and by_members & set(lighting) else None
    read = variant.samplers(only=("centre", "shape", "normal", "color", "emission", "tangent"))
    read += (("FLOAT_2D", "ps_list"),) if grouped else ()
    read += FOOTPRINT_SAMPLERS if footprint else ()
    read += INDIRECT_SAMPLERS if indirect else ()
    read += HIT_SAMPLERS if hits else ()
    flags = {"PS_COVERAGE": coverage, "PS_STRANDS": lines and variant.normal, "PS_FOCUS": focus,
             "PS_AUXILIARY_ONLY": not combined, "PS_GROUPED": grouped, "PS_FOOTPRINT": footprint is not None,
             "PS_INDIRECT": indirect, "PS_MATTES": mattes, "PS_HITS": hits,
             "PS_COARSE": coarse and any("SHADOW" in name for name in lighting)}  # fmt: skip
    names = (*variant.defines, *materials, *averaged_defines(passes), *(name for name, on in flags.items() if on))
    # A sample of groups is a whole picture: it looks at all points, but only where the first ones disagree.
    points = min(max(LIGHT_POINTS // samples, 1), LIGHT_POINTS if grouped else MOST_LIGHT_POINTS)
    taps = (("PS_SHADOW_TAPS", str(points)),) if "PS_SHADOW_SAMPLE" in lighting else ()
    wide = "PS_SHADOW_HARD" not in lighting
    taps += (("PS_SHADOW_FIRST", str(FIRST_LIGHT_POINTS)),) if taps and wide and points > FIRST_LIGHT_POINTS else ()
    taps += (("PS_SHADOW_ONE_CELL", "1"),) if taps and samples >= ENOUGH_CELLS else ()
    fog = combined and "PS_FOG" in lighting
    if ((grouped and flags["PS_STRANDS"]) or fog) and looks_at_points(lighting):
        taps += (("PS_SHADOW_SPREAD", "1"), ("PS_POINTS_OF_STRAND", str(POINTS_OF_STRAND)))
        taps += (("PS_POINTS_OF_MEDIUM", str(POINTS_OF_MEDIUM)),) if fog else ()
    cells = (LATTICE_DEFINE, *member_defines(footprint)) if footprint else ()
    cells += (("PS_SHADOW_STRANDS", "1"),) if footprint and "PS_SHADOW_STRANDS" in lighting else ()
    return Interface(
        "shade", fragment="shading/shade.frag",
        block=_block(passes, lighting, focus, combined, footprint is not None),
        outputs=(*averaged_outputs(passes, combined), *((FOCUS_OUTPUT,) if focus else ())),
        samplers=(*read, ("FLOAT_2D", "ps_materials"), *lighting_samplers(lighting)),
        defines=(*lighting_defines(lighting), *taps, *cells, *((name, "1") for name in names)),
    )  # fmt: skip


def matte_program(
    variant: Variant,
    lighting: tuple[str, ...],
    samples: int,
    lattice: Lattice,
    behind: bool,
    shadows: bool = True,
) -> Interface:
    """Returns the program that shades mattes among groups of sub-samples: as dark as shadows on a white surface are.

    `lighting`: as of `shade_program`, with the shadows of what was added to a capture. `behind`: something shows
    through. `shadows`: else what shows through is as bright as ever.
    """
    variant = replace(variant, color=False, surface=False, emission=False, spread=False, tangent=False)
    made = shade_program(variant, lighting, (), frozenset({"combined"}), samples, lattice=lattice)
    read = tuple(one for one in made.samplers if one[1] != "ps_materials")
    return replace(
        made, name="mattes", samplers=(*read, *((("FLOAT_2D", "ps_behind"),) if behind else ())),
        outputs=(*made.outputs, ("vec4", "out_matte")),
        defines=(*made.defines, ("PS_CATCHER", "1"), ("PS_SHADOWED", "1"), *(() if shadows else (("PS_BRIGHT", "1"),)),
                 *((("PS_BEHIND", "1"),) if behind else ())),
    )  # fmt: skip
