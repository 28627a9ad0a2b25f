"""Projects the captured splats of a view's draw list, which follow after other lit splats (translucent/light.py).

Texels of `views`, four for each instance: three rows of view_from_object, with the splats' origin; where the eye is in
the object, or where a parallel camera looks there, and whether the instance cuts a hole.
"""

from __future__ import annotations

from ....core.splat.captured import LEAST_ALPHA, LOW_PASS
from ....shading.interface import Interface
from ..translucent.options import TranslucentOptions, lit_outputs
from ..uniforms import CAMERA_FIELDS, block

PROJECT = block(
    "ProjectCaptured",
    CAMERA_FIELDS,
    (
        ("vec4", "slopes"),  # least x and y, greatest x and y: core.splat.captured.slope_limits
        ("ivec2", "instances"),  # the first of those that the page shows, and the one behind the last
        ("int", "first"),  # texel of the list's first splat in what is written
        ("int", "count"),  # of the splats in the list
    ),
)


def project_program(
    options: TranslucentOptions, sh_texels: int, sh_shift: int, antialiased: bool, nodes: bool = False
) -> Interface:
    """Returns the program that projects the splats of one page. `sh_texels`, `sh_shift`: as of the page.
    `nodes`: they stand for many splats."""
    named = {"PS_ANTIALIASED": antialiased, "PS_AMONG_OPAQUE": options.opaque, "PS_HOLDOUT": options.holdout}
    named |= {"PS_TINT": options.tint, "PS_NODES": nodes}
    constants = {
        "PS_SH_TEXELS": sh_texels, "PS_SH_SHIFT": sh_shift, "PS_SH_MASK": (1 << sh_shift) - 1,
        "PS_LOW_PASS": LOW_PASS, "PS_LEAST_ALPHA": LEAST_ALPHA,
    }  # fmt: skip
    read = ("order", "views", "position", "rotation", "scale", "harmonics", *(("means",) if nodes else ()))
    return Interface(
        "captured", fragment="captured/project.frag", block=PROJECT,
        samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in read),
        outputs=tuple(("vec4", f"out_{name}") for name in lit_outputs(options)),
        defines=(*((name, repr(value)) for name, value in constants.items()),
                 *((name, "1") for name, on in named.items() if on)),
    )  # fmt: skip
