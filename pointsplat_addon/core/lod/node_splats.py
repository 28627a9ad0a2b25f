"""The points and the nodes of a hierarchy as one cloud of splats: what a device holds and a cut selects from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene.cloud import PointCloud
from ..splat.ellipsoids import splat_frames
from .hierarchy import GEOMETRY, NODE_ATTRIBUTES, Hierarchy
from .nodes.optics import drawn_radii


def points_and_nodes(hierarchy: Hierarchy) -> PointCloud:
    """The N points in tree order, then the M nodes, as one cloud: what a device is given once and a cut indexes.

    Opaque flat clouds get two half-axes, and an axis where their points are disks. Media and transmissive surfaces get
    three, for their nodes are ellipsoids. A cloud without normals stays a cloud of balls; its nodes have the radius of
    the major half-axis, or the root of the mean variance where they are transmissive. Attributes that only points have
    are zero for nodes.
    """
    cloud, drawn = hierarchy.cloud, drawn_radii(hierarchy.cloud, hierarchy.radii.T).T.astype(np.float32)
    arrays: dict[str, np.ndarray] = {"position": np.concatenate([cloud.position, hierarchy.center])}
    if cloud.normal is None:
        points = np.zeros(len(cloud), np.float32) if cloud.radii is None else cloud.radii[:, 0]
        arrays["radii"] = np.concatenate([points, drawn[:, 0]])[:, None]
    else:
        normal, axis, radii = (a.astype(np.float32).T for a in splat_frames(cloud, slice(None)))
        normal[~cloud.normal.any(axis=1)] = 0  # they stay balls
        given = 2 if cloud.radii is None else cloud.radii.shape[1]
        columns = 3 if cloud.extinction is not None or cloud.opacity is not None or given == 3 else 2
        arrays["normal"] = np.concatenate([normal, hierarchy.normal])
        arrays["axis"] = np.concatenate([axis, hierarchy.axis])
        arrays["radii"] = np.concatenate([radii, drawn])[:, :columns]
    for name, array in cloud.arrays().items():
        if name in NODE_ATTRIBUTES:
            arrays[name] = np.concatenate([array, getattr(hierarchy, name)])
        elif name not in GEOMETRY:
            arrays[name] = np.concatenate([array, np.zeros((len(hierarchy), *array.shape[1:]), array.dtype)])
    if hierarchy.disconnected is not None:
        _use_representatives(hierarchy, arrays)
    return replace(cloud, **arrays)


def _use_representatives(hierarchy: Hierarchy, arrays: dict[str, np.ndarray]) -> None:
    """Replace each disconnected node by one of its points, chosen at random by area and scaled to hide as much as all.

    Of foliage the mean normal says nothing, an ellipse around a whole node would let no light through, and the centres
    of nodes lie in rows. `arrays` are those of `points_and_nodes`, changed in place.
    """
    assert hierarchy.disconnected is not None
    assert hierarchy.section is not None
    nodes, tree = np.flatnonzero(hierarchy.disconnected), hierarchy.tree
    area = np.pi * np.prod(arrays["radii"][: len(hierarchy.cloud), :2].astype(np.float64), axis=1)
    below = np.append(0.0, np.cumsum(np.maximum(area, 1e-30)))
    first = tree.first_point[nodes]
    last = first + tree.point_count[nodes]
    chosen = np.random.default_rng(0).random(len(tree))[nodes]
    point = np.searchsorted(below, below[first] + chosen * (below[last] - below[first]), side="right") - 1
    point = np.clip(point, first, last - 1)
    grown = np.sqrt(hierarchy.section[nodes] / np.maximum(area[point], 1e-30))
    rows = len(hierarchy.cloud) + nodes
    for name in ("position", "normal", "axis", "radii"):
        arrays[name][rows] = arrays[name][point]
    arrays["radii"][rows] *= grown[:, None]
