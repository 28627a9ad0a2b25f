"""Level of detail of volumes: voxels that a view shows smaller than its pixels are merged where they are even."""

from __future__ import annotations

import numpy as np

from ...core.numeric.linear import largest_singular_value
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud
from ...core.scene.scene import Geometry
from ...core.volume.detail import merged_where_even, voxel_edge
from ..cache.keys import Key, Kind
from .point_sets import PointSet
from .view import View

# Pixels, times a tolerance below 1: what wide splats of a lattice are uneven by, the pixel filter hides up to here.
WIDEST_BLOCK = 1.5
MIN_VOXELS = 1 << 14  # fewer are drawn in less time than they are merged
MOST_INSTANCES = 16  # whose voxels are looked at one by one; of more, all voxels are drawn
MOST_LEVELS = 10


def with_even_blocks(view: View, geometry: Geometry, points: PointSet, view_from_object: np.ndarray) -> PointSet:
    """Returns the points of a volume as coarse as the instances (I, 4, 4) that a view draws of it allow.

    In an interactive view they are its voxels, which have an octree there.
    """
    cloud, cells = geometry.cloud, geometry.cells
    assert cloud is not None
    assert cells is not None
    if view.interactive or len(cloud) < MIN_VOXELS or len(view_from_object) > MOST_INSTANCES:
        return points
    edge = widest_voxel(cloud, view_from_object, view.camera)
    wanted = WIDEST_BLOCK * min(view.settings.tolerance, 1.0)
    if not 2 * edge <= wanted:
        return points
    levels = min(int(np.log2(wanted / edge)), MOST_LEVELS) if edge > 0 else MOST_LEVELS
    key = Key(Kind.EVEN_BLOCKS, geometry.key, other=levels)
    return PointSet(key, view.store.lookup(key, lambda: merged_where_even(cloud, cells, levels)), is_lattice=True)


def widest_voxel(cloud: PointCloud, view_from_object: np.ndarray, camera: Camera) -> float:
    """Returns how many pixels long the edge of a volume's voxel is at most.

    Of voxels that instances (I, 4, 4) show in the whole picture, whichever part of it is drawn; 0 where they show none.
    """
    fx, fy, cx, cy = camera.pixel_from_view()
    edge = voxel_edge(cloud) * max(abs(fx), abs(fy)) * largest_singular_value(view_from_object[:, :3, :3])
    if not camera.perspective:
        return float(edge.max(initial=0.0))
    (x0, y0, _, _), (width, height) = camera.window, camera.resolution
    widest = 0.0
    for matrix, own in zip(view_from_object, edge.tolist(), strict=True):
        rows = matrix[:3, :3].astype(np.float32)
        place = (matrix[:3, :3] @ cloud.origin + matrix[:3, 3]).astype(np.float32)
        x, y, z = (cloud.position @ row + at for row, at in zip(rows, place, strict=True))
        with np.errstate(all="ignore"):
            # Rims of voxels reach into the picture from outside.
            column, row, rim = cx + x0 - fx * x / z, cy + y0 - fy * y / z, 2 * own / -z
            seen = (z < -camera.near) & (column > -rim) & (column < width + rim) & (row > -rim) & (row < height + rim)
        widest = max(widest, own / -float(z.max(where=seen, initial=-np.inf)))
    return widest
