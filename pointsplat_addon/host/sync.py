"""A dependency graph to a core.scene.Scene: changed objects only."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import bpy
import numpy as np

from ..core.material.graph import MaterialGraph, needs
from ..core.numeric.cryptomatte import cryptomatte_hash
from ..core.scene import materials as materials_module
from ..core.scene import mesh as mesh_module
from ..core.scene import scene
from ..core.scene import volume as volume_module
from ..core.scene import world as world_module
from ..core.scene.cloud import PointCloud
from .convert import curves
from .convert.lights import convert_lights
from .convert.material.materials import convert_materials
from .convert.mesh import is_scattered, read_mesh
from .convert.objects import Collected, Source, collect
from .convert.pointcloud import CloudMaterial, cloud_material, read_pointcloud, splats
from .convert.volume import Voxels, convert_volume, digest, read_voxels, source_key, wanted_grids
from .convert.world import convert_world

MAX_NAMED = 3  # objects that a warning names before it counts the rest
SHADING = (bpy.types.Material, bpy.types.ShaderNodeTree, bpy.types.Image)

hash_of_name = lru_cache(maxsize=65536)(cryptomatte_hash)


class Cache:
    """Geometry by content key, shared by final renders and viewports; it lives as long as any scene holds it."""

    def __init__(self) -> None:
        self._geometry: weakref.WeakValueDictionary[str, Any] = weakref.WeakValueDictionary()
        self._rows: dict[int, int] = {}
        self._lock = threading.Lock()

    def lookup(self, key: str, make: Callable[[], Any]) -> Any:
        """What has that content key. Made outside the lock: two threads may both make it, and one is kept."""
        with self._lock:
            known = self._geometry.get(key)
        if known is not None:
            return known
        made = make()
        with self._lock:
            return self._geometry.setdefault(key, made)

    def row(self, material: bpy.types.Material | None) -> int:
        """The material's row in every scene's table; it stays, so that the content keys of meshes stay too."""
        if material is None:
            return 0
        with self._lock:
            return self._rows.setdefault(material.original.session_uid, len(self._rows) + 1)

    def rows(self) -> int:
        """How many rows have been given, the default material's included."""
        return len(self._rows) + 1

    def clear(self) -> None:
        """Forget everything, for instance when a file is loaded."""
        with self._lock:
            self._geometry.clear()
            self._rows.clear()


CACHE = Cache()


class Known(NamedTuple):
    geometry: scene.Geometry | None  # None: nothing to draw
    owners: frozenset[int]  # session_uids of the objects that use it, and of the data
    generated: bool  # made by an instancer, whose changes do not name it
    voxels: Voxels | None = None
    warnings: tuple[str, ...] = ()
    lines: curves.Converted | None = None


