"""Turns the states of a dependency graph into scenes of core, reading only what has changed."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import bpy
import numpy as np

from ..core.light.fog import without_far_light
from ..core.numeric.cryptomatte import cryptomatte_hash
from ..core.scene import scene
from ..core.scene.materials import MaterialTable
from ..core.scene.world import Mist
from .convert.light.lights import convert_lights
from .convert.light.world import convert_world
from .convert.material.materials import convert_materials
from .convert.material.nodes.tree import Placement
from .convert.material.object_values import give_to_sources, on_objects, shown_alike, values_of_instances
from .convert.objects import Collected, Source, collect
from .geometries import Geometries
from .geometry_cache import CACHE, GeometryCache

MAX_NAMED = 3  # objects that a warning names before it counts the rest
SHADING = (bpy.types.Material, bpy.types.ShaderNodeTree, bpy.types.Image)

hash_of_name = lru_cache(maxsize=65536)(cryptomatte_hash)


class Synchronizer:
    """Converts the successive states of one dependency graph and remembers the last."""

    def __init__(self, cache: GeometryCache = CACHE) -> None:
        self._cache = cache
        self._geometries = Geometries(cache)
        self._materials: MaterialTable | None = None
        self._material_warnings: tuple[str, ...] = ()
        self._used: tuple[int, ...] = ()  # rows of the materials in use
        self._placed: dict[int, Placement | None] = {}  # where materials are shown, by row, of those that read it
        self._depsgraph = 0  # address of the last one; 0: everything is read again

    def scene(
        self,
        depsgraph: bpy.types.Depsgraph,
        view3d: bpy.types.SpaceView3D | None = None,
        previous: dict[tuple, np.ndarray] | None = None,
    ) -> scene.Scene:
        """The scene in its present state. If the dependency graph names no changes, everything is read again.

        view3d: the viewport whose local view and filters apply. previous: world_from_object (4, 4) one frame before by
        `Collected.identity`, for the Vector pass.
        """
        self._forget_changed(depsgraph)
        collected = collect(depsgraph, view3d, identify=previous is not None)
        table = self._table(collected)
        values = values_of_instances(collected, table, depsgraph)
        give_to_sources(collected, values)
        geometries, instances = self._instances(collected, table, previous, values)
        lights, light_warnings = convert_lights(depsgraph)
        world, suns, world_warnings = convert_world(depsgraph)
        evaluated = depsgraph.scene_eval
        mist_world = getattr(depsgraph.view_layer_eval, "world_override", None) or evaluated.world
        mist = mist_world.mist_settings if mist_world else None
        return without_far_light(
            scene.Scene(
                geometries=geometries,
                instances=instances,
                materials=table,
                lights=(*lights, *suns),
                world=world,
                transparent=evaluated.render.film_transparent,
                mist=Mist(mist.start, mist.depth, mist.falloff) if mist else Mist(),
                warnings=(
                    *_unsupported(collected.unsupported),
                    *self._translucent_polygons(collected.sources, table),
                    *_alike(shown_alike(collected, values, table, self._cache.row)),
                    *self._geometries.warnings(),
                    *self._material_warnings,
                    *light_warnings,
                    *world_warnings,
                ),
            )
        )

    def forget(self) -> None:
        """Read everything again next time; what still has the same content is not converted again."""
        self._depsgraph = 0

    def _forget_changed(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Drop what the dependency graph reports as changed. Re-evaluated modifiers give meshes a new session_uid."""
        updates = depsgraph.updates
        if len(updates) == 0 or depsgraph.as_pointer() != self._depsgraph:
            self._geometries.forget()
            self._materials = None
        self._depsgraph = depsgraph.as_pointer()
        changed = {u.id.original.session_uid for u in updates if u.is_updated_geometry}
        if changed:
            self._geometries.forget_owned_by(changed)
        if any(isinstance(u.id, SHADING) for u in updates):
            self._materials = None

    def _table(self, collected: Collected) -> MaterialTable:
        """The table of materials; rows of materials that are not in use hold the default."""
        used = {self._cache.row(m): m for source in collected.sources for m in source.materials}
        used.pop(0, None)
        moved = any(used.get(row) and collected.placement(used[row]) != p for row, p in self._placed.items())
        if self._materials is None or tuple(used) != self._used or moved:
            self._used, self._placed = tuple(used), {}

            def placement(material: bpy.types.Material) -> Placement | None:
                return self._placed.setdefault(self._cache.row(material), collected.placement(material))

            table, warnings = convert_materials([used.get(row) for row in range(1, self._cache.rows())], placement)
            self._materials, self._material_warnings = table, tuple(warnings)
        return self._materials

    def _translucent_polygons(self, sources: Iterable[Source], table: MaterialTable) -> list[str]:
        """A warning that names meshes whose primitive is Polygons although their materials are translucent."""
        if table.translucent is None:
            return []
        names = sorted({
            source.name
            for source in sources
            if source.primitive == "POLYGONS" and isinstance(source.data, bpy.types.Mesh) and not source.particles
            and not source.hair and not source.filled and not source.matte
            and any(table.translucent[self._cache.row(m)] for m in source.materials)
        })  # fmt: skip
        if not names:
            return []
        return [f"Translucent surfaces are drawn as points, not as polygons: {_named(names)}"]

    def _instances(
        self,
        collected: Collected,
        table: MaterialTable,
        previous: dict[tuple, np.ndarray] | None,
        values: dict[str, np.ndarray],
    ) -> tuple[tuple[scene.Geometry, ...], scene.Instances]:
        """The distinct geometries, and the instances of those that have something to draw."""
        sources = collected.sources
        found = self._geometries.convert(sources, table)
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
        instances = scene.Instances(
            geometry=geometry[drawn],
            world_from_object=world_from_object,
            previous=None if before is None else before.reshape(-1, 4, 4),
            pass_index=np.array([s.pass_index for s in sources], np.int32)[source],
            holdout=np.array([s.holdout for s in sources], bool)[source],
            object_hash=np.array([hash_of_name(s.name) for s in sources], np.uint32)[source],
            casts=_flags([s.casts for s in sources], source),
            seen=_flags([s.seen for s in sources], source),
            scatters=_flags([s.scatters for s in sources], source),
            mirrored=_flags([s.mirrored for s in sources], source),
            matte=np.array([s.matte for s in sources], bool)[source] if any(s.matte for s in sources) else None,
            names=tuple([sources[i].name for i in source]),
            objects={name: column[drawn] for name, column in values.items()},
        )
        return on_objects(tuple(unique.values()), instances, table) if values else (tuple(unique.values()), instances)


def _flags(values: list[bool], source: np.ndarray) -> np.ndarray | None:
    """(I,) bool: those of the sources (I,) of instances; None: all are set."""
    return None if all(values) else np.array(values, bool)[source]


def _alike(names: list[str]) -> list[str]:
    """A warning that names objects whose instances look as the first does."""
    return [f"Instances of points and strands look as the first of them: {_named(names)}"] if names else []


def _unsupported(kinds: dict[str, list[str]]) -> list[str]:
    """One warning for each kind of object that is not drawn, naming a few. kinds: to names of objects."""
    warnings = []
    for kind, names in kinds.items():
        warnings.append(f"{kind} are not supported yet and are left out: {_named(sorted(set(names)))}")
    return warnings


def _named(names: list[str]) -> str:
    """The first MAX_NAMED names in quotation marks, and how many more there are."""
    shown = ", ".join(f'"{name}"' for name in names[:MAX_NAMED])
    return f"{shown} and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else shown
