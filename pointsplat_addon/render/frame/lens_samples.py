"""Depth of field by samples that are drawn through places on the lens (Cook et al. 1984; Haeberli and Akeley 1990).

The cut, the pages and the lists of what is drawn are made once, for a picture that is wide enough for all places; per
sample only the tables that hold the view are made anew. The first sample is drawn through the middle of the lens, so
that what moves in a viewport is steady, and passes that are not averaged are those of a camera without a lens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.lens.thin_lens import lens_points, through, widened
from ...core.scene.camera import Camera
from ...core.scene.scene import Geometry, Scene
from ..cache.keys import Key, Kind
from ..cache.store import Store
from ..device.protocol import Device, Texture
from ..passes.tiles import KEEP
from .uploads import Uploads


def prepared_for(scene: Scene, camera: Camera, store: Store) -> Camera:
    """The camera whose cut holds what any place on the lens sees."""
    return widened(camera, *_depths(scene, camera, store))


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
        reach = (np.abs(rows[:, :3]) * half).sum(axis=1)
        ends = np.array([depth - reach, depth + reach])
    ends = ends[:, np.isfinite(ends).all(axis=0)]
    if ends.size == 0:
        return camera.near, camera.near
    return float(max(ends[0].min(), camera.near)), float(min(ends[1].max(), camera.far))


class _Box:
    def __init__(self, corners: np.ndarray) -> None:
        self.corners, self.nbytes = corners, corners.nbytes


def _box(geometry: Geometry) -> np.ndarray:
    """(2, 3) float64 corners of what is finite of a geometry's points, with their radii; NaN where there is none."""
    reach, origin = 0.0, np.zeros(3)
    if geometry.mesh is not None:
        position = geometry.mesh.position
    elif geometry.cloud is not None:
        position, origin, radii = geometry.cloud.position, geometry.cloud.origin, geometry.cloud.radii
        reach = 0.0 if radii is None else _largest(radii)
    elif geometry.lines is not None:
        position, origin = geometry.lines.position, geometry.lines.origin
        reach = _largest(geometry.lines.radius)
    else:
        return np.full((2, 3), np.nan)
    good = np.isfinite(position)
    low = np.min(position, axis=0, where=good, initial=np.inf)
    high = np.max(position, axis=0, where=good, initial=-np.inf)
    return np.array([low.astype(float) - reach, high.astype(float) + reach]) + origin


def _largest(radius: np.ndarray) -> float:
    return float(np.max(np.abs(radius), where=np.isfinite(radius), initial=0.0))


class LensSamples:
    """The places on the lens through which one picture is drawn."""

    def __init__(self, device: Device, camera: Camera, samples: int) -> None:
        """`camera`: with an aperture; what it shows is what is drawn."""
        assert camera.aperture is not None
        self.device, self.camera = device, camera
        self.points = lens_points(samples, camera.aperture)
        self.place: Texture | None = None

    def view(self, sample: int, uploads: Uploads) -> Camera:
        """The camera of a sample, for which `uploads` are moved."""
        seen = through(self.camera, self.points[sample])
        if sample:
            still = replace(self.camera, view_from_world=np.eye(4))
            uploads.move(through(still, self.points[sample]).view_from_world, seen)
        return seen

    def keep(self, place: Texture, record: np.ndarray) -> None:
        """Remember the depths that the middle of the lens sees: what else is drawn in a viewport is hidden by them."""
        self.place = self.device.texture(place.size, "RGBA32F")
        self._target = self.device.target([self.place])
        self.device.draw(KEEP, self._target, uniforms=record.copy(), textures={"ps_combined": place})

    def release(self) -> None:
        if self.place is not None:
            self._target.release()
            self.place.release()
        self.place = None
