"""Draws segments of strands into the visibility buffer, and the attributes of those that stand for groups into the
G-buffer.

Tubes that may be seen to be round are met by the rays of sub-samples. Narrower ones are strips that face the eye, as
ribbons are; where they are narrower than a cell they cover a share of the cells along them, so that the mean over
sub-samples has their area.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....core.numeric.record import record
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..grouping.groups import Groups, Leaders
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, Fields, SampleView, block
from ..visibility.buffer import (
    DEPTH_ONLY_DEFINE,
    DEPTH_OUTPUT,
    LATTICE_DEFINE,
    LATTICE_FIELDS,
    OUTPUTS,
    DepthBuffer,
    VisibilityBuffer,
    member_defines,
    offset_defines,
)
from .strand_page import StrandDraw
from .strands import CHUNK, attribute_samplers

NUMBERS: Fields = (("int", "first_id"),)  # number of the list's first segment
FIRST: Fields = (("int", "first"),)  # entry of the list
SHARE: Fields = (("ivec2", "cell_offset"), ("uint", "turn"))  # of thin strips: which cells they cover
TUBE_IDS = block("TubeIds", CAMERA_FIELDS, LATTICE_FIELDS, NUMBERS, FIRST)
STRIP_IDS = block("StripIds", CAMERA_FIELDS, LATTICE_FIELDS, NUMBERS, FIRST, SHARE)
TUBE_DEPTHS = block("TubeDepths", CAMERA_FIELDS, LATTICE_FIELDS, FIRST)
STRIP_DEPTHS = block("StripDepths", CAMERA_FIELDS, LATTICE_FIELDS, FIRST, SHARE)
SURFACE_FIELDS: Fields = (*RECTANGLE_FIELDS, *NUMBERS, ("int", "count"))
AVERAGED = (("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"))
OF_ATTRIBUTES = (("UINT_2D", "ps_ids"), ("UINT_2D", "ps_depths"))
OF_TANGENTS = (("UINT_2D", "ps_keys"),)


@record
class StrandKind:
    """The segments of one geometry that a view draws in one way."""

    draw: StrandDraw
    kind: str  # TUBE, STRIP or THIN
    first_id: int  # number of the first one

    @property
    def ribbon(self) -> bool:
        """Whether the strands are flat ribbons that have a side direction, not round hairs."""
        return self.draw.page.ribbon

    @property
    def segments(self) -> np.ndarray:
        """(n,) int64: the segments among all that the view draws of the geometry."""
        return self.draw.indices[self.kind]

    @property
    def count(self) -> int:
        """The number of segments."""
        return len(self.segments)

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by sampler name."""
        listed, _ = self.draw.lists()[self.kind]
        return {**self.draw.page.textures, "ps_segments": self.draw.texture, "ps_segment_list": listed}


def ids_program(normal: bool, ribbon: bool, kind: str) -> Interface:
    """Returns the program that draws one kind of segments, TUBE, STRIP or THIN, into the visibility buffer.

    `normal`: something is lit, and directions tell surfaces apart. `ribbon`: the strands are flat ribbons.
    """
    tube = kind == "TUBE"
    fetched = ["ps_segment_list", "ps_segments", "ps_point", "ps_instances"]
    fetched += ["ps_tangent"] if normal or tube or (kind == "STRIP" and not ribbon) else []
    fetched += ["ps_side"] if ribbon and (normal or kind == "STRIP") else []
    fetched += ["ps_materials"] if tube and normal else []
    varyings = [("flat", "uint", "v_id")]
    if tube:
        varyings += [("flat", "vec4", name) for name in ("v_segment", "v_from", "v_to", "v_begin", "v_end")]
    else:
        varyings += [("flat", "uint", "v_key"), ("flat", "uint", "v_phase"), ("flat", "int", "v_rows")]
        varyings += [("smooth", "vec3", "v_position"), ("smooth", "vec2", "v_extent")]
        varyings += [("flat", "vec3", "v_line")] if kind == "THIN" else []
    return Interface(
        "lines",
        vertex="strands/strand_ids.vert",
        fragment="strands/strand_ids.frag",
        block=TUBE_IDS if tube else STRIP_IDS,
        samplers=tuple(("FLOAT_2D", name) for name in fetched),
        varyings=tuple(varyings),
        outputs=OUTPUTS,
        defines=(
            LATTICE_DEFINE,
            *_kind_defines(ribbon, kind),
            *((name, "1") for name, on in {"PS_NORMAL": normal, "PS_THIN": kind == "THIN"}.items() if on),
        ),
        depth=True,
    )


def depths_program(ribbon: bool, kind: str) -> Interface:
    """Returns the program that draws the depth of one kind of segments; see ids_program."""
    tube = kind == "TUBE"
    fetched = ["ps_segment_list", "ps_segments", "ps_point", "ps_instances"]
    fetched += ["ps_tangent"] if tube or (kind == "STRIP" and not ribbon) else []
    fetched += ["ps_side"] if ribbon and kind == "STRIP" else []
    varyings = [("flat", "vec4", name) for name in ("v_from", "v_to", "v_begin", "v_end")] if tube else []
    if not tube:
        varyings += [("flat", "uint", "v_phase"), ("flat", "int", "v_rows")]
        varyings += [("smooth", "vec3", "v_position"), ("smooth", "vec2", "v_extent")]
        varyings += [("flat", "vec3", "v_line")] if kind == "THIN" else []
    return Interface(
        "shadow maps",
        vertex="strands/strand_ids.vert",
        fragment="strands/strand_ids.frag",
        block=TUBE_DEPTHS if tube else STRIP_DEPTHS,
        samplers=tuple(("FLOAT_2D", name) for name in fetched),
        varyings=tuple(varyings),
        outputs=DEPTH_OUTPUT,
        defines=(
            LATTICE_DEFINE,
            DEPTH_ONLY_DEFINE,
            *_kind_defines(ribbon, kind),
            *((("PS_THIN", "1"),) if kind == "THIN" else ()),
        ),
        depth=True,
    )


