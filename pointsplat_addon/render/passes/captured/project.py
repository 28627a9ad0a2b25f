"""Projects the captured splats of a view's draw list, which follow after other lit splats (translucent/light.py).

Texels of `views`, four for each instance: three rows of view_from_object, with the splats' origin; where the eye is in
the object, or where a parallel camera looks there, and whether the instance cuts a hole.

Where light changes them, they are lit here, too (shaders/lib/captured/lit.glsl).
"""

from __future__ import annotations

from ....core.numeric.record import value_record
from ....core.splat.captured import LEAST_ALPHA, LOW_PASS
from ....shading.interface import Block, Interface
from ..shading.lighting import (
    LIGHT_FIELDS,
    MOST_LIGHT_POINTS,
    SAMPLE_FIELDS,
    lighting_defines,
    lighting_samplers,
    looks_at_points,
)
from ..shading.terms import DIFFUSE, EMISSION, OCCLUSION
from ..translucent.options import TranslucentOptions, lit_outputs
from ..uniforms import CAMERA_FIELDS, Fields, block

_FIELDS: Fields = (
    ("vec4", "slopes"),  # least x and y, greatest x and y: core.splat.captured.slope_limits
    ("float", "low_pass"),  # pixels^2: that of the pixels for which the picture's stand
    ("ivec2", "instances"),  # the first of those that the page shows, and the one behind the last
    ("int", "first"),  # texel of the list's first splat in what is written
    ("int", "count"),  # of the splats in the list
)


@value_record
class CapturedLighting:
    """What light does to captured splats."""

    kind: str = "CAPTURED"  # one of core.scene.settings.LIGHTINGS
    names: tuple[str, ...] = ()  # PS_ names of lights and of the shadows of what casts onto them

    @property
    def lit(self) -> bool:
        """Whether light changes them."""
        return self.kind != "CAPTURED"

    @property
    def sampled(self) -> bool:
        """Whether each sample of a picture looks at other points of lights."""
        return self.lit and "PS_SHADOW_SAMPLE" in self.names


UNLIT = CapturedLighting()


def _block(light: CapturedLighting) -> Block:
    """The uniforms of the program that projects splats."""
    lit = LIGHT_FIELDS if light.lit else ()
    return block("ProjectCaptured", CAMERA_FIELDS, _FIELDS, lit, SAMPLE_FIELDS if light.sampled else ())


def project_program(
    options: TranslucentOptions,
    sh_texels: int,
    sh_shift: int,
    antialiased: bool,
    nodes: bool = False,
    light: CapturedLighting = UNLIT,
) -> Interface:
    """Returns the program that projects the splats of one page. `sh_texels`, `sh_shift`: as of the page.
    `nodes`: they stand for many splats. `light`: what it does to them."""
    named = {"PS_ANTIALIASED": antialiased, "PS_AMONG_OPAQUE": options.fronts, "PS_HOLDOUT": options.holdout}
    named |= {"PS_TINT": options.tint, "PS_NODES": nodes, "PS_TRAINED": options.trained}
    term = options.term
    if term is not None:
        # Captured light is emitted; relit colours are what dull surfaces reflect. Nothing occludes either.
        relit = light.kind == "RELIT"
        named["PS_WHITE"] = term.light == OCCLUSION
        shown = (DIFFUSE if relit else EMISSION), OCCLUSION
        named["PS_DARK"] = term.light not in shown or (term.color and not relit)
        light = UNLIT if named["PS_DARK"] or named["PS_WHITE"] or term.color else light
    named[f"PS_{light.kind}"] = light.lit
    lighting = light.names if light.lit else ()
    constants = {
        "PS_SH_TEXELS": sh_texels, "PS_SH_SHIFT": sh_shift, "PS_SH_MASK": (1 << sh_shift) - 1,
        "PS_LOW_PASS": LOW_PASS, "PS_LEAST_ALPHA": LEAST_ALPHA,
    }  # fmt: skip
    read = ("order", "views", "position", "rotation", "scale", "harmonics", *(("means",) if nodes else ()))
    read += ("normal",) if light.lit else ()
    return Interface(
        "captured", fragment="captured/project.frag", block=_block(light),
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(lighting)),
        outputs=tuple(("vec4", f"out_{name}") for name in lit_outputs(options)),
        defines=(*lighting_defines(lighting), *_taps(lighting),
                 *((name, repr(value)) for name, value in constants.items()),
                 *((name, "1") for name, on in named.items() if on)),
    )  # fmt: skip


def _taps(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Splats overlap: each looks at other points of wide lights than its neighbours."""
    taps = (("PS_SHADOW_TAPS", str(MOST_LIGHT_POINTS)),) if "PS_SHADOW_TABLES" in lighting else ()
    return (*taps, *((("PS_SHADOW_SPREAD", "1"),) if looks_at_points(lighting) else ()))
