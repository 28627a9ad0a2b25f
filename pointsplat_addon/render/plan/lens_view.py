"""Widens a camera to all that its lens sees, for preparing a picture whose samples see through points on the lens."""

from __future__ import annotations

import numpy as np

from ...core.lens.thin_lens import widened_camera
from ...core.scene.camera import Camera
from ...core.scene.scene import Geometry, Scene
from ..cache.keys import Key, Kind
from ..cache.store import Store


def camera_of_whole_lens(scene: Scene, camera: Camera, store: Store) -> Camera:
    """Returns the camera whose cut holds what any point on the lens sees."""
    return widened_camera(camera, *_depths(scene, camera, store))


def _depths(scene: Scene, camera: Camera, store: Store) -> tuple[float, float]:
    """The depths between which all boxes around instances lie, and the camera's clipping planes."""
    boxes = np.array([
        store.lookup(Key(Kind.BOX, geometry.key), lambda geometry=geometry: _Box(_box(geometry))).corners
        for geometry in scene.geometries
    ]).reshape(-1, 2, 3)  # fmt: skip
    with np.errstate(all="ignore"):
        rows = (camera.view_from_world @ scene.instances.world_from_object)[:, 2]
        low, high = boxes[scene.instances.geometry].swapaxes(0, 1)
        middle, half = (low + high) / 2, (high - low) / 2
        depth = -(rows[:, :3] * middle).sum(axis=1) - rows[:, 3]
        extent = (np.abs(rows[:, :3]) * half).sum(axis=1)
        ends = np.array([depth - extent, depth + extent])
    ends = ends[:, np.isfinite(ends).all(axis=0)]
    if ends.size == 0:
        return camera.near, camera.near
    return float(max(ends[0].min(), camera.near)), float(min(ends[1].max(), camera.far))


class _Box:
    """The corners of a box, as the store keeps them."""

    def __init__(self, corners: np.ndarray) -> None:
        self.corners, self.nbytes = corners, corners.nbytes


def _box(geometry: Geometry) -> np.ndarray:
    """(2, 3) float64 corners of the box around a geometry's finite points and their radii; NaN where there are none."""
    radius, origin = 0.0, np.zeros(3)
    if geometry.mesh is not None:
        position = geometry.mesh.position
    elif geometry.cloud is not None:
        position, origin, radii = geometry.cloud.position, geometry.cloud.origin, geometry.cloud.radii
        radius = 0.0 if radii is None else _largest(radii)
    elif geometry.strands is not None:
        position, origin = geometry.strands.position, geometry.strands.origin
        radius = _largest(geometry.strands.radius)
    else:
        return np.full((2, 3), np.nan)
    good = np.isfinite(position)
    low = np.min(position, axis=0, where=good, initial=np.inf)
    high = np.max(position, axis=0, where=good, initial=-np.inf)
    return np.array([low.astype(float) - radius, high.astype(float) + radius]) + origin


def _largest(radius: np.ndarray) -> float:
    return float(np.max(np.abs(radius), where=np.isfinite(radius), initial=0.0))