class Synchronizer:
    """Converts the successive states of one dependency graph and remembers the last."""

    def __init__(self, cache: Cache = CACHE) -> None:
        self.cache = cache
        self._known: dict[tuple, Known] = {}
        # So that another transfer function finds voxels, and strands that are looked at again are not evaluated again
        self._held: tuple[Voxels | curves.Converted | None, ...] = ()
        self._materials: materials_module.MaterialTable | None = None
        self._material_warnings: tuple[str, ...] = ()
        self._used: tuple[int, ...] = ()  # rows of the materials in use
        self._depsgraph = 0

    def scene(
        self,
        depsgraph: bpy.types.Depsgraph,
        view3d: bpy.types.SpaceView3D | None = None,
        previous: dict[tuple, np.ndarray] | None = None,
    ) -> scene.Scene:
        """The scene as it is now; where the dependency graph names no changes, everything is looked at again.

        view3d: the viewport, whose local view holds. previous: world_from_object a frame before by
        `Collected.identity`, for the Vector pass.
        """
        self._forget_changed(depsgraph)
        collected = collect(depsgraph, view3d, identify=previous is not None)
        table = self._table(collected.sources)
        geometries, instances = self._instances(collected, table, previous)
        lights, light_warnings = convert_lights(depsgraph)
        world, world_warnings = convert_world(depsgraph)
        evaluated = depsgraph.scene_eval
        mist_world = getattr(depsgraph.view_layer_eval, "world_override", None) or evaluated.world
        mist = mist_world.mist_settings if mist_world else None
        return scene.Scene(
            geometries=geometries,
            instances=instances,
            materials=table,
            lights=tuple(lights),
            world=world,
            transparent=evaluated.render.film_transparent,
            mist=world_module.Mist(mist.start, mist.depth, mist.falloff) if mist else world_module.Mist(),
            warnings=(
                *_unsupported(collected.unsupported | self._filled(collected.sources, table)),
                *self._translucent_polygons(collected.sources, table),
                *dict.fromkeys(warning for known in self._known.values() for warning in known.warnings),
                *self._material_warnings,
                *light_warnings,
                *world_warnings,
            ),
        )

    def forget(self) -> None:
        """Look at everything again next time; what has the same content is still not converted again."""
        self._depsgraph = 0

    def _forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Drop what the dependency graph says changed. A re-evaluated modifier gives its mesh a new session_uid."""
        updates = depsgraph.updates
        if len(updates) == 0 or depsgraph.as_pointer() != self._depsgraph:
            self._known, self._materials = {}, None
        self._depsgraph = depsgraph.as_pointer()
        changed = {u.id.original.session_uid for u in updates if u.is_updated_geometry}
        if changed:
            kept = {k: v for k, v in self._known.items() if not v.generated and changed.isdisjoint(v.owners)}
            self._known = kept
        if any(isinstance(u.id, SHADING) for u in updates):
            self._materials = None

    def _table(self, sources: Iterable[Source]) -> materials_module.MaterialTable:
        """The table of materials; rows of materials that are not in use hold the default."""
        used = {self.cache.row(m): m for source in sources for m in source.materials}
        used.pop(0, None)
        if self._materials is None or tuple(used) != self._used:
            self._used = tuple(used)
            table, warnings = convert_materials([used.get(row) for row in range(1, self.cache.rows())])
            self._materials, self._material_warnings = table, tuple(warnings)
        return self._materials

    def _filled(self, sources: Iterable[Source], table: materials_module.MaterialTable) -> dict[str, list[str]]:
        """Meshes that a material fills with a medium."""
        names = [
            source.name
            for source in sources
            if isinstance(source.data, bpy.types.Mesh) and not source.particles and not source.smoke and not source.hair
            if any(table.media[row] for m in source.materials if (row := self.cache.row(m)) < len(table.media))
        ]
        return {"volumes within meshes": names} if names else {}

    def _translucent_polygons(self, sources: Iterable[Source], table: materials_module.MaterialTable) -> list[str]:
        """A warning that names meshes whose primitive is Polygons although their materials let light through."""
        if table.translucent is None:
            return []
        names = sorted({
            source.name
            for source in sources
            if source.primitive == "POLYGONS" and isinstance(source.data, bpy.types.Mesh) and not source.particles
            and not source.hair and any(table.translucent[self.cache.row(m)] for m in source.materials)
        })  # fmt: skip
        if not names:
            return []
        return [f"Surfaces that let light through are drawn as points, not as polygons: {_named(names)}"]

    def _instances(
        self, collected: Collected, table: materials_module.MaterialTable, previous: dict[tuple, np.ndarray] | None
    ) -> tuple[tuple[scene.Geometry, ...], scene.Instances]:
        sources = collected.sources
        found = self._geometries(sources, table)
        unique = {g.key: g for g in found if g is not None}
        order = {key: row for row, key in enumerate(unique)}
        geometry = np.array([-1 if g is None else order[g.key] for g in found], np.int32)[collected.source]
        drawn = geometry >= 0
        source = collected.source[drawn]
        world_from_object = collected.world_from_object[drawn]
        before = None
        if previous is not None:
            identity = [i for i, use in zip(collected.identity, drawn, strict=True) if use]
            before = np.array([previous.get(i, m) for i, m in zip(identity, world_from_object, strict=True)])
        return tuple(unique.values()), scene.Instances(
            geometry=geometry[drawn],
            world_from_object=world_from_object,
            previous=None if before is None else before.reshape(-1, 4, 4),
            pass_index=np.array([s.pass_index for s in sources], np.int32)[source],
            holdout=np.array([s.holdout for s in sources], bool)[source],
            object_hash=np.array([hash_of_name(s.name) for s in sources], np.uint32)[source],
            casts=None if all(s.casts for s in sources) else np.array([s.casts for s in sources], bool)[source],
            names=tuple([sources[i].name for i in source]),
        )

    def _geometries(self, sources: list[Source], table: materials_module.MaterialTable) -> list[scene.Geometry | None]:
        """The geometry of each source; converts only what is not known."""
        known: dict[tuple, Known] = {}
        keys = []
        for source in sources:
            rows = tuple(self.cache.row(m) for m in source.materials)
            reads = tuple(graph.digest if (graph := _graph(table, row)) else "" for row in rows)
            key = (
                source.data.session_uid,
                rows,
                reads,
                source.primitive,
                source.spacing,
                source.extinction,
                source.radius,
            )
            if source.smoke:
                key = (*key, source.smoke.key)
            if isinstance(source.data, bpy.types.Volume):
                names = wanted_grids(_medium(table, rows[0]), source.transfer)
                key = (*source_key(source.data), *key, names, source.transfer and digest(source.transfer))
            if source.particles:
                key = (*key, source.particles.key)
            if source.particles or isinstance(source.data, bpy.types.PointCloud) or _is_scattered(source):
                key = (*key, cloud_material(table, rows[0]).key)
            if source.strands:
                looks = tuple((cloud_material(table, row).key, *table.base_color[row].tolist()) for row in rows)
                # Evaluated curve data have no session_uid
                names = source.data.original.session_uid, source.owner, source.hair and source.hair.modifier.name
                key = (*key, *names, looks, source.ribbons)
            keys.append(key)
            last = known.get(key) or self._known.get(key)
            voxels, warnings, lines = (last.voxels, last.warnings, last.lines) if last else (None, (), None)
            if last and not source.editing:
                geometry = last.geometry
            elif source.smoke or isinstance(source.data, bpy.types.Volume):
                geometry, voxels, warnings = self._read_volume(source, rows[0], table)
            elif source.strands:
                geometry, lines, warnings = self._read_lines(source, rows, table)
            else:
                geometry = self._read(source, rows, table)
            owners = {source.owner, source.data.original.session_uid, source.data.session_uid}
            owners |= last.owners if last else set()
            generated = source.generated or bool(last and last.generated)
            known[key] = Known(geometry, frozenset(owners), generated, voxels, warnings, lines)
        self._known = known
        self._held = tuple(entry.voxels or entry.lines for entry in known.values())
        return [known[key].geometry for key in keys]

    def _read(
        self, source: Source, rows: tuple[int, ...], table: materials_module.MaterialTable
    ) -> scene.Geometry | None:
        mesh = cloud = None
        if source.particles or isinstance(source.data, bpy.types.PointCloud):
            material, lookup = cloud_material(table, rows[0], source.extinction), self.cache.lookup
            if source.particles:
                key, cloud = splats(source.particles, material, lookup)
            else:
                found = read_pointcloud(source.data, material, lookup, source.radius)  # pyright: ignore[reportArgumentType]
                key, cloud = found or ("", None)
        else:
            material = cloud_material(table, rows[0], source.extinction)
            found = _read_evaluated(source, rows, _attributes(table, rows), material, self.cache.lookup)
            if isinstance(found, mesh_module.Mesh):
                mesh, key = found, found.key
            else:
                key, cloud = found or ("", None)
        if mesh is None and cloud is None:
            return None
        primitive, spacing, extinction = source.primitive, source.spacing, source.extinction

        def build() -> scene.Geometry:
            return scene.Geometry(
                key, source.name, mesh, cloud, primitive=primitive, spacing=spacing, extinction=extinction
            )

        key = f"{key} {primitive} {spacing:g} {extinction:g}"
        return self.cache.lookup(key, build)

    def _read_lines(
        self, source: Source, rows: tuple[int, ...], table: materials_module.MaterialTable
    ) -> tuple[scene.Geometry | None, curves.Converted | None, tuple[str, ...]]:
        """The geometry of strands, what keeps them, and what is wrong with them."""
        materials = tuple(cloud_material(table, row) for row in rows)
        if source.hair:
            strands = curves.read_hair(source.hair, materials)
        elif isinstance(source.data, bpy.types.Curve):
            strands = curves.read_tubes(source.data)
        else:
            strands = curves.read_curves(source.data, materials, source.ribbons)  # pyright: ignore[reportArgumentType]
        if strands is None:
            return None, None, ()
        found = curves.convert(strands, source.name, materials, self.cache.lookup)
        warnings = tuple(f"{source.name}: {message}" for message in found.messages)
        if found.lines is None:
            return None, found, warnings
        key = f"{found.lines.key} lines"
        made = scene.Geometry(key, source.name, strands=found.lines, primitive="LINES")
        return self.cache.lookup(key, lambda: made), found, warnings

    def _read_volume(
        self, source: Source, row: int, table: materials_module.MaterialTable
    ) -> tuple[scene.Geometry | None, Voxels, tuple[str, ...]]:
        """The geometry of a volume, the voxels that it shares with others, and what is wrong with them."""
        names = wanted_grids(_medium(table, row), source.transfer)
        voxels = source.smoke or read_voxels(source.data, names, self.cache.lookup)  # pyright: ignore[reportArgumentType]
        warnings = tuple(f"{source.name}: {message}" for message in voxels.messages)
        volume = convert_volume(voxels, source.name, row, source.transfer)
        if volume is None:
            return None, voxels, warnings
        spacing, extinction = source.spacing, source.extinction
        key = f"{volume.key} {row} {spacing:g} {extinction:g} {source.transfer and digest(source.transfer)}"
        made = scene.Geometry(key, source.name, volume=volume, spacing=spacing, extinction=extinction)
        return self.cache.lookup(key, lambda: made), voxels, warnings


def _medium(table: materials_module.MaterialTable, row: int) -> volume_module.Medium | None:
    return table.media[row] if row < len(table.media) else None


def _graph(table: materials_module.MaterialTable, row: int) -> MaterialGraph | None:
    return table.graphs[row] if row < len(table.graphs) else None  # pyright: ignore[reportReturnType]


def _attributes(table: materials_module.MaterialTable, rows: tuple[int, ...]) -> frozenset[str | None]:
    """Names of the attributes that the materials read."""
    graphs = [graph for row in rows if (graph := _graph(table, row))]
    return frozenset().union(*(needs(graph).colors for graph in graphs))


def _is_scattered(source: Source) -> bool:
    """Whether a source is a mesh that is drawn as points."""
    return isinstance(source.data, bpy.types.Mesh) and not source.strands and is_scattered(source.data)


def _read_evaluated(
    source: Source,
    rows: tuple[int, ...],
    wanted: frozenset[str | None],
    material: CloudMaterial,
    lookup: Callable,
) -> mesh_module.Mesh | tuple[str, PointCloud] | None:
    """The mesh of a source, or the key and points of one without edges and faces; None where there is nothing to draw.

    In edit mode Blender's evaluated mesh holds no arrays, and a copy is made.
    """

    def read(data: bpy.types.Mesh) -> mesh_module.Mesh | tuple[str, PointCloud] | None:
        if is_scattered(data):
            return read_pointcloud(data, material, lookup, source.radius)
        return read_mesh(data, source.name, rows, wanted, lookup)

    if source.editing is None:
        return read(source.data)  # pyright: ignore[reportArgumentType]
    try:
        return read(source.editing.to_mesh())
    finally:
        source.editing.to_mesh_clear()


def _unsupported(kinds: dict[str, list[str]]) -> list[str]:
    """One warning for each kind of object that is not drawn, naming a few."""
    warnings = []
    for kind, names in kinds.items():
        warnings.append(f"{kind} are not supported yet and are left out: {_named(sorted(set(names)))}")
    return warnings


def _named(names: list[str]) -> str:
    """The first MAX_NAMED names in quotation marks, and how many more there are."""
    shown = ", ".join(f'"{name}"' for name in names[:MAX_NAMED])
    return f"{shown} and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else shown
