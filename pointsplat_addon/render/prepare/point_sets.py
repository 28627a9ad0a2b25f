"""Point sets and layers of them, the bounds of a set, and the size of its splats on the screen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.lod.balls.covered import WIDER
from ...core.lod.cut import Cut
from ...core.lod.foliage import disconnected_splats
from ...core.lod.hierarchy import Hierarchy
from ...core.lod.instances import visible_instances
from ...core.numeric.linear import largest_singular_value
from ...core.numeric.record import record
from ...core.scene.bounds import cloud_ball
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud, coherent
from ...core.scene.scene import Geometry
from ...core.strand.projection import NEAREST
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .view import View


@record
class PointSet:
    """Splats of one geometry: its points, or points and the nodes over them."""

    key: Key
    cloud: PointCloud
    hierarchy: Hierarchy | None = None
    family: Key | None = None  # shared with other poses or colourings of the points, which can reuse the hierarchy
    samples: Key | None = None  # of the mesh samples that the points were made of; None: not of a whole mesh
    is_lattice: bool = False  # the points are voxels: only their attributes differ within the family
    shape: np.ndarray | None = None  # (N, 8) float32, BallTree.shape: the points are nodes that stand for several balls
    balls: PointSet | None = None  # for which these nodes stand

    def __len__(self) -> int:
        return len(self.cloud) + (len(self.hierarchy) if self.hierarchy else 0)


@record
class Layer:
    """Points that one view draws together."""

    # By geometry row; coarser ones of the same geometry, for instances farther away, follow after all rows.
    point_sets: dict[int, PointSet]
    set_of_instance: np.ndarray  # (I,) int: key of point_sets; -1: not drawn as points
    cut: Cut


def coherent_with_foliage(cloud: PointCloud) -> PointCloud:
    """Returns a cloud in spatially coherent order, with foliage (disconnected splats) marked."""
    cloud = coherent(cloud)
    disconnected = disconnected_splats(cloud)
    return cloud if disconnected is None else replace(cloud, disconnected=disconnected)


def cloud_points(view: View, geometry: Geometry, cloud: PointCloud) -> PointSet:
    """Returns the point set of a geometry that is a cloud."""
    if geometry.streamed is not None or geometry.node_shape is not None:
        # Pages are coherent, and what is drawn of them changes with the view.
        shape = geometry.node_shape if view.settings.technique == "VISIBILITY" else None
        return PointSet(Key(Kind.CLOUD, geometry.key), cloud, shape=shape)
    points = view.store.lookup(Key(Kind.COHERENT_POINTS, geometry.key), lambda: coherent_with_foliage(cloud))
    family = None
    if geometry.lattice:
        family = Key(Kind.SHARED_HIERARCHY, geometry.lattice, other=(len(points), *points.arrays()))
    return PointSet(Key(Kind.CLOUD, geometry.key), points, family=family, is_lattice=family is not None)


def point_counts(point_sets: dict[int, PointSet]) -> np.ndarray:
    """Returns (K + 1,) int64: the number of points of each set by its key; the last one, which -1 indexes, is 0."""
    found = np.zeros(max(point_sets, default=-1) + 2, np.int64)
    for key, points in point_sets.items():
        found[key] = len(points.cloud)
    return found


def set_ball(points: PointSet, store: Store) -> tuple[np.ndarray, float, float]:
    """Returns the centre (3,) of a set, the largest distance of a point from it, and the largest radius of a splat.

    All are in object space.
    """
    points = points.balls or points

    def measure() -> tuple[np.ndarray, float, float]:
        middle, reach, radius = cloud_ball(points.cloud)
        if points.shape is not None:  # no half-axis is longer than the root of the sum of their squares
            longest = float(np.sqrt(points.shape[:, [0, 3, 5]].sum(axis=1).max(initial=0.0)))
            radius = max(radius, longest * WIDER**0.5)
        return middle, reach, radius

    return store.lookup(Key(Kind.BALL_AND_RADIUS, points.key), measure)


def typical_diameter(points: PointSet, view_from_object: np.ndarray, camera: Camera, store: Store) -> np.ndarray:
    """Returns (I,) the diameter, in pixels, of a typical splat at the centre of each instance, (I, 4, 4)."""
    cloud = points.cloud
    radius = store.lookup(Key(Kind.TYPICAL_RADIUS, points.key), lambda: _typical_radius(cloud))
    middle, _, _ = set_ball(points, store)
    linear = view_from_object[:, :3, :3]
    depth = np.maximum(-(linear @ middle + view_from_object[:, :3, 3])[:, 2], camera.near)
    scale = np.abs(np.linalg.det(linear)) ** (1 / 3) * abs(camera.pixel_from_view()[0])
    return 2 * radius * scale / (depth if camera.perspective else 1.0)


def _typical_radius(cloud: PointCloud) -> float:
    if cloud.radii is None or len(cloud) == 0:
        return 0.0
    step = max(1, len(cloud) // 4096)
    return float(np.median(cloud.radii[::step, 0]))


def largest_radius(
    point_sets: dict[int, PointSet],
    set_of_instance: np.ndarray,
    view_from_object: np.ndarray,
    camera: Camera,
    store: Store,
) -> float:
    """Returns an upper bound of the radius of all visible splats, in pixels.

    It is that of each instance's largest splat at the instance's nearest depth. Instances out of view do not count:
    with one beside the eye, the pyramid would be so deep that it closes gaps between objects.
    """
    largest = 0.0
    focal = max(abs(f) for f in camera.pixel_from_view()[:2])
    for key, points in point_sets.items():
        matrix = view_from_object[set_of_instance == key]
        middle, reach, radius = set_ball(points, store)
        matrix = matrix[visible_instances(matrix, middle, reach + radius, camera)]
        scale = largest_singular_value(matrix[:, :3, :3])
        depth = 1.0
        if camera.perspective:
            depth = np.maximum(
                -(matrix[:, 2, :3] @ middle + matrix[:, 2, 3]) - reach * scale, max(camera.near, NEAREST)
            )
        largest = max(largest, float((radius * scale * focal / depth).max(initial=0.0)))
    return largest
