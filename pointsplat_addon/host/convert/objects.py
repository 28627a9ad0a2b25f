"""The dependency graph's instances as a table: what is drawn where, and for each distinct object what it refers to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import bpy
import numpy as np

from ...core.scene.volume import Transfer
from .curves import Hair, hair_systems, is_tube
from .particles import read_particles
from .pointcloud import Points
from .volume import Voxels, convert_transfer, read_domain

GEOMETRY = ("MESH", "POINTCLOUD", "VOLUME", "CURVES")
# Blender lists the surfaces of CURVE, SURFACE, FONT and META objects as instances of type MESH. Tubes along curves are
# made of the curves, and then those surfaces are left out.
UNSUPPORTED = {
    "GREASEPENCIL": "Grease Pencil",
    "GPENCIL": "Grease Pencil",
}


@dataclass(eq=False)
class Source:
    """One distinct pair of object and data."""

    name: str
    owner: int  # session_uid of the original object
    data: bpy.types.Mesh | bpy.types.PointCloud | bpy.types.Volume | bpy.types.Curves | bpy.types.Curve
    materials: tuple[bpy.types.Material | None, ...]  # one for each slot, at least one
    primitive: str
    spacing: float
    extinction: float
    radius: float  # of points, in object units; 0 takes their attribute, else a default
    pass_index: int
    holdout: bool
    casts: bool  # shadows
    generated: bool  # is_instance: the data may belong to the instancer
    editing: bpy.types.Object | None = None  # the object, where its mesh is in edit mode
    transfer: Transfer | None = None  # of volumes
    smoke: Voxels | None = None  # instead of the data: what a fluid domain holds
    particles: Points | None = None  # instead of the data, in world space
    hair: Hair | None = None  # instead of the data, in the object's space
    ribbons: bool = False  # strands have normals

    @property
    def strands(self) -> bool:
        """Whether it becomes lines."""
        return self.hair is not None or isinstance(self.data, bpy.types.Curves | bpy.types.Curve)


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
    flags: dict[int, Flags] = {}
    known: dict[tuple, range] = {}  # to rows of sources: what is drawn of an object itself, and its particles
    sources: list[Source] = []
    rows: list[int] = []
    picked: list[int] = []
    free: list[int] = []  # of rows: those in world space
    identity: list[tuple] = []
    unsupported: dict[str, list[str]] = {}
    tubes: set[int] = set()  # session_uids of curve objects that are drawn as such
    count = 0
    for row, instance in enumerate(depsgraph.object_instances):
        count = row + 1
        # The instance and, where it is generated, its object live only until the next step.
        ob = instance.object
        uid, tube = ob.original.session_uid, ob.type == "CURVE" and is_tube(ob)
        if tube:
            tubes.add(uid)
        elif ob.type == "MESH" and uid in tubes:
            continue
        if ob.type not in GEOMETRY and not tube:
            if ob.type in UNSUPPORTED and instance.show_self:
                unsupported.setdefault(UNSUPPORTED[ob.type], []).append(ob.name)
            continue
        parent = instance.parent if instance.is_instance else ob
        key = uid, ob.data.session_uid, parent.original.session_uid, instance.is_instance
        found = known.get(key)
        if found is None:
            first = len(sources)
            visible = _visibility(ob, parent, view_layer, flags)
            if visible.catcher:
                unsupported.setdefault("Shadow catchers", []).append(ob.name)
            elif visible.drawn and (view3d is None or ob.visible_in_viewport_get(view3d)):
                source = _source(ob, view_layer.material_override, visible, instance.is_instance)
                sources += [source] if instance.show_self else []
                if len(ob.particle_systems) and instance.show_particles:
                    # Hair is read when the step is over
                    emitter = ob.original.evaluated_get(depsgraph) if instance.is_instance else ob
                    sources += _particles(source, emitter, view_layer.material_override, depsgraph.mode == "RENDER")
            found = known[key] = range(first, len(sources))
        for source in found:
            if sources[source].particles:
                free.append(len(rows))
            picked.append(row)
            rows.append(source)
            if identify:
                persistent = tuple(instance.persistent_id) if instance.is_instance else ()
                identity.append((key[0], key[2], persistent, source - found.start))
    matrices = np.empty(count * 16, np.float32)
    depsgraph.object_instances.foreach_get("matrix_world", matrices)
    # Blender stores columns one after another.
    world_from_object = matrices.reshape(-1, 4, 4)[picked].transpose(0, 2, 1).astype(np.float64)
    world_from_object[free] = np.eye(4)
    return Collected(sources, np.array(rows, np.int32), world_from_object, identity, unsupported)


def _source(ob: bpy.types.Object, override: bpy.types.Material | None, visible: Flags, generated: bool) -> Source:
    materials = tuple(override or slot.material for slot in ob.material_slots)
    return Source(
        name=ob.name,
        owner=ob.original.session_uid,
        data=ob.data,  # pyright: ignore[reportArgumentType]
        materials=materials or (override,),
        primitive="AUTO" if ob.pointsplat.primitive == "LINES" else ob.pointsplat.primitive,
        spacing=ob.pointsplat.spacing,
        extinction=ob.pointsplat.extinction,
        radius=ob.pointsplat.radius,
        pass_index=ob.pass_index,
        holdout=visible.holdout,
        casts=visible.casts,
        generated=generated,
        editing=ob if ob.type == "MESH" and ob.data.is_editmode else None,
        transfer=convert_transfer(ob) if ob.type == "VOLUME" else None,
        smoke=read_domain(ob) if ob.type == "MESH" else None,
        ribbons=ob.type == "CURVES" and ob.pointsplat.ribbons,
    )


def _particles(emitter: Source, ob: bpy.types.Object, override: bpy.types.Material | None, final: bool) -> list[Source]:
    # Particles are in world space, where instances have none of their own
    found = [
        replace(emitter, materials=(override or material,), editing=None, particles=points)
        for points, material in ([] if emitter.generated else read_particles(ob, final))
    ]
    # Without any slot there is no material, whatever the settings say
    slots = emitter.materials
    return found + [
        replace(emitter, materials=(slots[max(hair.material, 0)],), editing=None, smoke=None, hair=hair)
        for hair in hair_systems(ob, final)
    ]


class Flags(NamedTuple):
    drawn: bool
    holdout: bool
    casts: bool  # shadows
    catcher: bool  # of shadows: what it would show is only known with and without the shadows, so it is left out


def _visibility(
    ob: bpy.types.Object, parent: bpy.types.Object, view_layer: bpy.types.ViewLayer, flags: dict[int, Flags]
) -> Flags:
    """As in Cycles, the instancer decides on holdout, and both on what the camera sees and what casts shadows."""
    uid = parent.original.session_uid
    if uid not in flags:
        drawn = parent.visible_camera and not parent.indirect_only_get(view_layer=view_layer)
        holdout = parent.holdout_get(view_layer=view_layer)
        flags[uid] = Flags(drawn, holdout, parent.visible_shadow, parent.is_shadow_catcher)
    drawn, holdout, casts, catcher = flags[uid]
    return Flags(drawn and ob.visible_camera, holdout, casts and ob.visible_shadow, catcher or ob.is_shadow_catcher)
