"""Floors: flat casters, and slabs as of walls, of which everything else lies on the light's side, so that leaving them
out changes no shadow."""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import cross, dot, unit_rows
from ..scene.bounds import box_corners, used_positions
from ..scene.lights import Light
from ..scene.mesh import Mesh
from .samples import MeshExtents

FLATNESS = 1e-6  # of a mesh's size, and of the distances at hand: float32 tells no less apart
SOME_TRIANGLES = 256  # that are looked at before all of a mesh, and
LOOSE = 4.0  # times as far from their plane as all may be
SLAB_TRIANGLES = 64  # at most: each is compared with all corners
SLAB_THICKNESS = 0.1  # of a slab's diagonal, at most: no camera is to be inside, where it would be dark
FLAT_COSINE = 0.999  # least cosine between the normals of a slab's corners and those of its triangles


def plane_of_mesh(mesh: Mesh, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A point (3,) and the unit normal (3,) float64, object space, of the plane that holds all triangles of a
    mesh between corners (3,); None if there is no such plane."""
    slack = FLATNESS * float(np.linalg.norm(high - low) + max(np.abs(low).max(), np.abs(high).max()))
    some = mesh.triangles[:: max(1, len(mesh.triangles) // SOME_TRIANGLES)]
    found = _plane_through(mesh.position[some.reshape(-1)])
    if found is not None and not found[2] <= LOOSE * slack:
        return None  # some triangles tell of nearly every mesh that it is not flat
    found = _plane_through(used_positions(mesh))
    return found[:2] if found is not None and found[2] <= slack else None


def _plane_through(position: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """A point, the unit normal of a plane through three of the points (N, 3) that lie far from each other, and how far
    others lie from it; None for points on a line, or fewer than three."""
    if len(position) == 0:
        return None
    offset = position.astype(np.float64)
    first = offset[0].copy()
    offset -= first
    along = offset[dot(offset.T, offset.T).argmax()]
    normals = cross(along[:, None], offset.T)
    normal = normals[:, dot(normals, normals).argmax()]
    length = np.linalg.norm(normal)
    if not length > 0:
        return None
    normal /= length
    return first, normal, float(np.abs(offset @ normal).max())


def planes_of_body(mesh: Mesh, extents: MeshExtents) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points (3,) and unit outward normals (3,) float64, object space, of the faces of a mesh that is closed and
    convex, with flat shading; none if it is not. What of it is turned to a light is never in its own shadow."""
    count = len(mesh.triangles)
    if not 4 <= count <= SLAB_TRIANGLES or not extents.area.min() > 0 or mesh.vertex_normal is not None:
        return []
    corners = mesh.position[mesh.triangles].astype(np.float64)
    normal = unit_rows(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    if mesh.corner_normal is not None and np.einsum("tkc,tc->tk", mesh.corner_normal, normal).min() < FLAT_COSINE:
        return []
    edges = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1).reshape(-1, 2).tolist()
    once = {(a, b) for a, b in edges}
    if len(once) != len(edges) or not all((b, a) in once for a, b in edges):
        return []
    height = normal @ corners.reshape(-1, 3).T - np.einsum("tc,tc->t", normal, corners[:, 0])[:, None]
    if height.max() > FLATNESS * (np.linalg.norm(extents.high - extents.low) + np.abs(corners).max()):
        return []
    _, first = np.unique(np.round(normal, 4), axis=0, return_index=True)
    return [(corners[i, 0], normal[i]) for i in first]


def is_thin(mesh: Mesh, world_from_object: np.ndarray, point: np.ndarray, normal: np.ndarray) -> bool:
    """Whether an instance (4, 4) of a mesh lies close below a plane in the world through one of its faces."""
    world = mesh.position[mesh.triangles.reshape(-1)] @ world_from_object[:3, :3].T + world_from_object[:3, 3]
    size = np.linalg.norm(world.max(axis=0) - world.min(axis=0))
    return bool(((world - point) @ normal).min() >= -SLAB_THICKNESS * size)


def light_is_above(light: Light, point: np.ndarray, normal: np.ndarray) -> bool:
    """Whether all of a light lies on the side of a plane, through `point` (3,), that its unit `normal` (3,) points to;
    world space, float64."""
    if light.kind == "SUN":
        return bool(-light.direction @ normal > np.sin(min(light.radius, np.pi / 2)))
    sides = (light.axis_u, light.axis_v) if light.kind == "AREA" else ()
    extent = light.radius + sum(abs(float(side @ normal)) for side in sides if side is not None)
    return bool((light.position - point) @ normal > extent)


def lowest_box_height(
    low: np.ndarray, high: np.ndarray, world_from_object: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> float:
    """The least height, above a plane in the world, of boxes between corners (3,) in object space, of instances
    (I, 4, 4); NaN if a matrix is not finite."""
    return lowest_height(box_corners(low, high), world_from_object, point, normal)


def lowest_height(position: np.ndarray, world_from_object: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float:
    """The least height, above a plane in the world, of positions (N, 3) in object space, of instances (I, 4, 4); NaN if
    a matrix is not finite."""
    with np.errstate(all="ignore"):
        along = normal @ world_from_object[:, :3, :3]  # (I, 3)
        height = position.astype(np.float64) @ along.T + (world_from_object[:, :3, 3] - point) @ normal
        return float(height.min(initial=np.inf))
