"""Blends lit splats over the picture of one sample, and adds that to the sums."""

from __future__ import annotations

from ....core.splat.captured import LEAST_ALPHA, MOST_ALPHA
from ....core.splat.kernel import PROFILES
from ....shading.interface import Block, Interface
from ..tiles import TILE_DEFINE
from ..uniforms import CAMERA_FIELDS, block
from .options import TranslucentOptions

COARSE = 2  # pixels of the picture along a side of the coarse one's
COARSE_LOW_PASS = 0.04  # pixels^2 of the coarse picture, which is not to miss any splats either
Bounds = tuple[float, float, float, float]  # pixels: low and high corner
CHANNELS = ("R", "GA", "B")  # drawn one after the other where extinction is coloured

_FIELDS = (
    ("vec4", "bounds"),  # pixels of the target: low and high corner of where splats are wanted
    ("vec2", "principal_point"),  # pixels of the whole picture
    ("ivec2", "size"),  # of the target
    ("vec2", "turn"),  # first column of the matrix that takes pixels of the picture to texels of the target
    ("vec2", "origin"),  # texels: where pixel coordinates (0, 0) lie in the target
    ("int", "first"),  # splat of the list
    ("float", "place"),  # texels of the target along one of the opaque depths
    ("float", "low_pass"),  # texels^2: the variance by which splats are widened, their masses kept; 0: they are not
)
TURNED = ("bounds", "turn", "low_pass")  # what is read where some splats are no captured ones
OPAQUE_DEPTH = block("OpaqueDepth", CAMERA_FIELDS)


def _block(options: TranslucentOptions) -> Block:
    """The uniforms of the program that blends splats."""
    unread = {"place"} if not options.opaque else set()
    unread |= set(TURNED) if options.alone else set()
    return block("Blend", tuple(field for field in _FIELDS if field[1] not in unread))


def draw_program(
    options: TranslucentOptions, channel: str, listed: bool = False, points: bool = False, depths: bool = False
) -> Interface:
    """Returns the program that blends splats over the picture. `channel`: one of CHANNELS, or "" where all are
    alike. `listed`: not all splats are drawn. `points`: each is a point, not two triangles. `depths`: their optical
    depths are added up instead, channel by channel."""
    read = ["centre", "shape", "source", *(["front", "depth"] if options.opaque else [])]
    varyings = [("flat", "vec4", "v_conic"), ("flat", "vec4", "v_source"), ("flat", "vec2", "v_centre")]
    defines = []
    if options.opaque:
        varyings.append(("flat", "vec4", "v_front"))
        defines.append(("PS_AMONG_OPAQUE", "1"))
    if options.captured:
        constants = {"PS_MOST_ALPHA": MOST_ALPHA, "PS_LEAST_ALPHA": LEAST_ALPHA}
        defines += [("PS_CAPTURED", "1"), *((name, repr(value)) for name, value in constants.items())]
    if options.nodes:
        defines.append(("PS_NODES", "1"))
    if options.mattes and options.opaque:
        varyings.append(("flat", "float", "v_size"))
        defines.append(("PS_MATTES", "1"))
    if options.tiled:
        read.append("tiles")
        defines += [("PS_TILED", "1"), TILE_DEFINE]
    if options.alone:
        defines.append(("PS_CAPTURED_ALONE", "1"))
    if options.kernels:
        read.append("profiles")
        defines += [("PS_KERNELS", "1"), ("PS_PROFILE_STEPS", str(PROFILES.shape[1]))]
    if listed:
        read.append("listed")
        defines.append(("PS_LISTED", "1"))
    if points:
        defines.append(("PS_POINTS", "1"))
    outputs = [("vec4", "out_color")]
    if options.holdout:
        outputs.append(("vec4", "out_cut"))
        defines.append(("PS_HOLDOUT", "1"))
    if depths:
        read.append("tint")
        varyings.append(("flat", "vec3", "v_tint"))
        defines.append(("PS_DEPTHS", "1"))
    if channel:
        read.append("tint")
        defines.append(("PS_CHANNEL", str("RGB".index(channel[0]))))
    return Interface(
        "translucent", vertex="translucent/blend.vert", fragment="translucent/blend.frag", block=_block(options),
        samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in read),
        varyings=tuple(varyings), outputs=tuple(outputs), defines=tuple(defines),
    )  # fmt: skip


def depth_program(samplers: tuple[tuple[str, str], ...], normal: bool) -> Interface:
    """Returns the program that writes the depth of the opaque surface under each pixel's centre."""
    return Interface(
        "opaque depth", fragment="translucent/depth.frag", block=OPAQUE_DEPTH, samplers=samplers,
        outputs=(("float", "out_depth"),), defines=(("PS_NORMAL", "1"),) if normal else (),
    )  # fmt: skip


# The coarse picture of a view that moves, over the fine one.
ENLARGE = Interface(
    "enlarge", fragment="translucent/enlarge.frag", samplers=(("FLOAT_2D", "ps_coarse"),),
    outputs=(("vec4", "out_color"),),
)  # fmt: skip

# The picture of captured splats alone, over what lies behind them.
SHOW = Interface(
    "translucent", fragment="captured/show.frag", samplers=(("FLOAT_2D", "ps_picture"),),
    outputs=(("vec4", "out_color"),),
)  # fmt: skip


def add_program(options: TranslucentOptions) -> Interface:
    """Returns the program that adds one sample's picture to the sums."""
    named = {"PS_HOLDOUT": options.holdout, "PS_TRAINED": options.trained}
    return Interface(
        "add", fragment="translucent/add.frag",
        samplers=(("FLOAT_2D", "ps_layer"), *((("FLOAT_2D", "ps_cut"),) if options.holdout else ())),
        outputs=(("vec4", "out_combined"),), defines=tuple((name, "1") for name, on in named.items() if on),
    )  # fmt: skip
