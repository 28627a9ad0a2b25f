"""Draws polygons into the G-buffer, one draw for each material of each instance."""

from __future__ import annotations

import numpy as np

from ....core.surface.density import PART
from ....shading.interface import Block, Interface
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..shading.lighting import SAMPLE_FIELDS
from ..uniforms import CAMERA_FIELDS, FOOTPRINT_FIELDS, Fields, SampleView, block
from .pictures import define_entries, level_defines, level_samplers
from .polygon_mesh import CORNERS, Group, PartList, PolygonMesh

PATCH_VARYING = ("flat", "float", "v_patch")  # area of a triangle in UV: see lib/data/levels.glsl
CUT_VARYING = ("flat", "vec4", "v_cut")  # see lib/visibility/cut.glsl


def _block(variant: Variant, group: Group, parted: bool, levels: bool) -> Block:
    """The uniforms of the program that draws a group, or some of its parts."""
    own: Fields = (
        ("mat4", "view_from_object"),
        ("int", "material"),
        ("int", "holdout"),  # 0 or 1
    )
    mirrored: Fields = (("int", "mirrored"),)  # 1 where the transform turns triangles over
    first: Fields = (("int", "first"),)  # corner of the group
    instance: Fields = (("int", "instance"),)
    cut = is_cut(group)
    further = (
        (mirrored, group.cull),
        (first, not parted),
        (instance, variant.owner or cut),
        (SAMPLE_FIELDS, cut),
        (FOOTPRINT_FIELDS, levels),
    )
    return block("Polygons", CAMERA_FIELDS, own, *(fields for fields, on in further if on))


def is_cut(group: Group) -> bool:
    """Whether the group's triangles have an alpha."""
    return any(name.endswith("ALPHA") for name in group.defines)


def needed_defines(variant: Variant, group: Group) -> tuple[str, ...]:
    """Returns the defines of a group's shader in a G-buffer of this variant."""
    held = {"PS_BAKED_NORMAL": variant.normal, "PS_BAKED_HEIGHT": variant.normal}
    for kind, on in (("COLOR", variant.color), ("SURFACE", variant.surface), ("EMISSION", variant.emission)):
        held |= {f"PS_{way}_{kind}": on for way in ("BAKED", "CORNER", "ENCODED", "ASSOCIATED")}
    # Alpha is a colour's.
    held["PS_BAKED_COLOR"] |= "PS_BAKED_ALPHA" in group.defines
    held["PS_CORNER_COLOR"] |= "PS_CORNER_ALPHA" in group.defines
    names = [name for name in group.defines if held.get(name, True)]
    pictures = any(name.startswith("PS_BAKED") for name in names)
    return tuple(name for name in names if pictures or not name.startswith(("PS_UV", "PS_PICTURE")))


def program(variant: Variant, group: Group, parted: bool = False) -> Interface:
    """Returns the program that draws a group, or some of its parts."""
    names = needed_defines(variant, group)
    samplers = [("FLOAT_2D", "ps_corner")]
    varyings = [("smooth", "vec3", "v_position")]
    if variant.normal:
        varyings.append(("smooth", "vec3", "v_normal"))
    if "PS_UV" in names:
        samplers.append(("FLOAT_2D", "ps_corner_uv"))
        varyings.append(("smooth", "vec2", "v_uv"))
    for sampler, (glsl, varying) in CORNERS.items():
        if sampler.upper() in names:
            samplers.append(("FLOAT_2D", sampler))
            varyings.append(("smooth", glsl, varying))
    samplers += [("FLOAT_2D", name) for name in group.textures if name.upper() in names]
    levels = level_samplers(group.textures, names)
    samplers += [("FLOAT_2D", name) for name in levels]
    varyings += [PATCH_VARYING] if levels else []
    kinds = {"COLOR": variant.color, "SURFACE": variant.surface, "EMISSION": variant.emission}
    if any(on and not {f"PS_BAKED_{kind}", f"PS_CORNER_{kind}"} & set(names) for kind, on in kinds.items()):
        samplers.append(("FLOAT_2D", "ps_materials"))
    if parted:
        samplers.append(("FLOAT_2D", "ps_parts"))
    cut: tuple[tuple[str, str], ...] = ()
    if is_cut(group):
        varyings.append(CUT_VARYING)
        cut = ("PS_CUT", "1"), ("PS_RANKS", "1")
    more = ((("PS_CULL", "1"),) if group.cull else ()) + ((("PS_PARTS", str(3 * PART)),) if parted else ())
    return Interface(
        "polygons",
        vertex="visibility/polygon.vert",
        fragment="visibility/polygon.frag",
        block=_block(variant, group, parted, bool(levels)),
        samplers=tuple(samplers),
        varyings=tuple(varyings),
        outputs=variant.front_outputs,
        defines=(*variant.front_defines, *define_entries([*names, *level_defines(levels, group.defines)]), *more, *cut),
        depth=True,
    )


def draw(
    device: Device,
    variant: Variant,
    mesh: PolygonMesh,
    view_from_object: np.ndarray,
    instance: int,
    holdout: bool,
    view: SampleView,
    shared: dict[str, Texture],
    out: GBuffer,
    parts: list[PartList | None] | None = None,
) -> None:
    """Draws one instance of a mesh into the G-buffer. `parts`: lists of the parts of each group; None draws all."""
    matrix = view_from_object.copy()
    matrix[:3, 3] += matrix[:3, :3] @ mesh.origin
    mirrored = bool(np.linalg.det(matrix[:3, :3]) < 0)
    for i, group in enumerate(mesh.groups):
        some = None if parts is None else parts[i]
        if parts is not None and some is None:
            continue
        textures = {**shared, **mesh.textures, **group.textures}
        if some is not None:
            textures["ps_parts"] = some.texture
        drawn = program(variant, group, some is not None)
        device.draw(
            drawn,
            out.target,
            uniforms=view.record_of(
                drawn.block,
                view_from_object=matrix,
                mirrored=mirrored,
                first=group.first,
                material=group.material,
                holdout=holdout,
                instance=instance,
            ),
            textures=textures,
            vertices=group.count if some is None else 3 * PART * some.count,
            depth_test=True,
        )
