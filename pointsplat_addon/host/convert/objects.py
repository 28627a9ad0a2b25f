"""The dependency graph's instances as a table: the sources that are drawn, and the transforms of their instances."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from ...core.material.nodes.procedural.hashes import name_number
from ...core.scene.volume import Transfer
from .captured import ANTIALIASED
from .material.filled import axis_lengths, filling_material, has_surface
from .material.nodes.tree import Placement
from .pages import LinkedScan
from .particles import read_particles
from .point_shapes import PointShape, pixel_radius_of, shape_of
from .pointcloud import Points
from .selection.clip_boxes import Boxes, Clip, boxes_of
from .selection.filters import Filters, filters_of
from .strands.bevels import has_round_bevel
from .strands.particle_hair import ParticleHair, hair_systems
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
    """A distinct pair of object and data, or one of the object's particle systems, with the settings that apply."""

    name: str
    owner: int  # session_uid of the original object
    data: bpy.types.Mesh | bpy.types.PointCloud | bpy.types.Volume | bpy.types.Curves | bpy.types.Curve
    materials: tuple[bpy.types.Material | None, ...]  # one for each slot, at least one
    primitive: str
    spacing: float
    extinction: float
    shape: PointShape  # of points
    pixel_radius: float  # of points
    pass_index: int
    holdout: bool
    casts: bool  # whether it casts shadows
    seen: bool  # whether cameras see it
    scatters: bool  # whether diffuse light sees it
    mirrored: bool  # whether mirrors show it
    matte: bool  # whether it is a shadow catcher
    generated: bool  # whether an instancer made it: its data may belong to the instancer
    editing: bpy.types.Object | None = None  # the object, if its mesh is in edit mode
    transfer: Transfer | None = None  # of volumes
    smoke: Voxels | None = None  # instead of the data: the voxels of a fluid domain
    particles: Points | None = None  # instead of the data, in world space
    hair: ParticleHair | None = None  # instead of the data, in the object's space
    ribbons: bool = False  # strands have normals
    filters: Filters | None = None  # of points
    clip: Clip | None = None  # of points
    lighting: str = "CAPTURED"  # of captured splats
    antialiased: bool = False  # of these
    scan: LinkedScan | None = None  # the file that the points stand for
    # Instead of the surface of a mesh, what fills it: lengths of the object's axes in world space; () else
    filled: tuple[float, ...] = ()
    color: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)  # of the object in viewports, which materials may read
    instancer: int = 0  # session_uid of the original object that made it; the owner's, if none did
    values: dict[str, np.ndarray] = field(default_factory=dict)  # (C,) of its first instance, which materials read
    motion: float = 0.0  # of points: seconds of a frame, where a pass asks how they move

    @property
    def numbered(self) -> bool:
        """Whether Blender chose its random number, which is not the hash of its name: that of what an instancer made,
        as which the surface of a curve counts."""
        return self.generated or isinstance(self.data, bpy.types.Curve)

    @property
    def strands(self) -> bool:
        """Whether the source becomes strands."""
        return self.hair is not None or isinstance(self.data, bpy.types.Curves | bpy.types.Curve)


@dataclass(eq=False)
class Collected:
    """The S distinct sources of a scene and their I instances."""

    sources: list[Source]
    source: np.ndarray  # (I,) int32, indices into sources
    world_from_object: np.ndarray  # (I, 4, 4) float64
    number: np.ndarray  # (I,) int64, of instances in the dependency graph
    identity: list[tuple]  # of instances, persistent from frame to frame, for motion; empty unless asked for
    unsupported: dict[str, list[str]] = field(default_factory=dict)  # kind of object to names

    def placement(self, material: bpy.types.Material) -> Placement | None:
        """Returns where a material is shown; None if that is nowhere, in several places, or by several objects."""
        found = [i for i, source in enumerate(self.sources) if material in source.materials]
        matrices = self.world_from_object[np.isin(self.source, found)]
        owners = {self.sources[i].owner for i in found}
        if len(matrices) == 0 or len(owners) > 1 or (matrices != matrices[0]).any():
            return None
        owner = next(iter(owners))
        ob = next((ob for ob in bpy.data.objects if ob.session_uid == owner), None)
        if ob is None:
            return None
        rows = tuple(tuple(map(float, row)) for row in matrices[0][:3])
        random = None if self.sources[found[0]].numbered else name_number(ob.name)
        return Placement(rows, tuple(ob.color), ob.pass_index, random)


