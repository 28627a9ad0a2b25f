"""Splats of meshes that cast shadows: at vertices where these are dense enough for the tables, else at samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..lod.foliage import FOLIAGE_VERTICES, is_foliage
from ..material.graph import needs
from ..numeric.record import record
from ..numeric.vectors import blocks, cross, dot
from ..scene.bounds import mesh_centre
from ..scene.cloud import PointCloud
from ..scene.materials import MaterialTable
from ..scene.mesh import Mesh
from ..surface.appearance import graphs_of, passing, point_cloud
from ..surface.evaluation import Evaluated, evaluate
from ..surface.samples import Samples
from ..surface.sampling import choose_method, sample_mesh
from ..surface.spacing import limit_spacing
from ..surface.triangles import Measures, measure_triangles, used_vertices
from .casters import typical_radius

FEW_TRIANGLES = 1 << 17  # triangles: fewer are always sampled
DENSE_EDGE = 3.0  # spacings: longest edge of triangles that splats at the vertices may replace
SURFACE_POINTS = 4096  # points that represent a mesh
# Additive recurrence in two dimensions (Roberts 2018).
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])


@record
class MeshExtents:
    """The bounding box of a mesh, and the areas and longest edges of its triangles."""

    low: np.ndarray  # (3,) float64, corners of the box, object space
    high: np.ndarray  # (3,) float64
    area: np.ndarray  # (T,) float64
    longest: np.ndarray  # (T,) float32, longest edges

    @property
    def nbytes(self) -> int:
        return self.area.nbytes + self.longest.nbytes

    @property
    def size(self) -> float:
        """The total area of the mesh, in object units^2."""
        return float(self.area.sum())


def mesh_extents(mesh: Mesh) -> MeshExtents:
    """Measures all triangles of a mesh."""
    count = len(mesh.triangles)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    area, longest = np.zeros(count), np.zeros(count, np.float32)
    for some in blocks(count):
        a, b, c = (mesh.position.take(v, axis=0).T.astype(np.float64) for v in mesh.triangles[some].T)
        low = np.minimum(low, np.minimum(np.minimum(a, b), c).min(axis=1))
        high = np.maximum(high, np.maximum(np.maximum(a, b), c).max(axis=1))
        edges = b - a, c - b, a - c
        normal = cross(edges[0], edges[2])
        area[some] = np.sqrt(dot(normal, normal)) / 2
        longest[some] = np.sqrt(np.maximum(np.maximum(*(dot(e, e) for e in edges[:2])), dot(edges[2], edges[2])))
    return MeshExtents(low, high, area, longest)


def surface_points(mesh: Mesh, extents: MeshExtents) -> np.ndarray:
    """(SURFACE_POINTS, 3) float64: points spread evenly over a mesh, in object space; the origin alone if it is
    empty."""
    ends = np.cumsum(extents.area)
    if len(ends) == 0 or ends[-1] == 0:
        return np.zeros((1, 3))
    triangle = np.searchsorted(ends, (np.arange(SURFACE_POINTS) + 0.5) / SURFACE_POINTS * ends[-1])
    corners = mesh.position[mesh.triangles[np.minimum(triangle, len(ends) - 1)]].astype(np.float64)
    weights = (0.5 + np.arange(SURFACE_POINTS)[:, None] * PLASTIC) % 1
    # The unit square, folded over its diagonal.
    weights = np.where(weights.sum(axis=1, keepdims=True) > 1, 1 - weights, weights)
    return corners[:, 0] + np.einsum("nk,nkc->nc", weights, corners[:, 1:] - corners[:, :1])


def mesh_is_foliage(mesh: Mesh, extents: MeshExtents) -> bool:
    """Whether a mesh consists of leaves or blades: of triangles with open edges."""
    count = len(mesh.triangles)
    return bool(len(mesh.position) >= FOLIAGE_VERTICES * count) and is_foliage(mesh.position, mesh.triangles)


def _fit_disks_to_area(evaluated: Evaluated, samples: Samples, area: np.ndarray) -> Evaluated:
    """Scales the disks of each triangle such that their areas add up to at most its `area` (T,).

    Otherwise they would extend beyond the edges of leaves and hide more than the leaves do.
    """
    radii = evaluated.radii
    if samples.ellipse is None:
        return evaluated
    own = np.pi * radii[:, 0].astype(np.float64) * radii[:, min(1, radii.shape[1] - 1)]
    share = np.minimum(area / np.maximum(np.bincount(samples.triangle, own, len(area)), 1e-300), 1)
    return replace(evaluated, radii=radii * np.sqrt(share).astype(np.float32).take(samples.triangle)[:, None])


def caster_clouds(
    mesh: Mesh, extents: MeshExtents, spacing: float, table: MaterialTable, foliage: bool | None = None
) -> list[PointCloud]:
    """The splats of a mesh for tables that resolve `spacing` (object units), as one or two clouds. foliage: the result
    of `mesh_is_foliage` if it is known.

    Where triangles are many and small, their vertices are taken: half as many splats, no wider than samples may be.
    """
    if not _needs_normals(mesh, table):
        mesh = replace(mesh, vertex_normal=None, corner_normal=None)  # splats cast by their planes alone
    if mesh_is_foliage(mesh, extents) if foliage is None else foliage:
        # As fine as most leaves, for half as many samples more: leaves that tables resolve cast their own shadows.
        finest = max(float(np.median(extents.longest)), np.sqrt(2 * extents.size / len(mesh.triangles)))
        measures = measure_triangles(mesh)
        spacing = limit_spacing(mesh, min(spacing, finest), measures=measures)
        return [_splats(mesh, "AREA", None, spacing, table, extents.area, measures)]
    dense = extents.longest <= DENSE_EDGE * spacing
    # A vertex of a translucent mesh stands for all the triangles around it.
    if np.count_nonzero(dense) < FEW_TRIANGLES or (passing(mesh, table) is not None and not dense.all()):
        spacing = limit_spacing(mesh, spacing)
        return [_splats(mesh, choose_method(mesh, spacing), None, spacing, table)]
    if np.count_nonzero(used_vertices(mesh, dense)) <= np.count_nonzero(dense):
        found = _splats(mesh, "VERTICES", dense, spacing, table)
        assert found.radii is not None
        if typical_radius(found.radii[:, 0]) <= typical_radius(extents.longest[dense]) / np.sqrt(3):
            rest = ~dense
            if not rest.any():
                return [found]
            spacing = limit_spacing(mesh, spacing, which=rest)
            return [found, _splats(mesh, "AREA", rest, spacing, table)]
    return [_splats(mesh, "AREA", None, limit_spacing(mesh, spacing), table)]


def _needs_normals(mesh: Mesh, table: MaterialTable) -> bool:
    """Whether the transmittance of some material depends on normals."""
    return any(wanted.normal or wanted.tangent for wanted in map(needs, graphs_of(mesh, table).values()))


def _splats(
    mesh: Mesh,
    method: str,
    which: np.ndarray | None,
    spacing: float,
    table: MaterialTable,
    area: np.ndarray | None = None,
    measures: Measures | None = None,
) -> PointCloud:
    """The splats of the triangles `which` (T,) bool; None: all. measures: of these triangles, if they are known; area
    (T,): of all triangles, if the mesh is foliage."""
    samples = sample_mesh(mesh, spacing, method, which, measures)
    evaluated = evaluate(mesh, samples, mesh_centre(mesh), which)
    if area is not None and passing(mesh, table) is None:
        evaluated = _fit_disks_to_area(evaluated, samples, area)  # before what is cut out is gone
    return point_cloud(mesh, samples, evaluated, table)
