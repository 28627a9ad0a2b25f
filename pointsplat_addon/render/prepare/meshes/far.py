"""Nodes in place of the triangles of instances so far away that many of these fall into a pixel.

Leaves stay triangles: nodes are lit by the mean of normals, which is brighter than leaves that are turned every way.
All nodes of one size are one point set, and each instance draws the set whose nodes are small enough where it is
nearest: what a view draws grows with its pixels, not with the triangles of what it shows.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.lod.nodes.surface import surface_nodes
from ....core.scene.bounds import mesh_centre
from ....core.scene.cloud import PointCloud
from ....core.surface.appearance import digest, passing, point_cloud
from ....core.surface.evaluation import evaluate
from ....core.surface.sample_areas import sample_areas
from ....core.surface.sampling import sample_mesh
from ...cache.keys import Key, Kind
from ..hierarchies import with_material_constants
from ..layers import MANY_INSTANCES
from ..point_sets import PointSet
from ..view import View
from .points import MeasuredMesh, spacing_allowed_by_bounds

NODE_EDGE = 1.0  # of the tolerance: the cells of nodes, at most
SIZES = 2  # of nodes in an octave
COARSEST = 4  # cells along the diameter of a mesh, at least
TRIANGLES_PER_NODE = 8.0  # of a mesh: with fewer, nodes save too little for how much more they err
NODES_PER_CELL = 1.5  # of the area of a mesh: a first guess at how many nodes it has
SAMPLES_PER_CELL = 3.0  # along its edge
FEWEST_TRIANGLES = 1 << 22  # of all instances of a mesh: fewer are drawn in no time


def far_nodes(
    view: View, measured: MeasuredMesh, view_from_object: np.ndarray
) -> tuple[list[tuple[PointSet, np.ndarray]], np.ndarray]:
    """Returns nodes, each set with the rows (K,) of the instances that it is drawn for, and the rows of the rest.

    `view_from_object`: (I, 4, 4) float64.
    """
    rows, triangles = np.arange(len(view_from_object)), len(measured.mesh.triangles)
    if view.blur is not None or len(rows) * triangles < FEWEST_TRIANGLES:
        return [], rows
    if passing(measured.mesh, view.scene.materials) is not None or measured.is_foliage or measured.mesh.objects:
        return [], rows
    diameter = 2 * measured.ball[1]
    with np.errstate(all="ignore"):
        edge = NODE_EDGE * spacing_allowed_by_bounds(view, measured, view_from_object)
        step = np.ceil(SIZES * np.log2(diameter / edge))
    guess = triangles / (TRIANGLES_PER_NODE * NODES_PER_CELL) * diameter**2 / max(measured.measures.area, 1e-300)
    finest = SIZES * 0.5 * math.log2(max(guess, 1e-300))
    step = np.nan_to_num(step, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    step = np.maximum(step, SIZES * math.log2(COARSEST))
    found = []
    for one in range(int(SIZES * math.log2(COARSEST)), math.floor(finest) + 1):
        some = np.flatnonzero(step == one)
        if 0 < len(some) < MANY_INSTANCES:
            step[some] += 1  # nodes of one more size would cost more than finer ones
            continue
        if len(some) == 0:
            continue
        view.check()
        points = _nodes(view, measured, diameter * 2.0 ** (-one / SIZES))
        if len(points.cloud) == 0 or TRIANGLES_PER_NODE * len(points.cloud) > triangles:
            break
        found.append((points, some))
    rest = np.ones(len(rows), bool)
    for _, some in found:
        rest[some] = False
    return found, rows[rest]


def _nodes(view: View, measured: MeasuredMesh, edge: float) -> PointSet:
    """Returns the nodes of a mesh over cells of one edge, in object units."""
    mesh, table = measured.mesh, view.scene.materials
    look, origin = digest(mesh, table), mesh_centre(mesh)
    spacing = edge / SAMPLES_PER_CELL
    constants = (table.base_color, table.roughness, table.metallic, table.emission)
    held = tuple(values[list(mesh.materials)].tobytes() for values in constants)
    key = Key(Kind.FAR_NODES, measured.geometry.key, look, spacing=edge, other=held)

    def make() -> PointCloud:
        samples = sample_mesh(mesh, spacing, "AREA", measures=measured.measures)
        area = sample_areas(mesh, samples).astype(np.float32)
        cloud = point_cloud(mesh, samples, evaluate(mesh, samples, origin), table, area)
        points = with_material_constants(PointSet(key, cloud), table, view.store).cloud
        assert points.value is not None
        return surface_nodes(points, points.value.astype(np.float64), edge) if len(points) else points

    return PointSet(key, view.store.lookup(key, make))
