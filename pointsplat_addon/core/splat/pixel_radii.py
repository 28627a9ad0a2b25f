"""Radii of points that count in pixels of a view: what a point has there is as wide in the picture, near and far."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from ..numeric.vectors import each_block
from ..scene.camera import Camera
from ..scene.cloud import PointCloud
from ..scene.materials import MaterialTable
from ..scene.scene import Geometry, Scene


def with_pixel_radii(scene: Scene, camera: Camera, of_pages: bool = False) -> Scene:
    """Returns the scene with the radii that clouds with a `pixel_radius` have in one view: those of scans that are read
    by pages where `of_pages`, else all others.

    Each instance then has a geometry of its own, unless they see the same radii. Pixels are those of the full frame of
    `camera`. Ellipses are limited to that radius; all other splats get it, and cast shadows of it.
    """
    counted = np.array(
        [g.cloud is not None and g.pixel_radius > 0 and (g.streamed is not None) == of_pages for g in scene.geometries],
        bool,
    )
    instances = scene.instances
    rows = np.flatnonzero(counted[instances.geometry]) if len(instances) else ()
    if len(rows) == 0:
        return scene
    geometries = list(scene.geometries)
    geometry_of = instances.geometry.copy()
    made: dict[str, int] = {}
    for row in rows:
        geometry = scene.geometries[instances.geometry[row]]
        assert geometry.cloud is not None
        plane, least = _radius_plane(camera, instances.world_from_object[row], geometry.pixel_radius)
        digest = hashlib.sha1(np.append(plane, least).tobytes(), usedforsecurity=False).hexdigest()
        key = f"{geometry.key} {digest}"
        if key not in made:
            sized = _sized(geometry.cloud, plane, least, _is_medium(geometry, scene.materials))
            sized = replace(geometry, key=key, cloud=sized, lattice="")
            # The first takes the row of the cloud, which no instance draws any more.
            made[key] = instances.geometry[row] if counted[instances.geometry[row]] else len(geometries)
            counted[instances.geometry[row]] = False
            geometries[made[key] : made[key] + 1] = [sized]
        geometry_of[row] = made[key]
    return replace(scene, geometries=tuple(geometries), instances=replace(instances, geometry=geometry_of))


def _radius_plane(camera: Camera, world_from_object: np.ndarray, pixels: float) -> tuple[np.ndarray, float]:
    """(4,) float64, by which (p, 1) of a point of the object gives its radius in the object's units; and the radius at
    the least depth that is seen: what lies behind the camera has no less."""
    fx, fy, _, _ = camera.pixel_from_view()
    scale = abs(np.linalg.det(world_from_object[:3, :3])) ** (1 / 3)
    unit = pixels / np.sqrt(abs(fx * fy)) / (scale or 1.0)  # of one unit of depth, or of any in a parallel view
    depth = -(camera.view_from_world @ world_from_object)[2] if camera.perspective else np.array([0.0, 0.0, 0.0, 1.0])
    plane = np.nan_to_num(unit * depth, nan=0.0, posinf=0.0, neginf=0.0)
    return plane, float(unit * (camera.nearest if camera.perspective else 1.0))


def _is_medium(geometry: Geometry, table: MaterialTable) -> bool:
    """Whether the extinction of a cloud's points is that of a medium, whatever their radius."""
    assert geometry.cloud is not None
    media = [table.media[row] for row in geometry.cloud.material_rows() if row < len(table.media)]
    return geometry.extinction > 0 or any(medium is not None for medium in media)


def _sized(cloud: PointCloud, plane: np.ndarray, least: float, medium: bool) -> PointCloud:
    """The cloud with radii that a `_radius_plane` tells, at least `least`."""
    row, offset = plane[:3].astype(np.float32), np.float32(plane[3] + plane[:3] @ cloud.origin)
    radius = np.empty(len(cloud), np.float32)

    def fill(block: slice) -> None:
        np.maximum(cloud.position[block] @ row + offset, np.float32(least), out=radius[block])

    each_block(len(cloud), fill)
    if cloud.axis is not None and cloud.radii is not None:
        return replace(cloud, radii=np.minimum(cloud.radii, radius[:, None]))
    found = replace(cloud, radii=radius[:, None])
    if cloud.extinction is None or medium or cloud.radii is None:
        return found
    # A ray through the centre of a ball still meets its alpha: the optical depth stays.
    ratio = cloud.radii[:, 0] / radius
    extinction = cloud.extinction * (ratio if cloud.extinction.ndim == 1 else ratio[:, None])
    emission = None if cloud.emission is None else cloud.emission * ratio[:, None]
    return replace(found, extinction=extinction, emission=emission)
