"""Deferred shading into accumulators, the passes that are not averaged, and what shading reads.

Material table, four texels a row: base colour, alpha; emission, specular; culls, roughness, metallic, IOR; unused.
"""

from __future__ import annotations

import numpy as np

from ...core.scene import MaterialTable
from ...shading.interface import Interface
from ..device import Texture
from ..outputs import BY_KEY
from .common import FRAME, Variant

AVERAGED = {"normal": ("PS_OUT_NORMAL", "out_normal_pass"), "albedo": ("PS_OUT_ALBEDO", "out_albedo"),
            "mist": ("PS_OUT_MIST", "out_mist")}  # fmt: skip
# Each output serves several passes: channels of one texture.
DATA = {
    "position": ("PS_OUT_POSITION", "out_position", ("position", "depth")),
    "index": ("PS_OUT_INDEX", "out_index", ("object_index", "material_index", "crypto_object", "crypto_material")),
    "vector": ("PS_OUT_VECTOR", "out_vector", ("vector",)),
}
NEED_OWNER = ("object_index", "crypto_object", "vector")
MIST_EXPONENT = {"LINEAR": 1.0, "QUADRATIC": 2.0, "INVERSE_QUADRATIC": 0.5}


def averaged(passes: frozenset[str]) -> tuple[str, ...]:
    """Accumulators beyond Combined."""
    return tuple(key for key in AVERAGED if key in passes and BY_KEY[key].averaged)


def data(passes: frozenset[str]) -> tuple[str, ...]:
    """Textures of the data pass."""
    return tuple(name for name, (_, _, serves) in DATA.items() if passes & set(serves))


def shade_program(variant: Variant, lighting: tuple[str, ...], background: bool, passes: frozenset[str]) -> Interface:
    """`lighting`: the PS_HAS_ names of what shines."""
    read = ("place", "shape", "normal", "color", "emission")
    outputs = [("vec4", "out_combined"), *(("vec4", AVERAGED[key][1]) for key in averaged(passes))]
    samplers = [*variant.samplers(only=read), ("FLOAT_2D", "ps_materials")]
    if lighting:
        samplers.append(("FLOAT_2D", "ps_lights"))
    if "PS_HAS_ENVIRONMENT" in lighting:
        samplers.append(("FLOAT_2D", "ps_environment"))
    names = [n for n in variant.defines if n != "PS_OWNER"] + list(lighting)
    names += [AVERAGED[key][0] for key in averaged(passes)] + (["PS_BACKGROUND"] if background else [])
    return Interface(
        "shade", fragment="shade.frag", block=FRAME, samplers=tuple(samplers), outputs=tuple(outputs),
        defines=tuple((name, "1") for name in names),
    )  # fmt: skip


def data_program(variant: Variant, passes: frozenset[str]) -> Interface:
    wanted = data(passes)
    samplers = list(variant.samplers(only=("place", "shape", "normal", "owner")))
    if "vector" in wanted:
        samplers.append(("FLOAT_2D", "ps_previous"))
    names = [DATA[name][0] for name in wanted] + (["PS_OWNER"] if variant.owner else [])
    return Interface(
        "data", fragment="data.frag", block=FRAME, samplers=tuple(samplers),
        outputs=tuple(("vec4", DATA[name][1]) for name in wanted),
        defines=tuple((name, "1") for name in names),
    )  # fmt: skip


PRESENT = Interface(
    "present", vertex="present.vert", fragment="present.frag", block=FRAME,
    samplers=(("FLOAT_2D", "ps_combined"), ("FLOAT_2D", "ps_place")),
    varyings=(("smooth", "vec2", "v_place"),), outputs=(("vec4", "out_color"),), depth=True,
)  # fmt: skip


def material_rows(table: MaterialTable) -> np.ndarray:
    """(M, 4, 4) float32, one row of texels a material."""
    rows = np.zeros((len(table), 4, 4), np.float32)
    rows[:, 0, :3], rows[:, 0, 3] = table.base_color, table.alpha
    rows[:, 1, :3], rows[:, 1, 3] = table.emission, table.specular
    rows[:, 2] = np.stack([table.cull, table.roughness, table.metallic, table.ior], axis=1)
    return rows


def textures(**named: Texture | None) -> dict[str, Texture]:
    """Those that are there, by sampler name."""
    return {f"ps_{name}": texture for name, texture in named.items() if texture is not None}
