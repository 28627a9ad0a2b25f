"""Lights every translucent splat of a draw list, and finds the share of each light that reaches the splats of a page.

The sorted draw list holds two floats a splat: column + 4096 (row % 4096) of its page, and 4 instance + row / 4096.
What the pass `light` leaves of each splat of the list, one texel each:
  centre  in pixels from the principal point, depth, optical depth at the centre (of captured splats the opacity)
  shape   covariance in pixels^2 (xx, xy, yy); of captured splats its determinant, too
  source  radiance of what is opaque in it (rgb): the splat's is this times 1 - T; the kernel's row k, -1 - k where
          the splat only cuts a hole; of captured splats, which are a kind of their own, the number of that kind
  front   standard deviation of depth along a ray, change of depth per pixel (x, y); where something opaque is drawn
  slope   change of depth per pixel (x, y) along its plane, and how far `centre` lies beside where its depth is, in
          pixels; where surfaces that light passes are out of focus
  tint    extinction by channel over that of the strongest
"""

from __future__ import annotations

import numpy as np

from ....core.splat import painter
from ....core.splat.kernel import SUPPORT
from ....shading.interface import Block, Interface
from ...device.packing import PAGE_WIDTH
from ..indirect.pages import MEDIA_WIDTH
from ..shading.lighting import (
    LIGHT_FIELDS,
    MOST_LIGHT_POINTS,
    POINTS_OF_MEDIUM,
    SAMPLE_FIELDS,
    is_colored,
    lighting_defines,
    lighting_samplers,
    looks_at_points,
)
from ..uniforms import CAMERA_FIELDS, LENS_FIELDS, Fields, block
from .options import TranslucentOptions, lit_outputs

MOST_SHARED_LIGHTS = 4  # lights whose shares are kept


def draw_list_rows(texel: np.ndarray, instance: np.ndarray) -> np.ndarray:
    """Returns a draw list, (N, 2) float32: of each splat its texel in the page (N,), and its instance (N,)."""
    rows = np.empty((len(texel), 2), np.float32)
    rows[:, 0] = texel & (PAGE_WIDTH * PAGE_WIDTH - 1)
    rows[:, 1] = 4 * instance.astype(np.int64) + (texel >> 24)
    return rows


def instances_of_rows(rows: np.ndarray) -> np.ndarray:
    """Returns the instance of each row of a draw list (N, 2), (N,) int64."""
    return rows[:, 1].astype(np.int64) >> 2


GATHERED_FIELDS: Fields = (
    ("mat4", "blocks_from_view"),
    ("ivec4", "medium_blocks"),  # along each axis
)


def _sample_fields(lighting: tuple[str, ...]) -> Fields:
    return SAMPLE_FIELDS if "PS_SHADOW_SAMPLE" in lighting else ()


LIST_FIELDS: Fields = (
    ("int", "count"),  # of the splats in the list
    ("float", "low_pass_scale"),  # of the low-pass of splats that are not particles
)


def _light_block(options: TranslucentOptions, lighting: tuple[str, ...]) -> Block:
    """The uniforms of the pass `light`."""
    lens = LENS_FIELDS if options.defocus else ()
    gathered = GATHERED_FIELDS if options.gathered else ()
    return block("Light", CAMERA_FIELDS, LIST_FIELDS, LIGHT_FIELDS, lens, gathered, _sample_fields(lighting))


def _reach_block(lighting: tuple[str, ...]) -> Block:
    """The uniforms of the pass `reach`."""
    return block("Reach", CAMERA_FIELDS, (("int", "count"),), _sample_fields(lighting))


