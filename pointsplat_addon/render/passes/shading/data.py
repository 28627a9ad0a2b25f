"""Passes that are not averaged: position, depth, motion and indices under the pixels' centres."""

from __future__ import annotations

from ....shading.interface import Block, Interface
from ..gbuffer import Variant
from ..uniforms import CAMERA_FIELDS, Fields, block

# Each output serves several passes: channels of one texture.
DATA = {
    "position": ("PS_OUT_POSITION", "out_position", ("position", "depth")),
    "index": ("PS_OUT_INDEX", "out_index", ("object_index", "material_index", "crypto_object", "crypto_material")),
    "vector": ("PS_OUT_VECTOR", "out_vector", ("vector",)),
}
NEED_OWNER = ("object_index", "crypto_object", "vector")


def data(passes: frozenset[str]) -> tuple[str, ...]:
    """Returns the names of the textures that the pass `data` writes."""
    return tuple(name for name, (_, _, serves) in DATA.items() if passes & set(serves))


def _block(wanted: tuple[str, ...]) -> Block:
    """The uniforms of the pass `data` with these textures."""
    position: Fields = (("mat4", "world_from_view"),)
    # Of the whole picture, of which this may be a region: its size and the region's corner in pixels.
    vector: Fields = (("vec2", "resolution"), ("vec2", "corner"))
    return block("Data", CAMERA_FIELDS, position if "position" in wanted else (), vector if "vector" in wanted else ())


def data_program(variant: Variant, passes: frozenset[str], mattes: bool = False) -> Interface:
    """Returns the program of the pass `data`. `mattes`: some of what is there is not seen."""
    wanted = data(passes)
    samplers = list(variant.samplers(only=("centre", "shape", "normal", "owner")))
    if "vector" in wanted:
        samplers.append(("FLOAT_2D", "ps_previous"))
    names = [DATA[name][0] for name in wanted]
    names += [name for name in ("PS_OWNER", "PS_VELOCITY") if name in variant.defines]
    names += ["PS_MATTES"] if mattes else []
    return Interface(
        "data", fragment="shading/data.frag", block=_block(wanted), samplers=tuple(samplers),
        outputs=tuple(("vec4", DATA[name][1]) for name in wanted),
        defines=tuple((name, "1") for name in names),
    )  # fmt: skip
