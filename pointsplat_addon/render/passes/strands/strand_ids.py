"""Draws segments of strands into the visibility buffer, and the attributes of those that stand for groups into the
G-buffer.

Tubes that may be seen to be round are met by the rays of sub-samples. Narrower ones are strips that face the eye, as
ribbons are; where they are narrower than a cell they cover a share of the cells along them, so that the mean over
sub-samples has their area.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..uniforms import CAMERA_FIELDS, Fields, SampleView, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS, OUTPUTS, VisibilityBuffer, sub_sample_defines
from ..visibility.groups import LEADER_SAMPLERS, Groups
from ..visibility.polygon_ids import RECTANGLE_FIELDS
from .strand_page import StrandDraw
from .strands import CHUNK, attribute_samplers

FIRST: Fields = (("int", "first"), ("int", "first_id"))  # entry of the list; number of the list's first segment
SHARE: Fields = (("ivec2", "cell_offset"), ("uint", "turn"))  # of thin strips: which cells they cover
TUBE_IDS = block("TubeIds", CAMERA_FIELDS, LATTICE_FIELDS, FIRST)
STRIP_IDS = block("StripIds", CAMERA_FIELDS, LATTICE_FIELDS, FIRST, SHARE)
SURFACE = block("StrandSurface", CAMERA_FIELDS, RECTANGLE_FIELDS, (("int", "first_id"), ("int", "count")))


@dataclass(frozen=True, eq=False)
class StrandIds:
    """The segments of one geometry that are drawn in one way, in one view."""

    draw: StrandDraw
    kind: str  # TUBE or STRIP
    first_id: int  # number of the first one
    rectangle: tuple[float, float, float, float]  # that holds them in the picture: low and high corner, from 0 to 1

    @property
    def listed(self) -> tuple[Texture, int]:
        """The list of the segments, and how many there are."""
        return self.draw.lists()[self.kind]

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by sampler name."""
        return {**self.draw.page.textures, "ps_segments": self.draw.texture, "ps_list": self.listed[0]}


def ids_program(normal: bool, ribbon: bool, kind: str) -> Interface:
    """Returns the program that draws one kind of segments, TUBE or STRIP, into the visibility buffer.

    `normal`: something is lit, and directions tell surfaces apart. `ribbon`: the strands are flat ribbons.
    """
    tube = kind == "TUBE"
    fetched = ["ps_list", "ps_segments", "ps_point", "ps_instances"]
    fetched += ["ps_tangent"] if normal or not ribbon else []
    fetched += ["ps_side"] if ribbon else []
    fetched += ["ps_materials"] if tube and normal else []
    varyings = [("flat", "uint", "v_id")]
    if tube:
        varyings += [("flat", "vec4", name) for name in ("v_segment", "v_from", "v_to", "v_begin", "v_end")]
    else:
        varyings += [("flat", "uint", "v_key"), ("flat", "uint", "v_phase"), ("flat", "int", "v_rows")]
        varyings += [("smooth", "vec3", "v_position"), ("smooth", "vec2", "v_extent")]
    return Interface(
        "lines",
        vertex="strands/strand_ids.vert",
        fragment="strands/strand_ids.frag",
        block=TUBE_IDS if tube else STRIP_IDS,
        samplers=tuple(("FLOAT_2D", name) for name in fetched),
        varyings=tuple(varyings),
        outputs=OUTPUTS,
        defines=(LATTICE_DEFINE, *_kind_defines(ribbon, kind), *((("PS_NORMAL", "1"),) if normal else ())),
        depth=True,
    )


def surface_program(variant: Variant, lattice: Lattice, ribbon: bool, kind: str) -> Interface:
    """Returns the program that writes the attributes of segments that stand for groups of sub-samples."""
    tube = kind == "TUBE"
    fetched = ["ps_list", "ps_segments", "ps_point", "ps_instances"]
    fetched += ["ps_tangent"] if variant.normal or tube else []
    fetched += ["ps_side"] if ribbon and variant.normal else []
    fetched += ["ps_materials"] if tube and variant.normal else []
    fetched += attribute_samplers(variant)
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="strands/strand_surface.frag",
        block=SURFACE,
        samplers=(*(("FLOAT_2D", name) for name in fetched), *LEADER_SAMPLERS),
        outputs=variant.outputs(),
        defines=(
            *((name, "1") for name in variant.defines),
            *_kind_defines(ribbon, kind),
            *sub_sample_defines(lattice),
        ),
    )


def _kind_defines(ribbon: bool, kind: str) -> tuple[tuple[str, str], ...]:
    named = {"PS_RIBBON": ribbon, "PS_TUBE": kind == "TUBE"}
    return tuple((name, "1") for name, on in named.items() if on)


def draw_ids(
    device: Device,
    normal: bool,
    draws: list[StrandIds],
    view: SampleView,
    shared: dict[str, Texture],
    out: VisibilityBuffer,
) -> None:
    """Draws segments of strands into the visibility buffer."""
    share = {"cell_offset": out.cell_offset(view.camera.window[:2]), "turn": _reversed_bits(view.sample)}
    for part in draws:
        program, total = ids_program(normal, part.draw.page.ribbon, part.kind), part.listed[1]
        part.draw.drawn += total
        for first in range(0, total, CHUNK):
            own = {"first": first, "first_id": part.first_id, **share, **out.values}
            device.draw(
                program,
                out.target,
                uniforms=view.record_of(program.block, **own),
                textures={**shared, **part.textures},
                vertices=6 * min(CHUNK, total - first),
                depth_test=True,
            )


def _reversed_bits(number: int) -> int:
    """Returns the bits of a number below 2^32 from the last to the first: beginnings of the sequence are evenly spread."""
    return int(f"{number:032b}"[::-1], 2)


def draw_attributes(
    device: Device,
    variant: Variant,
    draws: list[StrandIds],
    view: SampleView,
    shared: dict[str, Texture],
    groups: Groups,
    lattice: Lattice,
    out: GBuffer,
) -> None:
    """Writes the attributes of the segments that stand for one layer of groups."""
    for part in draws:
        program = surface_program(variant, lattice, part.draw.page.ribbon, part.kind)
        own = {"first_id": part.first_id, "count": part.listed[1], "rectangle": part.rectangle}
        device.draw(
            program,
            out.target,
            uniforms=view.record_of(program.block, **own),
            textures={**shared, **part.textures, **groups.leaders},
            vertices=6,
        )