def light_program(
    options: TranslucentOptions, lighting: tuple[str, ...], materials: tuple[str, ...], reached: int = 0
) -> Interface:
    """Returns the program that lights every splat of the draw list. `reached`: of so many lights the share that reaches
    each splat is known."""
    colored = is_colored(lighting)
    known: tuple[tuple[str, str], ...] = ()
    if reached:
        lighting = tuple(name for name in lighting if not name.startswith(("PS_SHADOW", "PS_PANES", "PS_FACES")))
        known = ("PS_REACHED", str(reached)), *((("PS_REACHED_COLORED", "1"),) if colored else ())
    read = ("order", "instances", "position", "extent", "optics", "materials")
    read += tuple(name for name, on in options.attributes if on)
    read += ("share",) if options.defocus and options.fuzzy else ()
    read += ("span",) if options.slopes else ()
    read += tuple(f"reach_{i}" for i in range(_reach_textures(reached, colored)))
    read += ("medium_light_of",) if options.gathered else ()
    read += ("gathered_light", "mirrored_light") if options.received else ()
    width = (("PS_MEDIA_WIDTH", str(MEDIA_WIDTH)),) if options.gathered else ()
    named = {"PS_MEDIA": options.media, "PS_GATHERED_MEDIUM": options.gathered}
    named |= {"PS_AMONG_OPAQUE": options.fronts, "PS_INDIRECT": options.received}
    named |= {"PS_KERNELS": options.kernels, "PS_HOLDOUT": options.holdout, "PS_CULL": options.cull}
    named |= {
        "PS_FUZZY_DISCONNECTED": options.disconnected,
        "PS_DEFOCUS": options.defocus,
        "PS_SLOPES": options.slopes,
        "PS_STRANDS": options.strands,
        "PS_CENTRES": options.captured,
    }
    named |= {f"PS_{name.upper()}": on for name, on in options.attributes}
    return Interface(
        "light", fragment="translucent/light.frag", block=_light_block(options, lighting),
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(lighting)),
        outputs=tuple(("vec4", f"out_{name}") for name in lit_outputs(options)),
        defines=(*lighting_defines(lighting), *known, *width, *_fuzzy_defines(options, lighting),
                 *((name, "1") for name in (*materials, *(name for name, on in named.items() if on)))),
    )  # fmt: skip


def places_program(options: TranslucentOptions) -> Interface:
    """Returns the program that tells where the splats of the draw list are that are lit as surfaces, as
    shaders/indirect/group_points.frag does of groups."""
    known = {name: on for name, on in options.attributes if name in ("surface", "shading_normal")}
    read = ("order", "instances", "position", "extent", "optics", "materials")
    read += tuple(name for name, on in known.items() if on)
    named = {f"PS_{name.upper()}": on for name, on in known.items()}
    named |= {
        "PS_MEDIA": options.media,
        "PS_DEFOCUS": options.defocus,
        "PS_STRANDS": options.strands,
        "PS_PLACES": True,
    }
    return Interface(
        "places", fragment="translucent/light.frag",
        block=block("Places", CAMERA_FIELDS, LIST_FIELDS, LIGHT_FIELDS, LENS_FIELDS, (("mat4", "tree_from_view"),)),
        samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in read),
        outputs=(("vec4", "out_place"), ("vec4", "out_up")),
        defines=(*_fuzzy_defines(options, ()), *((name, "1") for name, on in named.items() if on)),
    )  # fmt: skip


def light_shares_program(options: TranslucentOptions, lighting: tuple[str, ...], lights: int) -> Interface:
    """Returns the program that finds the share of each light that reaches every splat of a page; its draw list holds
    all splats in their own order."""
    # All cameras share what arrives, and nested maps are for one.
    lighting = tuple(name for name in lighting if name != "PS_SHADOW_NESTED")
    colored = is_colored(lighting)
    read = ("order", "instances", "position", "extent", "optics", "materials")
    read += ("shading_normal",) if options.shading_normal else ()
    defines = (*_fuzzy_defines(options, lighting), *((("PS_SHADING_NORMAL", "1"),) if options.shading_normal else ()))
    return Interface(
        "reach", fragment="translucent/light.frag", block=_reach_block(lighting),
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(lighting)),
        outputs=tuple(("vec4", f"out_reach_{i}") for i in range(_reach_textures(lights, colored))),
        defines=(*lighting_defines(lighting), ("PS_REACH", str(lights)),
                 *((("PS_REACH_COLORED", "1"),) if colored else ()), *defines),
    )  # fmt: skip


def _fuzzy_defines(options: TranslucentOptions, lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """One point of each wide light a sample is enough for splats that overlap, and blur what they receive; opaque ones
    do not, and a sample of groups is a whole picture. Those that overlap look at other points than their neighbours."""
    points = MOST_LIGHT_POINTS if options.fuzzy or options.grouped else 1
    taps = (("PS_SHADOW_TAPS", str(points)),) if "PS_SHADOW_TABLES" in lighting else ()
    if looks_at_points(lighting) and not options.fuzzy:
        taps += (("PS_SHADOW_SPREAD", "1"), ("PS_POINTS_OF_MEDIUM", str(min(points, POINTS_OF_MEDIUM))))
    narrow = float(np.sqrt(4 * painter.SUPPORT / SUPPORT))
    return (*taps, *((("PS_FUZZY", repr(narrow)),) if options.fuzzy else ()))


def _reach_textures(lights: int, colored: bool) -> int:
    """Returns the number of textures: shares without a colour of all lights lie in one."""
    return lights if colored else min(lights, 1)
