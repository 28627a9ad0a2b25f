"""TODO: say what this module is."""

from __future__ import annotations

from ....shading.interface import Interface
from ..gbuffer import Variant
from ..uniforms import FRAME

# Each output serves several passes: channels of one texture.
DATA = {
    "position": ("PS_OUT_POSITION", "out_position", ("position", "depth")),
    "index": ("PS_OUT_INDEX", "out_index", ("object_index", "material_index", "crypto_object", "crypto_material")),
    "vector": ("PS_OUT_VECTOR", "out_vector", ("vector",)),
}
NEED_OWNER = ("object_index", "crypto_object", "vector")


def data(passes: frozenset[str]) -> tuple[str, ...]:
    """Textures of the data pass."""
    return tuple(name for name, (_, _, serves) in DATA.items() if passes & set(serves))


def data_program(variant: Variant, passes: frozenset[str]) -> Interface:
    wanted = data(passes)
    samplers = list(variant.samplers(only=("place", "shape", "normal", "owner")))
    if "vector" in wanted:
        samplers.append(("FLOAT_2D", "ps_previous"))
    names = [DATA[name][0] for name in wanted] + (["PS_OWNER"] if variant.owner else [])
    return Interface(
        "data", fragment="shading/data.frag", block=FRAME, samplers=tuple(samplers),
        outputs=tuple(("vec4", DATA[name][1]) for name in wanted),
        defines=tuple((name, "1") for name in names),
    )  # fmt: skip
