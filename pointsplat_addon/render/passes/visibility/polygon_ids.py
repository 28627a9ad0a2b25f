"""Draws polygons into the visibility buffer, and the attributes of those that stand for groups into the G-buffer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..uniforms import CAMERA_FIELDS, Fields, SampleView, block
from .buffer import LATTICE_DEFINE, LATTICE_FIELDS, OUTPUTS, VisibilityBuffer, sub_sample_defines
from .groups import LEADER_SAMPLERS, Groups
from .polygon_mesh import CORNERS, Group, PartList, PolygonMesh
from .polygons import CORNERS_OF_PART, needed_defines

RECTANGLE_FIELDS: Fields = (("vec4", "rectangle"),)  # low and high corner, from 0 to 1 over the target
OWN: Fields = (("mat4", "view_from_object"), ("int", "material"), ("int", "instance"), ("int", "first_id"))


@dataclass(frozen=True, eq=False)
class PolygonDraw:
    """One instance of a mesh in one view."""

    mesh: PolygonMesh
    instance: int
    view_from_object: np.ndarray  # (4, 4) float64, from positions relative to the mesh's origin
    holdout: bool
    first_id: int  # number of its first triangle
    rectangle: tuple[float, float, float, float]  # that holds it in the picture: low and high corner, from 0 to 1
    parts: list[PartList | None] | None  # of each group, where only some are drawn

    @property
    def mirrored(self) -> bool:
        """Whether the transform turns triangles over."""
        return bool(np.linalg.det(self.view_from_object[:3, :3]) < 0)

    def groups(self) -> Iterator[tuple[Group, PartList | None]]:
        """The groups of triangles that are drawn, each with the list of its parts where only some are."""
        for i, group in enumerate(self.mesh.groups):
            some = None if self.parts is None else self.parts[i]
            if self.parts is None or some is not None:
                yield group, some


def ids_program(normal: bool, group: Group, parted: bool) -> Interface:
    """Returns the program that draws a group of triangles, or some of its parts, into the visibility buffer.

    `normal`: something is lit, and normals tell surfaces apart.
    """
    alpha = tuple(name for name in group.defines if name in ("PS_UV", "PS_BAKED_ALPHA", "PS_CORNER_ALPHA"))
    names = [name for name in alpha if name != "PS_UV" or "PS_BAKED_ALPHA" in alpha]
    if "PS_CORNER_ALPHA" in names:
        names.append("PS_CORNER_COLOR")
    own: Fields = (("int", "mirrored"),) if group.cull else ()
    own += () if parted else (("int", "first"),)  # corner of the group
    samplers, varyings = ["ps_corner"], [("smooth", "vec3", "v_position"), ("flat", "uint", "v_triangle")]
    if normal:
        varyings.append(("smooth", "vec3", "v_normal"))
    if "PS_UV" in names:
        samplers += ["ps_corner_uv", "ps_baked_color"]
        varyings.append(("smooth", "vec2", "v_uv"))
    if "PS_CORNER_COLOR" in names:
        samplers.append("ps_corner_color")
        varyings.append(("smooth", "vec4", "v_color"))
    more = (("PS_CULL", group.cull), ("PS_NORMAL", normal))
    return Interface(
        "polygons",
        vertex="visibility/polygon.vert",
        fragment="visibility/polygon_ids.frag",
        block=block("PolygonIds", CAMERA_FIELDS, LATTICE_FIELDS, OWN, own),
        samplers=tuple(("FLOAT_2D", name) for name in (*samplers, *(("ps_parts",) if parted else ()))),
        varyings=tuple(varyings),
        outputs=OUTPUTS,
        defines=(
            LATTICE_DEFINE,
            *((name, "1") for name in names),
            *((name, "1") for name, on in more if on),
            *((CORNERS_OF_PART,) if parted else ()),
        ),
        depth=True,
    )


def surface_program(variant: Variant, lattice: Lattice, group: Group) -> Interface:
    """Returns the program that writes the attributes of triangles that stand for groups of sub-samples."""
    names = [name for name in needed_defines(variant, group) if not name.endswith("ALPHA")]
    samplers = ["ps_corner", *(("ps_corner_uv",) if "PS_UV" in names else ())]
    samplers += [name for name in CORNERS if name.upper() in names]
    samplers += [name for name in group.textures if name.upper() in names]
    kinds = {"COLOR": variant.color, "SURFACE": variant.surface, "EMISSION": variant.emission}
    if any(on and not {f"PS_BAKED_{kind}", f"PS_CORNER_{kind}"} & set(names) for kind, on in kinds.items()):
        samplers.append("ps_materials")
    own: Fields = (("int", "holdout"), ("int", "first_triangle"), ("int", "triangles"))
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="visibility/polygon_surface.frag",
        block=block("PolygonSurface", CAMERA_FIELDS, RECTANGLE_FIELDS, OWN, own),
        samplers=(*(("FLOAT_2D", name) for name in samplers), *LEADER_SAMPLERS),
        outputs=variant.outputs(),
        defines=(
            *((name, "1") for name in (*variant.defines, *names)),
            *sub_sample_defines(lattice),
        ),
    )


def draw_ids(
    device: Device,
    normal: bool,
    draws: list[PolygonDraw],
    view: SampleView,
    shared: dict[str, Texture],
    out: VisibilityBuffer,
) -> None:
    """Draws polygons into the visibility buffer."""
    for draw in draws:
        for group, some in draw.groups():
            program = ids_program(normal, group, some is not None)
            textures = {**shared, **draw.mesh.textures, **group.textures}
            if some is not None:
                textures["ps_parts"] = some.texture
            device.draw(
                program,
                out.target,
                uniforms=view.record_of(
                    program.block,
                    view_from_object=draw.view_from_object,
                    material=group.material,
                    instance=draw.instance,
                    first_id=draw.first_id,
                    mirrored=draw.mirrored,
                    first=group.first,
                    **out.values,
                ),
                textures=textures,
                vertices=group.count if some is None else some.corners,
                depth_test=True,
            )


def draw_attributes(
    device: Device,
    variant: Variant,
    draws: list[PolygonDraw],
    view: SampleView,
    shared: dict[str, Texture],
    groups: Groups,
    lattice: Lattice,
    out: GBuffer,
) -> None:
    """Writes the attributes of the triangles that stand for one layer of groups."""
    for draw in draws:
        for group, _ in draw.groups():
            program = surface_program(variant, lattice, group)
            device.draw(
                program,
                out.target,
                uniforms=view.record_of(
                    program.block,
                    view_from_object=draw.view_from_object,
                    material=group.material,
                    instance=draw.instance,
                    first_id=draw.first_id,
                    holdout=draw.holdout,
                    first_triangle=group.first // 3,
                    triangles=group.count // 3,
                    rectangle=draw.rectangle,
                ),
                textures={**shared, **draw.mesh.textures, **group.textures, **groups.leaders},
                vertices=6,
            )
