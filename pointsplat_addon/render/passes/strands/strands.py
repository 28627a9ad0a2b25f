"""Draws segments of strands into the G-buffer, as polygons are (Marroquim et al. 2008, section 4).

Lists hold the texel of each segment that is drawn. Thin segments are raster lines of one pixel and have a list for each
sample (core/strand/segments.py says which). The others have one list for all samples: tubes that may be seen to be
round are met by the pixels' rays; narrower ones are strips that face the eye, as ribbons are.
"""

from __future__ import annotations

from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..uniforms import CAMERA_FIELDS, Fields, SampleView, block
from .strand_page import StrandDraw

CHUNK = 1 << 20  # segments of one draw; Blender wants a vertex buffer, if an empty one, for all its vertices

FIRST: Fields = (("int", "first"),)  # entry of the list
STRANDS = block("Strands", CAMERA_FIELDS, FIRST)
THIN = block("ThinStrands", CAMERA_FIELDS, FIRST, (("float", "sample_offset"),))


def attribute_samplers(variant: Variant) -> list[str]:
    """Returns the names of the textures of what varies along strands."""
    named = {"ps_color": variant.color, "ps_surface": variant.surface, "ps_emission": variant.emission}
    return [name for name, on in named.items() if on]


def program(variant: Variant, ribbon: bool, kind: str) -> Interface:
    """Returns the program that draws one kind of segments, THIN, STRIP or TUBE, into one variant of the G-buffer.

    ribbon: whether the strands are flat ribbons that have a side direction, not round hairs.
    """
    thin, tube = kind == "THIN", kind == "TUBE"
    fetched = ["ps_segment_list", "ps_segments", "ps_point", "ps_instances"]
    strip = kind == "STRIP" and not ribbon  # faces the eye, across its tangent
    fetched += ["ps_tangent"] if variant.normal or tube or strip else []
    fetched += ["ps_side"] if ribbon else []
    fetched += ["ps_materials"] if tube and variant.normal else []
    fetched += attribute_samplers(variant)
    varyings = [("flat", "vec4", "v_segment")]
    if tube:
        varyings += [("flat", "vec4", name) for name in ("v_from", "v_to", "v_begin", "v_end")]
    else:
        varyings += [("smooth", "vec3", "v_position"), ("smooth", "float", "v_along")]
        varyings += [("smooth", "vec3", "v_normal")] if variant.normal else []
        varyings += [("smooth", "vec2", "v_share")] if thin else []
    kinds = {"PS_THIN": thin, "PS_RIBBON": ribbon, "PS_TUBE": tube}
    return Interface(
        "lines", vertex="strands/strands.vert", fragment="strands/strands.frag", block=THIN if thin else STRANDS,
        samplers=tuple(("FLOAT_2D", name) for name in fetched),
        varyings=tuple(varyings), outputs=variant.front_outputs, depth=True,
        defines=(*variant.front_defines, *((name, "1") for name, on in kinds.items() if on)),
    )  # fmt: skip


def draw(
    device: Device,
    variant: Variant,
    draws: list[StrandDraw],
    view: SampleView,
    shared: dict[str, Texture],
    out: GBuffer,
) -> None:
    """Draws all strands of one sample into the G-buffer."""
    for part in draws:
        for kind, listed in part.lists().items():
            thin = kind == "THIN"
            texture, total = listed
            textures = {**shared, **part.page.textures, "ps_segments": part.texture, "ps_segment_list": texture}
            for first in range(0, total, CHUNK):
                own = {"sample_offset": part.turn} if thin else {}
                record = view.record(THIN if thin else STRANDS, first=first, **own)
                device.draw(
                    program(variant, part.page.ribbon, kind), out.target, uniforms=record, textures=textures,
                    vertices=min(CHUNK, total - first) * (2 if thin else 6),
                    primitive="LINES" if thin else "TRIANGLES", depth_test=True,
                )  # fmt: skip
