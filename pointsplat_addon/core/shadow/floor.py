"""Floors: flat casters of which everything else lies on the lamp's side, so that no light that they stop is missed."""

from __future__ import annotations

import numpy as np

from ..scene.lights import Light
from ..scene.mesh import Mesh
from .samples import Outline

FLAT = 1e-6  # of a mesh's size, and of the distances at hand: float32 tells no less apart


def plane_of(mesh: Mesh, outline: Outline) -> tuple[np.ndarray, np.ndarray] | None:
    """A point (3,) and the unit normal (3,) float64, object space, of the plane that holds all triangles of a
    mesh; None where there is none."""
    if not len(mesh.triangles) or not outline.size > 0:
        return None
    a, b, c = mesh.position[mesh.triangles[outline.area.argmax()]].astype(np.float64)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    slack = FLAT * (np.linalg.norm(outline.high - outline.low) + np.abs(box_corners(outline.low, outline.high)).max())
    used = mesh.position[np.unique(mesh.triangles)].astype(np.float64)
    return (a, normal) if np.abs((used - a) @ normal).max() <= slack else None


def shines_from(light: Light, point: np.ndarray, normal: np.ndarray) -> bool:
    """Whether all of a lamp lies on the side of a plane, through `point` (3,), that its unit `normal` (3,) points to;
    world space, float64."""
    if light.kind == "SUN":
        return bool(-light.direction @ normal > np.sin(min(light.radius, np.pi / 2)))
    sides = (light.axis_u, light.axis_v) if light.kind == "AREA" else ()
    extent = light.radius + sum(abs(float(side @ normal)) for side in sides if side is not None)
    return bool((light.position - point) @ normal > extent)


def lowest_corner(
    low: np.ndarray, high: np.ndarray, world_from_object: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> float:
    """The least height, above a plane in the world, of boxes between corners (3,) in object space, of instances
    (I, 4, 4); not a number where a matrix is none."""
    return lowest(box_corners(low, high), world_from_object, point, normal)


def lowest(position: np.ndarray, world_from_object: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float:
    """The same of positions (N, 3)."""
    with np.errstate(all="ignore"):
        along = normal @ world_from_object[:, :3, :3]  # (I, 3)
        height = position.astype(np.float64) @ along.T + (world_from_object[:, :3, 3] - point) @ normal
        return float(height.min(initial=np.inf))


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(8, 3) of a box between two (3,)."""
    return np.stack([np.where(which, high, low) for which in np.ndindex(2, 2, 2)])
