"""The opaque triangles of a scene, in which rays are traced, and what these find there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.light.bsdf import relative_index
from ...core.material.graph import MaterialGraph
from ...core.numeric.record import record
from ...core.numeric.vectors import each_block, unit_rows
from ...core.scene.materials import MaterialTable
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Scene
from ...core.surface.appearance import CLIP, at_places, corner_normals, graphs_of, passing
from ...core.surface.footprints import footprints, over_footprints
from ...core.surface.samples import Samples, interpolate, material_ids

# Roughness up to which mirrors show what rays meet alone, and from which on what cells show alone.
SHARP, BLURRED = 0.2, 0.3
MOST_TRIANGLES = 1 << 21  # of all instances, of about 150 bytes each
MOST_SPREAD = 0.25
BLOCK = 1 << 14  # hits: the scratch of one block stays in the cache
GRAZING = 0.1  # cosine: footprints of surfaces that are met at a lower angle are as long as at this one


@record
class SceneTriangles:
    """T triangles of a scene's instances."""

    instance: np.ndarray  # (T,) int32, rows of the scene's instances
    triangle: np.ndarray  # (T,) int32, rows of its mesh's triangles


@record
class Hits:
    """N places where rays meet triangles."""

    row: np.ndarray  # (N,) int64, of SceneTriangles
    weights: np.ndarray  # (N, 2) float32, of corners 1 and 2
    direction: np.ndarray  # (N, 3) unit, of the rays, world
    width: np.ndarray  # (N,) world units that a ray stands for there, across it
    # The same, and radians between directions, of the whole lobe that it belongs to: highlights are as wide as to be
    # found by all of its rays
    lobe_width: np.ndarray
    lobe_turn: np.ndarray


@record
class HitSurfaces:
    """What rays see there; directions in world space, on the side that is seen."""

    normal: np.ndarray  # (N, 3) float32, unit
    plane: np.ndarray  # (N, 3) float32, unit
    material: np.ndarray  # (N,) int64
    color: np.ndarray  # (N, 3) float32
    surface: np.ndarray  # (N, 2) float32: roughness, metallic
    emission: np.ndarray  # (N, 3) float32
    spread: np.ndarray  # (N,) float32: variance of the slopes of half vectors within what rays stand for


def scene_triangles(scene: Scene, origin: np.ndarray) -> tuple[SceneTriangles, np.ndarray] | None:
    """Returns the triangles that rays may meet, and their corners from `origin`, (T, 3, 3) float32; None where there
    are none, or too many."""
    instances, found, corners, total = scene.instances, [], [], 0
    shown = np.isfinite(instances.world_from_object).all(axis=(1, 2))
    if instances.mirrored is not None:
        shown &= instances.mirrored
    if instances.matte is not None and any(one.captured is not None for one in scene.geometries):
        shown &= ~instances.matte  # they stand for surfaces of the capture, which mirrors show
    rows_of = instances.of_each(len(scene.geometries), shown)
    for geometry, rows in zip(scene.geometries, rows_of, strict=True):
        mesh = geometry.mesh
        if mesh is None or not len(rows) or not len(mesh.triangles) or passing(mesh, scene.materials) is not None:
            continue
        total += len(rows) * len(mesh.triangles)
        if total > MOST_TRIANGLES:
            return None
        matrices = instances.world_from_object[rows]
        moved = np.einsum("vc,iac->iva", mesh.position, matrices[:, :3, :3])
        moved += (matrices[:, :3, 3] - origin)[:, None]
        corners.append(moved.astype(np.float32)[:, mesh.triangles].reshape(-1, 3, 3))
        count = len(mesh.triangles)
        found.append((np.repeat(rows, count), np.tile(np.arange(count), len(rows))))
    if not found:
        return None
    of_each, place = np.concatenate(found, axis=1), np.concatenate(corners)
    sound = np.flatnonzero(np.isfinite(place).all(axis=(1, 2)))
    if not len(sound):
        return None
    instance, triangle = of_each[:, sound].astype(np.int32)
    return SceneTriangles(instance, triangle), place[sound]