def collect(
    depsgraph: bpy.types.Depsgraph, view3d: bpy.types.SpaceView3D | None = None, *, identify: bool = False
) -> Collected:
    """Returns all sources and instances that are visible to camera rays, in or out of the picture.

    view3d: the viewport whose local view and filters apply. identify: whether instances get a key that is the same in
    every frame, for motion vectors. Objects that cannot be drawn are listed by kind in `unsupported`.
    """
    view_layer = depsgraph.view_layer_eval
    flags: dict[int, Flags] = {}
    known: dict[tuple, range] = {}  # to indices of sources: of an object itself, and of its particle systems
    sources: list[Source] = []
    rows: list[int] = []
    instances: list[int] = []  # indices into the dependency graph's instances
    in_world_space: list[int] = []  # indices into rows
    identity: list[tuple] = []
    unsupported: dict[str, list[str]] = {}
    boxes: dict[int, Boxes | None] = {}  # of point clouds, by session_uid
    media: dict[int, bpy.types.Material | None] = {}  # materials that fill meshes, by session_uid
    render = depsgraph.scene_eval.render
    motion = render.fps_base / render.fps if identify else 0.0
    tubes: dict[int, int] = {}  # session_uids of curve objects that are drawn as tubes, to the last instance's index
    count = 0
    for row, instance in enumerate(depsgraph.object_instances):
        count = row + 1
        # The instance and, where it is generated, its object live only until the next step.
        ob = instance.object
        uid, tube = ob.original.session_uid, ob.type == "CURVE" and has_round_bevel(ob)
        if tube:
            tubes[uid] = -1
        elif ob.type == "MESH" and uid in tubes:
            if tubes[uid] >= 0:
                instances[tubes[uid]] = row  # which has the random number of what Cycles draws
            continue
        if ob.type not in GEOMETRY and not tube:
            if ob.type in UNSUPPORTED and instance.show_self:
                unsupported.setdefault(UNSUPPORTED[ob.type], []).append(ob.name)
            continue
        parent = instance.parent if instance.is_instance else ob
        key = uid, ob.data.session_uid, parent.original.session_uid, instance.is_instance
        clip, scale = None, ()
        if ob.type == "MESH":
            if uid not in media:
                media[uid] = filling_material(_materials(ob, view_layer.material_override))
            if media[uid] is not None:
                scale = axis_lengths(np.array(instance.matrix_world, np.float64))
                key = (*key, scale)
        if ob.type == "POINTCLOUD":
            if uid not in boxes:
                boxes[uid] = boxes_of(ob, depsgraph)
            if (own := boxes[uid]) is not None:
                clip = own.of_instance(np.array(instance.matrix_world, np.float64))
                key = (*key, clip)  # boxes cut each instance elsewhere
        found = known.get(key)
        if found is None:
            first = len(sources)
            visible = _visibility(ob, parent, view_layer, flags)
            if visible.catcher and ob.type != "MESH":
                unsupported.setdefault("Shadow catchers without polygons", []).append(ob.name)
            elif (visible.drawn or visible.casts) and (view3d is None or ob.visible_in_viewport_get(view3d)):
                source = _make_source(ob, parent, view_layer.material_override, visible, instance.is_instance, clip)
                source.motion = motion
                own = [source]
                if scale and source.smoke is None and not source.matte and (medium := media[uid]) is not None:
                    own = _with_filling(source, medium, scale)
                sources += own if instance.show_self else []
                if len(ob.particle_systems) and instance.show_particles:
                    # Hair is read later, when the instance and its object no longer live
                    emitter = ob.original.evaluated_get(depsgraph) if instance.is_instance else ob
                    sources += _particles(source, emitter, view_layer.material_override, depsgraph.mode == "RENDER")
            found = known[key] = range(first, len(sources))
        for source in found:
            if sources[source].particles:
                in_world_space.append(len(rows))
            instances.append(row)
            rows.append(source)
            if tube:
                tubes[uid] = len(rows) - 1
            if identify:
                persistent = tuple(instance.persistent_id) if instance.is_instance else ()
                identity.append((key[0], key[2], persistent, source - found.start))
    matrices = np.empty(count * 16, np.float32)
    depsgraph.object_instances.foreach_get("matrix_world", matrices)
    # Blender stores columns one after another.
    world_from_object = matrices.reshape(-1, 4, 4)[instances].transpose(0, 2, 1).astype(np.float64)
    world_from_object[in_world_space] = np.eye(4)
    return Collected(
        sources, np.array(rows, np.int32), world_from_object, np.array(instances, np.int64), identity, unsupported
    )