def surface_program(variant: Variant, lattice: Lattice, ribbon: bool, kind: str, leaders: Leaders) -> Interface:
    """Returns the program that writes the attributes of segments that stand for groups of sub-samples."""
    tube = kind == "TUBE"
    fetched = ["ps_segment_list", "ps_segments", "ps_point", "ps_instances"]
    fetched += ["ps_tangent"] if variant.normal or tube else []
    fetched += ["ps_side"] if ribbon and variant.normal else []
    fetched += ["ps_materials"] if tube and variant.normal else []
    fetched += attribute_samplers(variant)
    own = not tube and not leaders.central
    attributes, tangents = own and (variant.color or variant.emission), own and variant.normal and not ribbon
    averages = attributes or tangents
    read = (*(AVERAGED if averages else ()), *(OF_ATTRIBUTES if attributes else ()), *(OF_TANGENTS if tangents else ()))
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="strands/strand_surface.frag",
        block=block("StrandSurface", CAMERA_FIELDS, LATTICE_FIELDS, SURFACE_FIELDS, leaders.fields),
        samplers=(*(("FLOAT_2D", name) for name in fetched), *leaders.samplers, *read),
        outputs=variant.outputs(),
        defines=(
            LATTICE_DEFINE,
            *((name, "1") for name in variant.defines),
            *_kind_defines(ribbon, kind),
            *offset_defines(lattice),
            *(member_defines(lattice) if averages else ()),
            *leaders.defines,
        ),
    )


def _kind_defines(ribbon: bool, kind: str) -> tuple[tuple[str, str], ...]:
    named = {"PS_RIBBON": ribbon, "PS_TUBE": kind == "TUBE"}
    return tuple((name, "1") for name, on in named.items() if on)


def cover_depths(
    device: Device, draws: list[StrandDraw], depths: DepthBuffer, view: SampleView, shared: dict[str, Texture]
) -> None:
    """Draws the depths of all segments, nearer than what is there. Which cells thin ones cover is the sample's."""
    turn = _reversed_bits(view.sample)
    for draw in draws:
        for kind, (_, count) in draw.lists().items():
            named = StrandKind(draw, kind, 0)
            program = depths_program(named.ribbon, kind)
            for first in range(0, count, CHUNK):
                device.draw(
                    program,
                    depths.target,
                    uniforms=view.record_of(program.block, first=first, cell_offset=(0, 0), turn=turn, **depths.values),
                    textures={**shared, **named.textures},
                    vertices=(2 if kind == "THIN" else 6) * min(CHUNK, count - first),
                    primitive="LINES" if kind == "THIN" else "TRIANGLES",
                    depth_test=True,
                )


@record
class StrandCover:
    """Draws the strands of one picture into its visibility buffer."""

    device: Device
    draws: list[StrandKind]
    buffer: VisibilityBuffer

    def cover(self, normal: bool, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws all segments. `normal`: directions tell surfaces apart."""
        buffer, corner = self.buffer, view.camera.window[:2]
        for draw in self.draws:
            program = ids_program(normal, draw.ribbon, draw.kind)
            draw.draw.drawn += draw.count
            own = {"first_id": draw.first_id, "turn": _reversed_bits(view.sample), **buffer.values}
            for first in range(0, draw.count, CHUNK):
                self.device.draw(
                    program,
                    buffer.target,
                    uniforms=view.record_of(program.block, first=first, cell_offset=buffer.cell_offset(corner), **own),
                    textures={**shared, **draw.textures},
                    vertices=(2 if draw.kind == "THIN" else 6) * min(CHUNK, draw.count - first),
                    primitive="LINES" if draw.kind == "THIN" else "TRIANGLES",
                    depth_test=True,
                )

    def write_attributes(
        self,
        variant: Variant,
        view: SampleView,
        shared: dict[str, Texture],
        groups: Groups,
        leaders: Leaders,
        out: GBuffer,
    ) -> None:
        """Writes the attributes of the segments that stand for groups."""
        for draw in self.draws:
            where = groups.rectangle(leaders, draw.first_id)
            if where is None:
                continue
            program = surface_program(variant, self.buffer.lattice, draw.ribbon, draw.kind, leaders)
            own = {"first_id": draw.first_id, "count": draw.count, "rectangle": where, "corner": leaders.place[1]}
            own |= self.buffer.values
            read = {**leaders.bound, **groups.codes, **self.buffer.textures}
            self.device.draw(
                program,
                out.target,
                uniforms=view.record_of(program.block, **own),
                textures={**shared, **draw.textures, **read},
                vertices=6,
            )


def _reversed_bits(number: int) -> int:
    """Returns the bits of a number below 2^32 from last to first: beginnings of the sequence are spread evenly."""
    return int(f"{number:032b}"[::-1], 2)
