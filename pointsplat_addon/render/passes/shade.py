"""Deferred shading into accumulators, the passes that are not averaged, and what shading reads.

Material table, four texels a row: base colour, alpha; emission, anisotropy; culls, roughness, metallic, index of
refraction that stands for IOR and specular level; what hair is besides (core.hair.texel).
"""

from __future__ import annotations

import numpy as np

from ...core.light.hair import texel
from ...core.light.lighting import relative_index
from ...core.scene.materials import MaterialTable
from ...shading.interface import Interface
from ..device.protocol import Texture
from .common import FRAME, Variant
from .outputs import BY_KEY
from .tiles import TILE_DEFINE

AVERAGED = {"normal": ("PS_OUT_NORMAL", "out_normal_pass"), "albedo": ("PS_OUT_ALBEDO", "out_albedo"),
            "mist": ("PS_OUT_MIST", "out_mist")}  # fmt: skip
# Each output serves several passes: channels of one texture.
DATA = {
    "position": ("PS_OUT_POSITION", "out_position", ("position", "depth")),
    "index": ("PS_OUT_INDEX", "out_index", ("object_index", "material_index", "crypto_object", "crypto_material")),
    "vector": ("PS_OUT_VECTOR", "out_vector", ("vector",)),
}
NEED_OWNER = ("object_index", "crypto_object", "vector")
LEAST_SPREAD = 0.99  # of |g|: lobes narrower than this would alias between splats
LAMP_POINTS, MOST_LAMP_POINTS = 32, 4  # of a wide lamp: in a picture, and in one of its samples
ENOUGH_CELLS = 16  # samples that, each with a shadow cell of its own, make the mean of four between which it lies
MIST_EXPONENT = {"LINEAR": 1.0, "QUADRATIC": 2.0, "INVERSE_QUADRATIC": 0.5}


def averaged(passes: frozenset[str]) -> tuple[str, ...]:
    """Accumulators beyond Combined."""
    return tuple(key for key in AVERAGED if key in passes and BY_KEY[key].averaged)


def data(passes: frozenset[str]) -> tuple[str, ...]:
    """Textures of the data pass."""
    return tuple(name for name, (_, _, serves) in DATA.items() if passes & set(serves))


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


def _averaged_outputs(passes: frozenset[str], combined: bool) -> tuple[tuple[str, str], ...]:
    first = (("vec4", "out_combined"),) if combined else ()
    return (*first, *(("vec4", AVERAGED[key][1]) for key in averaged(passes)))


def _averaged_defines(passes: frozenset[str]) -> tuple[str, ...]:
    return tuple(AVERAGED[key][0] for key in averaged(passes))


def lighting_defines(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Shadows of wide lamps differ from sample to sample: PS_SHADOW_SAMPLE is where the shader finds its number."""
    return tuple((name, "frame.size.z" if name == "PS_SHADOW_SAMPLE" else "1") for name in lighting)


def lighting_samplers(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """What lib/light/lights.glsl reads."""
    wanted = (
        ("ps_lights", bool(lighting) and lighting != ("PS_BACKDROP",)),
        ("ps_backdrop", "PS_BACKDROP" in lighting),
        ("ps_environment", "PS_HAS_ENVIRONMENT" in lighting),
        ("ps_shadow_tables", "PS_SHADOWS" in lighting),
        ("ps_shadow_lights", "PS_SHADOWS" in lighting),
    )
    return tuple(("FLOAT_2D", name) for name, needed in wanted if needed)


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


def present_program(surface: bool, adaptive: bool = False) -> Interface:
    """The finished picture into the viewport. `surface`: something has a depth. `adaptive`: pixels differ in how many
    samples they have (render/passes/tiles.py)."""
    named = {"ps_place": surface, "ps_counts": adaptive}
    return Interface(
        "present", vertex="output/present.vert", fragment="output/present.frag", block=FRAME,
        samplers=(("FLOAT_2D", "ps_combined"), *(("FLOAT_2D", name) for name, on in named.items() if on)),
        varyings=(("smooth", "vec2", "v_place"),), outputs=(("vec4", "out_color"),), depth=True,
        defines=((("PS_SURFACES", "1"),) if surface else ()) + ((TILE_DEFINE,) if adaptive else ()),
    )  # fmt: skip


def material_rows(table: MaterialTable, escape: np.ndarray) -> np.ndarray:
    """(M, 4, 4) float32, one row of texels a material; escape: (M,), of hair."""
    rows = np.zeros((len(table), 4, 4), np.float32)
    rows[:, 0, :3], rows[:, 0, 3] = table.base_color, table.alpha
    rows[:, 1, :3] = table.emission
    if table.anisotropy is not None:
        rows[:, 1, 3] = np.clip(table.anisotropy, -LEAST_SPREAD, LEAST_SPREAD)
    if table.hair is not None:
        of = table.hair
        rows[:, 3] = texel(of.used, of.radial, of.coat, of.tilt, of.lobes, escape)
    rows[:, 2] = np.stack(
        [table.cull, table.roughness, table.metallic, relative_index(table.ior, table.specular)], axis=1
    )
    return rows


def textures(**named: Texture | None) -> dict[str, Texture]:
    """Those that are there, by sampler name."""
    return {f"ps_{name}": texture for name, texture in named.items() if texture is not None}