def _make_source(
    ob: bpy.types.Object,
    parent: bpy.types.Object,
    override: bpy.types.Material | None,
    visible: Flags,
    generated: bool,
    clip: Clip | None,
) -> Source:
    matte = visible.catcher
    materials = _materials(ob, override)
    primitive = "POLYGONS" if matte else ob.pointsplat.primitive
    return Source(
        name=ob.name,
        owner=ob.original.session_uid,
        data=ob.data,  # pyright: ignore[reportArgumentType]
        materials=materials or (override,),
        primitive="AUTO" if primitive == "LINES" else primitive,
        matte=matte,
        spacing=ob.pointsplat.spacing,
        extinction=ob.pointsplat.extinction,
        shape=shape_of(ob),
        pixel_radius=pixel_radius_of(ob),
        pass_index=ob.pass_index,
        holdout=visible.holdout,
        casts=visible.casts,
        seen=visible.drawn,
        scatters=visible.scatters,
        mirrored=visible.mirrored,
        generated=generated,
        editing=ob if ob.type == "MESH" and ob.data.is_editmode else None,
        transfer=convert_transfer(ob) if ob.type == "VOLUME" else None,
        smoke=read_domain(ob) if ob.type == "MESH" else None,
        ribbons=ob.type == "CURVES" and ob.pointsplat.ribbons,
        filters=filters_of(ob),
        color=tuple(ob.color),
        instancer=parent.original.session_uid,
        lighting=ob.pointsplat.lighting if ob.type == "POINTCLOUD" else "CAPTURED",
        antialiased=ob.type == "POINTCLOUD" and bool(ob.original.get(ANTIALIASED, False)),
        clip=clip,
        scan=linked_scan(ob),
    )


def _with_filling(source: Source, material: bpy.types.Material, scale: tuple[float, ...]) -> list[Source]:
    """Returns the source of a mesh, if it has a surface, and that of what fills it.

    scale: `axis_lengths` of the instance. Densities are those of world space: instances of other sizes are filled by
    other voxels.
    """
    filled = replace(source, materials=(material, *source.materials), filled=scale, primitive="AUTO")
    return [source, filled] if has_surface(source.materials) else [filled]


def _materials(ob: bpy.types.Object, override: bpy.types.Material | None) -> tuple[bpy.types.Material | None, ...]:
    return tuple(override or slot.material for slot in ob.material_slots)


def linked_scan(ob: bpy.types.Object) -> LinkedScan | None:
    """Returns the file of a scan that an object stands for; None: it is what it is."""
    original = ob.original
    if ob.type != "POINTCLOUD" or not original.pointsplat.scan_path:
        return None
    return LinkedScan(Path(bpy.path.abspath(original.pointsplat.scan_path, library=original.library)))


def _particles(emitter: Source, ob: bpy.types.Object, override: bpy.types.Material | None, final: bool) -> list[Source]:
    """Sources of an object's particle systems, points and hair."""
    # Particles are in world space: instances of their emitter have no particles of their own
    found = [
        replace(emitter, materials=(override or material,), editing=None, matte=False, particles=points)
        for points, material in ([] if emitter.generated else read_particles(ob, final))
    ]
    # Without any slot there is no material, whatever the settings say
    slots = emitter.materials
    return found + [
        replace(emitter, materials=(slots[max(hair.material, 0)],), editing=None, smoke=None, matte=False, hair=hair)
        for hair in hair_systems(ob, final)
    ]


class Flags(NamedTuple):
    """Visibility of an instance, one bool each: to the camera, as holdout, to shadow rays, to diffuse rays, to glossy
    rays, as shadow catcher."""

    drawn: bool
    holdout: bool
    casts: bool  # whether it casts shadows
    scatters: bool  # whether diffuse light sees it
    mirrored: bool  # whether mirrors show it
    catcher: bool  # whether it is a shadow catcher


def _visibility(
    ob: bpy.types.Object, parent: bpy.types.Object, view_layer: bpy.types.ViewLayer, flags: dict[int, Flags]
) -> Flags:
    """The flags of an instance: as in Cycles, `parent`, the instancer, decides on holdout, and both on the others."""
    uid = parent.original.session_uid
    if uid not in flags:
        drawn = parent.visible_camera and not parent.indirect_only_get(view_layer=view_layer)
        holdout = parent.holdout_get(view_layer=view_layer)
        rays = parent.visible_shadow, parent.visible_diffuse, parent.visible_glossy
        flags[uid] = Flags(drawn, holdout, *rays, parent.is_shadow_catcher)
    of = flags[uid]
    casts, scatters = of.casts and ob.visible_shadow, of.scatters and ob.visible_diffuse
    return Flags(
        of.drawn and ob.visible_camera,
        of.holdout,
        casts,
        scatters,
        of.mirrored and ob.visible_glossy,
        of.catcher or ob.is_shadow_catcher,
    )
