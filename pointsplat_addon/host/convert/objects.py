"""The dependency graph's instances as a table: what is drawn where, and for each distinct object what it refers to."""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

GEOMETRY = ("MESH", "POINTCLOUD")
# Blender lists the surfaces of CURVE, SURFACE, FONT and META objects as instances of type MESH.
UNSUPPORTED = {
    "CURVES": "hair curves",
    "VOLUME": "volumes",
    "GREASEPENCIL": "Grease Pencil",
    "GPENCIL": "Grease Pencil",
}


@dataclass(eq=False)
class Source:
    """One distinct pair of object and data."""

    name: str
    owner: int  # session_uid of the original object
    data: bpy.types.Mesh | bpy.types.PointCloud
    materials: tuple[bpy.types.Material | None, ...]  # one for each slot, at least one
    primitive: str
    spacing: float
    pass_index: int
    holdout: bool
    generated: bool  # is_instance: the data may belong to the instancer
    editing: bpy.types.Object | None = None  # the object, where its mesh is in edit mode


@dataclass(eq=False)
class Collected:
    sources: list[Source]
    source: np.ndarray  # (I,) int32, rows of sources
    world_from_object: np.ndarray  # (I, 4, 4) float64
    identity: list[tuple]  # what stays the same from frame to frame, for motion; empty where not asked for
    unsupported: dict[str, list[str]] = field(default_factory=dict)  # kind to names of objects


def collect(
    depsgraph: bpy.types.Depsgraph, view3d: bpy.types.SpaceView3D | None = None, *, identify: bool = False
) -> Collected:
    """All that the camera can see. view3d: the viewport, whose local view and filters hold."""
    view_layer = depsgraph.view_layer_eval
    flags: dict[int, tuple[bool, bool]] = {}
    known: dict[tuple, int] = {}  # to a row of sources; -1: not drawn
    sources: list[Source] = []
    rows: list[int] = []
    picked: list[int] = []
    identity: list[tuple] = []
    unsupported: dict[str, list[str]] = {}
    count = 0
    for row, instance in enumerate(depsgraph.object_instances):
        count = row + 1
        # The instance and, where it is generated, its object live only until the next step.
        ob = instance.object
        if ob.type not in GEOMETRY:
            if ob.type in UNSUPPORTED and instance.show_self:
                unsupported.setdefault(UNSUPPORTED[ob.type], []).append(ob.name)
            continue
        parent = instance.parent if instance.is_instance else ob
        key = ob.original.session_uid, ob.data.session_uid, parent.original.session_uid, instance.is_instance
        source = known.get(key)
        if source is None:
            source = known[key] = len(sources)
            drawn, holdout = _visibility(ob, parent, view_layer, flags)
            if drawn and instance.show_self and (view3d is None or ob.visible_in_viewport_get(view3d)):
                sources.append(_source(ob, view_layer.material_override, holdout, instance.is_instance))
            else:
                source = known[key] = -1
        if source < 0:
            continue
        picked.append(row)
        rows.append(source)
        if identify:
            persistent = tuple(instance.persistent_id) if instance.is_instance else ()
            identity.append((key[0], key[2], persistent))
    matrices = np.empty(count * 16, np.float32)
    depsgraph.object_instances.foreach_get("matrix_world", matrices)
    # Blender stores columns one after another.
    world_from_object = matrices.reshape(-1, 4, 4)[picked].transpose(0, 2, 1).astype(np.float64)
    return Collected(sources, np.array(rows, np.int32), world_from_object, identity, unsupported)


def _source(ob: bpy.types.Object, override: bpy.types.Material | None, holdout: bool, generated: bool) -> Source:
    materials = tuple(override or slot.material for slot in ob.material_slots)
    return Source(
        name=ob.name,
        owner=ob.original.session_uid,
        data=ob.data,  # pyright: ignore[reportArgumentType]
        materials=materials or (override,),
        primitive=ob.pointsplat.primitive,
        spacing=ob.pointsplat.spacing,
        pass_index=ob.pass_index,
        holdout=holdout,
        generated=generated,
        editing=ob if ob.type == "MESH" and ob.data.is_editmode else None,
    )


def _visibility(
    ob: bpy.types.Object, parent: bpy.types.Object, view_layer: bpy.types.ViewLayer, flags: dict[int, tuple[bool, bool]]
) -> tuple[bool, bool]:
    """(drawn, holdout). As in Cycles, the instancer decides on holdout, and both on what the camera sees."""
    uid = parent.original.session_uid
    if uid not in flags:
        drawn = parent.visible_camera and not parent.indirect_only_get(view_layer=view_layer)
        # A shadow catcher shows nothing but shadows: without them it is a hole.
        flags[uid] = drawn, parent.holdout_get(view_layer=view_layer) or parent.is_shadow_catcher
    drawn, holdout = flags[uid]
    return drawn and ob.visible_camera, holdout or ob.is_shadow_catcher