def surfaces_at(scene: Scene, triangles: SceneTriangles, hits: Hits) -> HitSurfaces:
    """Returns what rays see where they hit; graphs are evaluated there, over what each ray stands for."""
    count, f = len(hits.row), np.float32
    made = HitSurfaces(
        np.zeros((count, 3), f), np.zeros((count, 3), f), np.zeros(count, np.int64),
        np.zeros((count, 3), f), np.zeros((count, 2), f), np.zeros((count, 3), f),
        np.zeros(count, f),
    )  # fmt: skip
    instance = triangles.instance[hits.row]
    geometry = scene.instances.geometry[instance]
    for row in np.unique(geometry).tolist():
        mesh = scene.geometries[row].mesh
        assert mesh is not None
        here = np.flatnonzero(geometry == row)

        def look(block: slice, mesh: Mesh = mesh, here: np.ndarray = here) -> None:
            some = here[block]
            _look(made, some, scene, mesh, instance[some], triangles.triangle[hits.row[some]], hits)

        each_block(len(here), look, BLOCK)
    return made


def cut_out(scene: Scene, triangles: SceneTriangles, row: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Returns which places alpha cuts out, (N,) bool, in rows (N,) of triangles, with weights (N, 2) of their corners 1
    and 2."""
    found = np.zeros(len(row), bool)
    if not _varies(scene.materials, "alpha").any():
        return found
    instance = triangles.instance[row]
    geometry = scene.instances.geometry[instance]
    for number in np.unique(geometry).tolist():
        mesh = scene.geometries[number].mesh
        assert mesh is not None
        graphs = {
            key: MaterialGraph(alpha=graph.alpha)
            for key, graph in graphs_of(mesh, scene.materials).items()
            if graph.alpha
        }
        here = np.flatnonzero(geometry == number)
        if not graphs or not len(here):
            continue
        seen, triangle = np.unique(triangles.triangle[row[here]], return_inverse=True)
        mesh = mesh.take(seen)
        samples = Samples(
            "PATCHES", triangle.reshape(-1).astype(np.int32), weights[here], np.zeros((len(here), 2, 2), np.float32)
        )
        if mesh.objects and scene.instances.objects:
            mesh = replace(mesh, objects=scene.instances.objects)
            samples = replace(samples, object=instance[here])
        alpha = at_places(mesh, samples, graphs, scene.materials, np.ones(len(here), np.float32)).alpha
        if alpha is not None:
            found[here] = alpha < CLIP
    return found


def _look(
    made: HitSurfaces,
    rows: np.ndarray,
    scene: Scene,
    mesh: Mesh,
    instance: np.ndarray,
    triangle: np.ndarray,
    hits: Hits,
) -> None:
    """Writes what hits `rows` (n,) see of instances (n,) of a mesh."""
    table, weights, direction = scene.materials, hits.weights[rows], hits.direction[rows].astype(np.float64)
    linear = scene.instances.world_from_object[instance, :3, :3]
    with np.errstate(all="ignore"):
        back = np.nan_to_num(_inverse(linear))
    plain = Samples("PATCHES", triangle.astype(np.int32), weights, np.zeros((len(rows), 2, 2), np.float32))
    first, second, third = mesh.position[mesh.triangles[triangle]].astype(np.float64).transpose(1, 0, 2)
    plane = _turned(np.cross(second - first, third - first), back)
    plane = np.where((plane * direction).sum(axis=1, keepdims=True) > 0, -plane, plane)
    normals = corner_normals(mesh.take(triangle)).reshape(-1, 3, 3)
    normal = np.einsum("nk,nkc->nc", _three(weights), normals)
    scale = np.cbrt(np.abs(np.linalg.det(linear))).astype(np.float32)
    # Both change evenly over what a ray stands for, half vectors by half as much as directions.
    bent = hits.lobe_width[rows] * _curvature(first, second, third, normals) / np.maximum(scale, 1e-30)
    across = np.square(bent) + np.square(0.5 * hits.lobe_turn[rows])
    made.spread[rows] = np.minimum(across / 6, MOST_SPREAD)
    made.plane[rows] = plane
    material = material_ids(mesh, plain)
    made.material[rows] = material
    made.color[rows], made.emission[rows] = table.base_color[material], table.emission[material]
    made.surface[rows] = np.stack([table.roughness, table.metallic], axis=1)[material]
    graphs = graphs_of(mesh, table)
    if graphs:
        across = unit_rows(np.cross(plane, direction))
        lost = ~across.any(axis=1)
        across[lost] = unit_rows(np.cross(plane[lost], plane[lost][:, [1, 2, 0]]))
        along = np.cross(plane, across)
        cosine = np.maximum(np.abs((plane * direction).sum(axis=1)), GRAZING)
        half = 0.5 * hits.width[rows]
        ways = (across * half[:, None], along * (half / cosine)[:, None])
        position = interpolate(mesh, plain, mesh.position[mesh.triangles]).astype(np.float64)
        samples = footprints(mesh, triangle, position, *(np.einsum("nab,nb->na", back, way) for way in ways))
        turned = np.cross(second - first, third - first)
        backfacing = (np.einsum("nab,nb->na", back, direction) * turned).sum(axis=1) > 0
        samples = replace(samples, backfacing=backfacing)
        if mesh.objects and scene.instances.objects:
            mesh, samples = replace(mesh, objects=scene.instances.objects), replace(samples, object=instance)
        found, _ = over_footprints(mesh, samples, graphs, table, scale)
        for name in ("color", "surface", "emission"):
            values = getattr(found, name)
            if values is not None:
                getattr(made, name)[rows] = values
        normal = normal if found.normal is None else found.normal
    normal = _turned(normal, back)
    normal[~normal.any(axis=1)] = plane[~normal.any(axis=1)]
    made.normal[rows] = np.where((normal * plane).sum(axis=1, keepdims=True) < 0, -normal, normal)


def _curvature(first: np.ndarray, second: np.ndarray, third: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N,) radians that normals (N, 3, 3) of corners (N, 3) turn on a unit of object space, along the side where it is
    most."""
    corners, found = (first, second, third), np.zeros(len(first))
    for i in range(3):
        side = np.linalg.norm(corners[i] - corners[i - 1], axis=1)
        turn = np.linalg.norm(normals[:, i] - normals[:, i - 1], axis=1)
        found = np.maximum(found, np.divide(turn, side, out=np.zeros_like(found), where=side > 0))
    return found


def _three(weights: np.ndarray) -> np.ndarray:
    """(N, 3): the weights of all corners, of those of corners 1 and 2, (N, 2)."""
    return np.column_stack([1 - weights.sum(axis=1), weights])


def _turned(normals: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) in world space of those in object space; back: (N, 3, 3), object_from_world."""
    return unit_rows(np.einsum("nab,na->nb", back, normals))


def _inverse(matrices: np.ndarray) -> np.ndarray:
    """(N, 3, 3): inverses; what has none becomes infinite."""
    a, b, c = matrices.transpose(2, 0, 1)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return cofactors / np.einsum("na,na->n", a, cofactors[:, 0])[:, None, None]


def reflecting(table: MaterialTable) -> np.ndarray:
    """(M,) bool: materials that may mirror something."""
    return (table.metallic > 0) | (relative_index(table.ior, table.specular) != 1) | _varies(table, "metallic")


def sharp_mirrors(table: MaterialTable) -> np.ndarray:
    """(M,) bool: materials that may mirror something more sharply than cells of the light tree's gathers show."""
    return reflecting(table) & ((table.roughness < BLURRED) | _varies(table, "roughness"))


def shines_past_rays(scene: Scene) -> bool:
    """Whether points or strands send light that rays among triangles do not find. What is all metal sends none."""
    table = scene.materials
    dark = sharp_mirrors(table) & (table.metallic >= 1) & ~(table.emission > 0).any(axis=1)
    for geometry in scene.geometries:
        if geometry.strands is not None:
            return True
        if geometry.cloud is not None:
            rows = np.zeros(1, int) if geometry.cloud.material is None else np.unique(geometry.cloud.material)
            if not dark[np.minimum(rows, len(table) - 1)].all():
                return True
    return False


def is_traced(roughness: np.ndarray) -> np.ndarray:
    """(N,) float32: the share of what surfaces mirror that rays show; 0 where roughness < 0: nothing is mirrored."""
    share = np.clip((BLURRED - roughness) / (BLURRED - SHARP), 0, 1)
    return np.where(roughness < 0, 0, share).astype(np.float32)


def _varies(table: MaterialTable, channel: str) -> np.ndarray:
    """(M,) bool: materials whose graphs vary a channel."""
    found = [isinstance(graph, MaterialGraph) and channel in graph.channels for graph in table.graphs]
    return np.array((found + [False] * len(table))[: len(table)], bool)
