"""Draws polygons into the visibility buffer, and the attributes of those that stand for groups into the G-buffer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Block, Interface
from ...device.packing import paged
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..grouping.groups import Groups, Leaders
from ..uniforms import CAMERA_FIELDS, ONE_INSTANCE_FIELDS, RECTANGLE_FIELDS, Fields, SampleView, Values, block
from .buffer import LATTICE_DEFINE, LATTICE_FIELDS, OUTPUTS, VisibilityBuffer, offset_defines
from .polygon_mesh import CORNERS, Group, PolygonMesh
from .polygons import needed_defines

MOST_VERTICES = 1 << 26  # of one draw
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


def ids_program(normal: bool, group: Group, one: bool) -> Interface:
    """Returns the program that draws a group of triangles into the visibility buffer.

    `normal`: something is lit, and normals tell surfaces apart. `one`: there is one instance.
    """
    alpha = tuple(name for name in group.defines if name in ("PS_UV", "PS_BAKED_ALPHA", "PS_CORNER_ALPHA"))
    names = [name for name in alpha if name != "PS_UV" or "PS_BAKED_ALPHA" in alpha]
    if "PS_CORNER_ALPHA" in names:
        names.append("PS_CORNER_COLOR")
    samplers = ["ps_corner", *(() if one else ("ps_instances",))]
    varyings = [("smooth", "vec3", "v_position"), ("flat", "uint", "v_id"), ("flat", "vec2", "v_about")]
    if normal:
        varyings.append(("smooth", "vec3", "v_normal"))
    if "PS_UV" in names:
        samplers += ["ps_corner_uv", "ps_baked_color"]
        varyings.append(("smooth", "vec2", "v_uv"))
    if "PS_CORNER_COLOR" in names:
        samplers.append("ps_corner_color")
        varyings.append(("smooth", "vec4", "v_color"))
    own: Fields = (("int", "first"), ("int", "corners"), ("int", "first_slot"))  # corners: of the group
    flags = {"PS_CULL": group.cull, "PS_NORMAL": normal, "PS_ONE_INSTANCE": one}
    return Interface(
        "polygons",
        vertex="visibility/polygon_ids.vert",
        fragment="visibility/polygon_ids.frag",
        block=_block("PolygonIds", one, own, (("int", "mirrored"),), LATTICE_FIELDS),
        samplers=tuple(("FLOAT_2D", name) for name in samplers),
        varyings=tuple(varyings),
        outputs=OUTPUTS,
        defines=(LATTICE_DEFINE, *((name, "1") for name in (*names, *(name for name, on in flags.items() if on)))),
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
    own: Fields = (("int", "first_triangle"), ("int", "last_triangle"), ("int", "slots"))
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="grouping/polygon_surface.frag",
        block=_block("PolygonSurface", one, own, (("int", "holdout"),), RECTANGLE_FIELDS, leaders.fields),
        samplers=(*(("FLOAT_2D", name) for name in samplers), *leaders.samplers),
        outputs=variant.outputs(),
        defines=(
            *((name, "1") for name in (*variant.defines, *names, *(("PS_ONE_INSTANCE",) if one else ()))),
            *offset_defines(lattice),
            *leaders.defines,
        ),
    )


@dataclass(frozen=True, eq=False)
class PolygonCover:
    """Draws the polygons of one picture into its visibility buffer."""

    device: Device
    draws: list[PolygonDraw]
    buffer: VisibilityBuffer

    def cover(self, normal: bool, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws all polygons. `normal`: normals tell surfaces apart."""
        for draw in self.draws:
            for group in draw.mesh.groups:
                program = ids_program(normal, group, draw.slots == 1)
                step = max(MOST_VERTICES // group.count, 1)
                for slot in range(0, draw.slots, step):
                    own = {"first": group.first, "corners": group.count, "first_slot": slot}
                    self.device.draw(
                        program,
                        self.buffer.target,
                        uniforms=self._record(program, draw, group, view, **own, **self.buffer.values),
                        textures={**shared, **draw.mesh.textures, **group.textures, **draw.textures},
                        vertices=group.count * min(step, draw.slots - slot),
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
        """Writes the attributes of the triangles that stand for groups."""
        for draw in self.draws:
            where = groups.rectangle(leaders, draw.first_id)
            if where is None:
                continue
            for group in draw.mesh.groups:
                program = surface_program(variant, self.buffer.lattice, group, draw.slots == 1, leaders)
                first = group.first // 3
                own = {"first_triangle": first, "last_triangle": first + group.count // 3, "slots": draw.slots}
                self.device.draw(
                    program,
                    out.target,
                    uniforms=self._record(program, draw, group, view, **own, rectangle=where, corner=leaders.place[1]),
                    textures={**shared, **draw.mesh.textures, **group.textures, **draw.textures, **leaders.bound},
                    vertices=6,
                )

    def _record(
        self, program: Interface, draw: PolygonDraw, group: Group, view: SampleView, **own: object
    ) -> np.ndarray:
        about = {"material": group.material, "first_id": draw.first_id, "triangles": draw.mesh.triangles}
        return view.record_of(program.block, **about, **draw.values, **own)

    def release(self) -> None:
        for draw in self.draws:
            draw.release()
