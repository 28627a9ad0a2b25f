"""Values of the objects that dependency graphs' instances show, as materials read them: those of Cycles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import bpy
import numpy as np

from ....core.material.graph import MaterialGraph, needs
from ....core.material.nodes.procedural.hashes import name_number
from ....core.material.object_values import ATTRIBUTE, SPACE
from ....core.scene.materials import MaterialTable
from ....core.scene.scene import Geometry, Instances
from ....core.surface.appearance import graphs_of
from ....render.prepare.layers import MOST_PRIMITIVES
from ..arrays import digest
from ..objects import Collected

RowsOf = Callable[[bpy.types.Material | None], int]
MOST_APART, MOST_NODES = 64, 16  # geometries that one mesh becomes, for its shadows and for nodes


def values_of_instances(
    collected: Collected, table: MaterialTable, depsgraph: bpy.types.Depsgraph
) -> dict[str, np.ndarray]:
    """(I, C) float32 of each instance, by the names of core.material.object_values; what no graph reads is left out."""
    graphs = [graph for graph in table.graphs if isinstance(graph, MaterialGraph)]
    names = sorted(frozenset().union(*(needs(graph).objects for graph in graphs)))
    return {name: np.asarray(_column(name, collected, depsgraph), np.float32) for name in names}


def give_to_sources(collected: Collected, values: dict[str, np.ndarray]) -> None:
    """Gives each source the values (C,) of its first instance, by which points and strands are evaluated."""
    if not values:
        return
    shown, first = np.unique(collected.source, return_index=True)
    for source, row in zip(shown.tolist(), first.tolist(), strict=True):
        collected.sources[source].values = {name: column[row] for name, column in values.items()}


def shown_alike(collected: Collected, values: dict[str, np.ndarray], table: MaterialTable, rows: RowsOf) -> list[str]:
    """Names of the points and strands whose instances all look as the first does, although materials read the objects.

    rows: returns a material's row in the table.
    """
    if not values:
        return []
    shown, first, which = np.unique(collected.source, return_index=True, return_inverse=True)
    names = set()
    differs = {name: (column != column[first[which]]).any(axis=1) for name, column in values.items()}
    differing = {name: set(collected.source[flags].tolist()) for name, flags in differs.items()}
    for source in shown.tolist():
        one = collected.sources[source]
        if isinstance(one.data, bpy.types.Mesh) and not (one.particles or one.hair or len(one.data.polygons) == 0):
            continue
        graphs = [table.graphs[row] for material in one.materials if (row := rows(material)) < len(table.graphs)]
        read = frozenset().union(*(needs(graph).objects for graph in graphs if isinstance(graph, MaterialGraph)))
        if any(source in differing[name] for name in read):
            names.add(one.name)
    return sorted(names)


def on_objects(
    geometries: tuple[Geometry, ...], instances: Instances, table: MaterialTable
) -> tuple[tuple[Geometry, ...], Instances]:
    """Gives meshes whose materials read the object the values of their first instance.

    Instances become several geometries where what draws them does not know the instances of a mesh apart: shadows,
    of materials through which light passes by the object, and nodes, of instances with very many triangles. Of more
    values, similar ones go together.
    """
    found, geometry = list(geometries), instances.geometry.copy()
    for row, (one, where) in enumerate(zip(geometries, instances.of_each(len(geometries)), strict=True)):
        graphs = [] if one.mesh is None or len(where) == 0 else list(graphs_of(one.mesh, table).values())
        read = frozenset().union(*(needs(graph).objects for graph in graphs))
        if one.mesh is None or not read:
            continue
        own = {name: instances.objects[name][where] for name in sorted(read)}
        through = [MaterialGraph(alpha=g.alpha, transmission_color=g.transmission_color) for g in graphs]
        names = sorted(frozenset().union(*(needs(graph).objects for graph in through)))
        most = MOST_APART
        if len(where) * len(one.mesh.triangles) > MOST_PRIMITIVES:
            names, most = sorted(read), MOST_NODES
        first, which = np.zeros(1, np.int64), np.zeros(len(where), np.int64)
        if names:
            columns = np.concatenate([own[name] for name in names], axis=1)
            _, first, which = np.unique(columns, axis=0, return_index=True, return_inverse=True)
            which = which.reshape(-1) * min(most, len(first)) // len(first)
            _, first = np.unique(which, return_index=True)
        rows = np.append(row, len(found) + np.arange(len(first) - 1))
        geometry[where] = rows[which]
        found += [one] * (len(first) - 1)
        for at, k in zip(rows.tolist(), first.tolist(), strict=True):
            objects = {name: values[k : k + 1] for name, values in own.items()}
            name = f" on {digest(*objects.values())}"
            mesh = replace(one.mesh, key=one.mesh.key + name, objects=objects)
            found[at] = replace(one, key=one.key + name, mesh=mesh)
    return tuple(found), replace(instances, geometry=geometry)


def _column(name: str, collected: Collected, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """(I, C): one value of all instances."""
    sources, source, matrices = collected.sources, collected.source, collected.world_from_object
    if name.startswith(SPACE):
        other = next((ob for ob in bpy.data.objects if str(ob.session_uid) == name.removeprefix(SPACE)), None)
        matrix = np.eye(4) if other is None else np.array(other.evaluated_get(depsgraph).matrix_world, float)
        with np.errstate(all="ignore"):
            inverse = np.linalg.inv(matrix) if abs(np.linalg.det(matrix[:3, :3])) > 1e-30 else np.eye(4)
        return np.broadcast_to(inverse[:3].reshape(-1), (len(source), 12))
    if name.startswith(ATTRIBUTE):
        kind, _, attribute = name.removeprefix(ATTRIBUTE).partition(" ")
        return _attribute(kind, attribute, collected, depsgraph)
    match name:
        case "location":
            return matrices[:, :3, 3]
        case "matrix":
            return matrices[:, :3].reshape(-1, 12)
        case "color":
            return np.array([s.color for s in sources], np.float32).reshape(-1, 4)[source]
        case "index":
            return np.array([s.pass_index for s in sources], np.float32).reshape(-1, 1)[source]
        case "random":
            return _random(collected, depsgraph)
    raise ValueError(f"objects have no value {name}")


def _random(collected: Collected, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """(I, 1): the hash of the object's name, or the number that an instancer chose."""
    sources = collected.sources
    own = np.array([0.0 if s.numbered else name_number(s.name) for s in sources], np.float32)[collected.source]
    numbered = np.array([s.numbered for s in sources], bool)[collected.source]
    if numbered.any():
        numbers = np.empty(len(depsgraph.object_instances), np.int32)
        depsgraph.object_instances.foreach_get("random_id", numbers)
        chosen = numbers[collected.number].view(np.uint32).astype(np.float32) / np.float32(0xFFFFFFFF)
        own = np.where(numbered, chosen, own)
    return own[:, None]


