"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene.cloud import PointCloud
from ..splat.ellipsoids import splat_frames
from .hierarchy import Hierarchy
from .nodes.optics import drawn_radii
from .nodes.rows import AVERAGED


def points_and_nodes(hierarchy: Hierarchy) -> PointCloud:
    """The N points in tree order, then the M nodes, as one cloud: what a device is given once and a cut indexes.

    Flat clouds keep two half-axes (and gain axis and radii columns where their points are disks); media have three, and
    so do shells, whose nodes are ellipsoids that are equally deep in the middle from all sides. A cloud without normals
    stays one of balls, whose nodes have the radius of the major half-axis, or of the variance's mean where light passes
    through them.
    """
    cloud, drawn = hierarchy.cloud, drawn_radii(hierarchy.cloud, hierarchy.radii.T).T.astype(np.float32)
    arrays: dict[str, np.ndarray] = {"position": np.concatenate([cloud.position, hierarchy.center])}
    if cloud.normal is None:
        points = np.zeros(len(cloud), np.float32) if cloud.radii is None else cloud.radii[:, 0]
        arrays["radii"] = np.concatenate([points, drawn[:, 0]])[:, None]
    else:
        normal, axis, radii = (a.astype(np.float32).T for a in splat_frames(cloud, slice(None)))
        given = 2 if cloud.radii is None else cloud.radii.shape[1]
        columns = 3 if cloud.extinction is not None or cloud.opacity is not None or given == 3 else 2
        arrays["normal"] = np.concatenate([normal, hierarchy.normal])
        arrays["axis"] = np.concatenate([axis, hierarchy.axis])
        arrays["radii"] = np.concatenate([radii, drawn])[:, :columns]
    for name in (*AVERAGED, "material", "kernel", "apart"):
        array = getattr(cloud, name)
        if array is not None:
            arrays[name] = np.concatenate([array, getattr(hierarchy, name)])
    if hierarchy.apart is not None:
        _use_representatives(hierarchy, arrays)
    return replace(cloud, **arrays)


def _use_representatives(hierarchy: Hierarchy, arrays: dict[str, np.ndarray]) -> None:
    """For nodes whose splats stand apart, one of these, drawn by lot, as large as to hide as much as all of them: means
    of normals say nothing of leaves, no light passes through ellipses of whole nodes, and the middles of nodes lie in
    rows, one behind the other."""
    assert hierarchy.apart is not None
    assert hierarchy.section is not None
    nodes, tree = np.flatnonzero(hierarchy.apart), hierarchy.tree
    area = np.pi * np.prod(arrays["radii"][: len(hierarchy.cloud), :2].astype(np.float64), axis=1)
    below = np.append(0.0, np.cumsum(np.maximum(area, 1e-30)))
    first = tree.first_point[nodes]
    last = first + tree.point_count[nodes]
    lot = np.random.default_rng(0).random(len(tree))[nodes]
    of = np.searchsorted(below, below[first] + lot * (below[last] - below[first]), side="right") - 1
    of = np.clip(of, first, last - 1)
    grown = np.sqrt(hierarchy.section[nodes] / np.maximum(area[of], 1e-30))
    rows = len(hierarchy.cloud) + nodes
    for name in ("position", "normal", "axis", "radii"):
        arrays[name][rows] = arrays[name][of]
    arrays["radii"][rows] *= grown[:, None]
