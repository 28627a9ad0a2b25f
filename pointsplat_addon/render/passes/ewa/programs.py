"""The programs of EWA splatting and their uniforms; what they leave is described in passes/ewa/ewa.py."""

from __future__ import annotations

from ....core.numeric.record import value_record
from ....shading.interface import Block, Interface
from ..gbuffer import Variant
from ..pages.point_page import PointOptions, attributes, page_block
from ..uniforms import CAMERA_FIELDS, Fields, block
from .options import EwaOptions

ATTRIBUTES = ("normal", "color", "emission")  # of the G-buffer, that are blended

LOW_PASS: Fields = (("float", "low_pass"),)  # pixels^2 of variance
FIRST: Fields = (("int", "first"),)  # entry of the list of splats
NORMALISE = block("Normalise", CAMERA_FIELDS)


def project_block(points: PointOptions) -> Block:
    """The uniforms of the pass `splats`."""
    return page_block("Splats", points, LOW_PASS)


def _drawn_block(points: PointOptions, blend: bool, large: bool) -> Block:
    """The uniforms of the passes that draw listed splats."""
    own = (FIRST, LOW_PASS) if blend else (FIRST,)
    if large:
        return page_block("LargeSplats", points, *own)
    return block("SmallSplats", CAMERA_FIELDS, *own)


@value_record
class EwaPrograms:
    """Interfaces of one variant."""

    splats: Interface
    visibility: tuple[Interface, ...]  # of small splats, and of large ones
    blend: tuple[Interface, ...]
    normalise: Interface


def programs(variant: Variant, points: PointOptions, ewa: EwaOptions) -> EwaPrograms:
    """Returns the programs of one variant."""
    named = tuple((name, "1") for name in variant.defines if name != "PS_OWNER")
    flags = {"PS_CULL": points.cull, "PS_ELLIPSES": points.ellipses}
    flagged = tuple((name, "1") for name, on in flags.items() if on)
    samplers, defines = attributes(variant, points)
    cull = (("FLOAT_2D", "ps_materials"),) if points.cull else ()
    blended = blended_attributes(variant)
    splats = Interface(
        "splats", fragment="ewa/project.frag", block=project_block(points), samplers=(*samplers, *cull),
        outputs=tuple(("vec4", f"out_{name}") for name in ("centre", "shape", "front", *blended)),
        defines=(*named, *flagged, *defines),
    )  # fmt: skip
    hard = (("PS_HARD", "1"),) if ewa.hard else ()
    normalise = Interface(
        "normalise", fragment="ewa/normalise.frag", block=NORMALISE,
        samplers=tuple(("FLOAT_2D", name) for name in ("ps_nearest", *(f"ps_sum_{n}" for n in ("depth", *blended)))),
        outputs=variant.front_outputs, depth=points.depth,
        defines=(*variant.front_defines, *((("PS_DEPTH", "1"),) if points.depth else ()), *hard),
    )  # fmt: skip
    kinds = (False, True) if ewa.large else (False,)
    return EwaPrograms(
        splats,
        tuple(_drawn(variant, points, ewa, False, large) for large in kinds),
        tuple(_drawn(variant, points, ewa, True, large) for large in kinds),
        normalise,
    )


def blended_attributes(variant: Variant) -> tuple[str, ...]:
    """Returns the names of what is blended: `ATTRIBUTES`, and the velocity that rides with the owner."""
    return tuple(n for n, _, _ in variant.channels if n in ATTRIBUTES) + (("velocity",) if variant.velocity else ())


def _drawn(variant: Variant, points: PointOptions, ewa: EwaOptions, blend: bool, large: bool) -> Interface:
    """Returns the program that draws listed splats: with `blend` their kernels, else their ellipses."""
    blended = blended_attributes(variant) if blend else ()
    samplers = [
        ("FLOAT_2D", name) for name in ("ps_list", *(f"ps_splat_{n}" for n in ("centre", "shape", "front", *blended)))
    ]
    names = ["v_centre", "v_conic", "v_front", "v_material", *(f"v_{name}" for name in blended)]
    defines: list[tuple[str, str]] = []
    if blend:
        samplers.append(("FLOAT_2D", "ps_nearest"))
        defines += [("PS_BLEND", "1"), *((name, "1") for name in variant.defines if name != "PS_OWNER")]
        defines += [("PS_BALLS", "1")] if ewa.balls and variant.normal else []
        defines += [("PS_HARD", "1")] if ewa.hard else []
        outputs = tuple(("vec4", f"out_{name}") for name in ("depth", *blended))
    else:
        outputs = (("vec4", "out_nearest"),)
    if large:
        pages = ("ps_blocks", "ps_position", "ps_extent", *(() if points.one_instance else ("ps_instances",)))
        samplers += [("FLOAT_2D", name) for name in pages]
        names += ["v_u", "v_v", "v_plane"]
        flags = {"PS_LARGE": True, "PS_ELLIPSES": points.ellipses, "PS_ONE_INSTANCE": points.one_instance}
        defines += [(name, "1") for name, on in flags.items() if on]
    return Interface(
        "blend" if blend else "visibility",
        vertex="ewa/large.vert" if large else "ewa/blend.vert",
        fragment="ewa/blend.frag", block=_drawn_block(points, blend, large), samplers=tuple(samplers),
        varyings=tuple(("flat", "vec4", name) for name in names),
        outputs=outputs, defines=tuple(defines), depth=not blend,
    )  # fmt: skip
