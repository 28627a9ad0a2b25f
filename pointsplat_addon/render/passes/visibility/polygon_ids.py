"""Draws polygons into the visibility buffer, and the attributes of those that stand for groups into the G-buffer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Block, Interface
from ...device.packing import paged
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..grouping.groups import Groups, Leaders
from ..shading.lighting import SAMPLE_FIELDS
from ..uniforms import CAMERA_FIELDS, ONE_INSTANCE_FIELDS, RECTANGLE_FIELDS, Fields, SampleView, Values, block
from .buffer import (
    DEPTH_ONLY_DEFINE,
    DEPTH_OUTPUT,
    LATTICE_DEFINE,
    LATTICE_FIELDS,
    OUTPUTS,
    DepthBuffer,
    VisibilityBuffer,
    offset_defines,
    rank_defines,
    sub_sample_defines,
)
from .polygon_mesh import CORNERS, Group, PolygonMesh, define_entries
from .polygons import CUT_VARYING, needed_defines

MOST_VERTICES = 1 << 26  # of one draw
AVERAGE_DEFINE = ("PS_AVERAGE", "1")  # pictures are averaged over sub-samples
MESH_FIELDS: Fields = (
    ("int", "material"),
    ("int", "first_id"),  # number of the first triangle of the first instance
    ("int", "triangles"),  # of the mesh
)


class PolygonDraw:
    """All instances of one mesh that a view shows: slots, of which each has the number of a mesh's triangles."""

    def __init__(
        self,
        device: Device,
        mesh: PolygonMesh,
        instance: np.ndarray,
        view_from_object: np.ndarray,
        holdout: np.ndarray,
        first_id: int,
    ) -> None:
        """instance: (I,) int. view_from_object: (I, 4, 4) float64, from positions relative to the mesh's origin.
        holdout: (I,) bool.
        """
        self.mesh, self.first_id, self.slots = mesh, first_id, len(instance)
        self.instance = instance
        mirrored = np.linalg.det(view_from_object[:, :3, :3]) < 0
        self.textures: dict[str, Texture] = {}
        self.values: Values = {}
        if self.slots == 1:
            self.values = {
                "view_from_object": view_from_object[0],
                "instance": int(instance[0]),
                "holdout": bool(holdout[0]),
                "mirrored": bool(mirrored[0]),
            }
            return
        rows = np.zeros((self.slots, 4, 4), np.float32)
        rows[:, :3] = view_from_object[:, :3]
        rows[:, 3, :3] = np.stack([holdout, instance, mirrored], axis=1)
        size, data = paged(rows.reshape(-1, 4), 4)
        self.textures["ps_instances"] = device.texture(size, "RGBA32F", data)

    @property
    def triangles(self) -> int:
        """Of all slots."""
        return self.slots * self.mesh.triangles

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def _block(name: str, one: bool, own: Fields, of_one: Fields, *groups: Fields) -> Block:
    """The uniforms of a pass; `of_one`: what is read only where there is one instance."""
    alone = (*ONE_INSTANCE_FIELDS, ("int", "instance"), *of_one) if one else ()
    return block(name, CAMERA_FIELDS, MESH_FIELDS, own, alone, *groups)


def depths_program(lattice: Lattice, group: Group, one: bool) -> Interface:
    """Returns the program that draws the depth of a group of triangles, whichever side they show. `one`: there is one
    instance."""
    return _cover_program(lattice, replace(group, cull=False), one, ())


def ids_program(normal: bool, lattice: Lattice, group: Group, one: bool) -> Interface:
    """Returns the program that draws a group of triangles into the visibility buffer.

    `normal`: something is lit, and normals tell surfaces apart. `one`: there is one instance.
    """
    varyings = [("flat", "uint", "v_id"), ("flat", "vec2", "v_about")]
    return _cover_program(lattice, group, one, (*varyings, *((("smooth", "vec3", "v_normal"),) if normal else ())))


def _cover_program(lattice: Lattice, group: Group, one: bool, identity: tuple[tuple[str, str, str], ...]) -> Interface:
    """Returns the program that draws a group of triangles. `identity`: varyings that tell triangles and surfaces apart;
    none: only depths are drawn."""
    normal = any(name == "v_normal" for _, _, name in identity)
    baked = ("PS_UV", "PS_PICTURE", "PS_BAKED_ALPHA") if "PS_BAKED_ALPHA" in group.defines else ()
    names = [name for name in group.defines if name.startswith((*baked, "PS_CORNER_ALPHA"))]
    if "PS_CORNER_ALPHA" in names:
        names.append("PS_CORNER_COLOR")
    samplers = ["ps_corner", *(() if one else ("ps_instances",))]
    varyings = [("smooth", "vec3", "v_position"), *identity]
    if "PS_UV" in names:
        samplers += ["ps_corner_uv", "ps_baked_color"]
        varyings.append(("smooth", "vec2", "v_uv"))
    if "PS_CORNER_COLOR" in names:
        samplers.append("ps_corner_color")
        varyings.append(("smooth", "vec4", "v_color"))
    cut = any(name.endswith("ALPHA") for name in names)
    if cut:
        varyings.append(CUT_VARYING)
    own: Fields = (("int", "first"), ("int", "corners"), ("int", "first_slot"))  # corners: of the group
    sample = SAMPLE_FIELDS if cut else ()
    alone = (*ONE_INSTANCE_FIELDS, *((("int", "instance"),) if cut else ())) if one else ()
    flags = {"PS_CULL": group.cull, "PS_NORMAL": normal, "PS_ONE_INSTANCE": one, "PS_CUT": cut,
             DEPTH_ONLY_DEFINE[0]: not identity}  # fmt: skip
    return Interface(
        "polygons" if identity else "shadow maps",
        vertex="visibility/polygon_ids.vert",
        fragment="visibility/polygon_ids.frag",
        block=_block("PolygonIds", one, own, (("int", "mirrored"),), LATTICE_FIELDS, sample)
        if identity
        else block("PolygonDepths", CAMERA_FIELDS, own, alone, LATTICE_FIELDS, sample),
        samplers=tuple(("FLOAT_2D", name) for name in samplers),
        varyings=tuple(varyings),
        outputs=OUTPUTS if identity else DEPTH_OUTPUT,
        defines=(
            LATTICE_DEFINE,
            *define_entries([*names, *(name for name, on in flags.items() if on)]),
            *(rank_defines(lattice) if cut else ()),
        ),
        depth=True,
    )