def _attribute(kind: str, name: str, collected: Collected, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """(I, 4): a property of each object, of its instancer or, if that has none, the object, or of the view layer."""
    if kind == "VIEW_LAYER":
        scene = depsgraph.scene
        found = _first(name, (depsgraph.view_layer, scene, scene.world))
        return np.broadcast_to(found, (len(collected.source), 4))
    objects = {ob.session_uid: ob for ob in bpy.data.objects}
    known: dict[tuple[int, int], np.ndarray] = {}

    def of(owner: int, instancer: int) -> np.ndarray:
        owners = [objects.get(uid) for uid in ((instancer, owner) if kind == "INSTANCER" else (owner,))]
        ids = [ob.evaluated_get(depsgraph) for ob in owners if ob is not None]
        return _first(name, (one for ob in ids for one in (ob, ob.data)))

    rows = []
    for source in collected.sources:
        key = source.owner, source.instancer
        if key not in known:
            known[key] = of(*key)
        rows.append(known[key])
    return np.array(rows, np.float32).reshape(-1, 4)[collected.source]


def _first(name: str, ids: Iterable[bpy.types.bpy_struct | None]) -> np.ndarray:
    """(4,): the property of the first that has it, zeros if none has it."""
    found = (_property(one, name) for one in ids if one is not None)
    return next((value for value in found if value is not None), np.zeros(4))


def _property(owner: bpy.types.bpy_struct, name: str) -> np.ndarray | None:
    """A custom property, else one of Blender's by its path, as a colour with alpha: a number is grey. None: neither."""
    readers: tuple[Callable, ...] = (lambda: owner[name], lambda: owner.path_resolve(name))
    for read in readers:
        try:
            value = np.array(read(), float).reshape(-1)
        except (KeyError, TypeError, ValueError):
            continue
        if 0 < len(value) <= 4:
            return (
                np.append(np.repeat(value, 3), 1) if len(value) == 1 else np.append(value, (0, 0, 1)[len(value) - 1 :])
            )
    return None