def surface_program(variant: Variant, lattice: Lattice, group: Group, one: bool, leaders: Leaders) -> Interface:
    """Returns the program that writes the attributes of triangles that stand for groups of sub-samples."""
    names = [name for name in needed_defines(variant, group) if not name.endswith("ALPHA")]
    samplers = ["ps_corner", *(("ps_corner_uv",) if "PS_UV" in names else ()), *(() if one else ("ps_instances",))]
    samplers += [name for name in CORNERS if name.upper() in names]
    samplers += [name for name in group.textures if name.upper() in names]
    kinds = {"COLOR": variant.color, "SURFACE": variant.surface, "EMISSION": variant.emission}
    if any(on and not {f"PS_BAKED_{kind}", f"PS_CORNER_{kind}"} & set(names) for kind, on in kinds.items()):
        samplers.append("ps_materials")
    averaged = not leaders.central and any(name.startswith("PS_BAKED") and name != "PS_BAKED_NORMAL" for name in names)
    read = ("ps_ids", "ps_depths", "ps_first", "ps_second") if averaged else ()
    own: Fields = (("int", "first_triangle"), ("int", "last_triangle"), ("int", "slots"))
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="grouping/polygon_surface.frag",
        block=_block(
            "PolygonSurface",
            one,
            own,
            (("int", "holdout"),),
            RECTANGLE_FIELDS,
            leaders.fields,
            LATTICE_FIELDS if averaged else (),
        ),
        samplers=(*(("FLOAT_2D", name) for name in samplers), *leaders.samplers, *(("UINT_2D", name) for name in read)),
        outputs=variant.outputs(),
        defines=(
            *define_entries([*variant.defines, *names, *(("PS_ONE_INSTANCE",) if one else ())]),
            *offset_defines(lattice),
            *((LATTICE_DEFINE, AVERAGE_DEFINE, *sub_sample_defines(lattice)[1:]) if averaged else ()),
            *leaders.defines,
        ),
    )


@dataclass(frozen=True, eq=False)
class PolygonDepths:
    """Draws the depths of polygons."""

    device: Device
    draws: list[PolygonDraw]
    buffer: DepthBuffer

    def cover(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws all polygons."""
        self._cover(depths_program, view, shared)

    def _cover(
        self,
        program_of: Callable[[Lattice, Group, bool], Interface],
        view: SampleView,
        shared: dict[str, Texture],
        **values: object,
    ) -> None:
        for draw in self.draws:
            for group in draw.mesh.groups:
                program = program_of(self.buffer.lattice, group, draw.slots == 1)
                step = max(MOST_VERTICES // group.count, 1)
                for slot in range(0, draw.slots, step):
                    own = {"first": group.first, "corners": group.count, "first_slot": slot}
                    self.device.draw(
                        program,
                        self.buffer.target,
                        uniforms=self._record(program, draw, group, view, **own, **self.buffer.values, **values),
                        textures={**shared, **draw.mesh.textures, **group.textures, **draw.textures},
                        vertices=group.count * min(step, draw.slots - slot),
                        depth_test=True,
                    )

    def _record(
        self, program: Interface, draw: PolygonDraw, group: Group, view: SampleView, **own: object
    ) -> np.ndarray:
        about = {"material": group.material, "first_id": draw.first_id, "triangles": draw.mesh.triangles}
        return view.record_of(program.block, **about, **draw.values, **own)

    def release(self) -> None:
        for draw in self.draws:
            draw.release()


@dataclass(frozen=True, eq=False)
class PolygonCover(PolygonDepths):
    """Draws the polygons of one picture into its visibility buffer."""

    buffer: VisibilityBuffer

    def identify(self, normal: bool, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws all polygons with their numbers. `normal`: normals tell surfaces apart."""
        self._cover(partial(ids_program, normal), view, shared)

    def write_attributes(
        self,
        variant: Variant,
        view: SampleView,
        shared: dict[str, Texture],
        groups: Groups,
        leaders: Leaders,
        out: GBuffer,
    ) -> None:
        """Writes the attributes of the triangles that stand for groups."""
        sub_samples = {**leaders.bound, **groups.codes, **self.buffer.textures}
        for draw in self.draws:
            where = groups.rectangle(leaders, draw.first_id)
            if where is None:
                continue
            for group in draw.mesh.groups:
                program = surface_program(variant, self.buffer.lattice, group, draw.slots == 1, leaders)
                first = group.first // 3
                own = {"first_triangle": first, "last_triangle": first + group.count // 3, "slots": draw.slots}
                own |= {"rectangle": where, "corner": leaders.place[1], **self.buffer.values}
                self.device.draw(
                    program,
                    out.target,
                    uniforms=self._record(program, draw, group, view, **own),
                    textures={**shared, **draw.mesh.textures, **group.textures, **draw.textures, **sub_samples},
                    vertices=6,
                )
