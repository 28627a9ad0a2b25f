"""Chooses points or polygons for each mesh, and samples points as densely as a view needs them.

Sample positions on a mesh depend on its topology and an octave of spacing alone: views and frames share them, and a
mesh that deforms keeps them and does not shimmer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from ....core.lod.foliage import is_foliage
from ....core.lod.instances import visible_instances
from ....core.numeric.linear import largest_singular_value
from ....core.numeric.record import record
from ....core.scene.bounds import mesh_centre, triangles_ball, triangles_balls
from ....core.scene.cloud import PointCloud
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Geometry
from ....core.surface.appearance import digest, point_cloud
from ....core.surface.density import EXACT_INSTANCES, Parts, make_parts, required_spacing
from ....core.surface.evaluation import evaluate
from ....core.surface.sample_areas import sample_areas
from ....core.surface.sampling import choose_method, sample_mesh
from ....core.surface.spacing import MAX_SAMPLES, MOST_SAMPLES, limit_spacing, quantise_spacing
from ....core.surface.triangles import Measures, measure_triangles
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ..hierarchies import points_once_they_have_nodes
from ..layers import MANY_INSTANCES
from ..point_sets import PointSet
from ..view import View

# Of meshes whose instances are many, AUTO draws polygons where the typical triangle's edge spans more pixels than this.
POLYGON_PIXELS = 4.0
MAX_FOLIAGE_TRIANGLES = (
    1 << 21
)  # triangles of all instances of a mesh of leaves, which AUTO draws as polygons from any distance
MAX_EXACT_TRIANGLES = 4 << 20  # of all instances: so many are asked one by one what they need
MIN_TRIANGLES_FOR_PARTS = 1 << 14  # of one mesh: fewer are all looked at in no time
SHARED_CELLS = 128  # samples across a geometry whose instances are many: outlines grow by half a percent
COARSEST_OCTAVE = 6  # beyond it, the few samples that are left cost less than another cloud
VERTEX_PIXELS = 2.0  # vertices are samples enough where no edge spans more; with pictures on them, one sample a pixel


@record
class MeasuredMesh:
    """A mesh with valid triangles, and measurements of it that are cached for all views."""

    geometry: Geometry
    mesh: Mesh
    store: Store

    @property
    def sampling_key(self) -> tuple[str, str]:
        """A key of all that sample positions depend on: the topology (or the geometry's key), and the name."""
        return self.mesh.topology or self.geometry.key, self.geometry.name

    @property
    def typical_edge(self) -> float:
        """The side of a square of twice the mean area of the triangles, in object units."""
        return self._cached(Kind.TYPICAL_EDGE, lambda: _typical_edge(self.mesh))

    @property
    def ball(self) -> tuple[np.ndarray, float]:
        """The centre (3,) and radius, in object space, of a ball that contains the valid triangles."""
        return self._cached(Kind.BOUNDING_BALL, lambda: triangles_ball(self.mesh))

    @property
    def parts(self) -> Parts:
        """Parts of the mesh of nearby triangles, with bounds, by which the required spacing is found."""
        return self._cached(Kind.PARTS, lambda: make_parts(self.mesh))

    @property
    def measures(self) -> Measures:
        """Edge lengths and heights of the valid triangles."""
        return self._cached(Kind.MEASURES, lambda: measure_triangles(self.mesh))

    @property
    def is_foliage(self) -> bool:
        """Whether the mesh consists of leaves."""
        return self._cached(Kind.IS_FOLIAGE, lambda: is_foliage(self.mesh.position, self.mesh.triangles))

    def is_drawable_foliage(self, instances: int) -> bool:
        """Tells whether the mesh is foliage that, with this many `instances`, has few enough triangles for polygons."""
        return instances * len(self.mesh.triangles) <= MAX_FOLIAGE_TRIANGLES and self.is_foliage

    def _cached(self, kind: Kind, make: Callable[[], Any]) -> Any:
        return self.store.lookup(Key(kind, self.geometry.key), make)


def measured_mesh(view: View, geometry: Geometry) -> MeasuredMesh | None:
    """Returns the mesh of a geometry with its cached measurements; None if it has no triangles."""
    mesh = geometry.mesh
    return None if mesh is None or len(mesh.triangles) == 0 else MeasuredMesh(geometry, mesh, view.store)


def mesh_ball(mesh: Mesh, store: Store) -> tuple[np.ndarray, float]:
    """Returns the centre (3,) and radius, in object space, of a ball that contains the triangles of a mesh."""
    if len(mesh.triangles) == 0:
        return np.zeros(3), 0.0
    return store.lookup(Key(Kind.BOUNDING_BALL, mesh.key), lambda: triangles_ball(mesh))


def keep_mesh_balls(meshes: Sequence[Mesh], store: Store) -> None:
    """Measures the balls of all meshes, as `mesh_ball` does of one, at once."""
    some = [mesh for mesh in meshes if len(mesh.triangles)]
    keys = [Key(Kind.BOUNDING_BALL, mesh.key) for mesh in some]
    store.lookup_all(keys, lambda rows: triangles_balls([some[row] for row in rows]))


def _typical_edge(mesh: Mesh) -> float:
    a, b, c = mesh.position[mesh.triangles].astype(np.float64).transpose(1, 0, 2)
    return float(np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1).mean()))


def max_samples(tolerance: float) -> int:
    """Returns the most samples that one mesh may have: more at a finer `tolerance` (pixels), within memory."""
    return int(min(MAX_SAMPLES / min(tolerance, 1.0) ** 2, MOST_SAMPLES))


@record
class Primitives:
    """The points and polygons that instances of one geometry are drawn as; rows index these instances."""

    points: list[tuple[PointSet, np.ndarray]]  # each set with the rows (K,) of the instances that it is drawn for
    polygons: np.ndarray  # (P,) rows
    # By row, the parts that are polygons, ascending; absent: all.
    parts: dict[int, np.ndarray] = field(default_factory=dict)
    # By row, first index and count (R,) of the runs of points that are drawn; absent: all points.
    ranges: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    coarse: Mesh | None = None  # drawn as polygons in place of the mesh


def points_or_polygons(view: View, measured: MeasuredMesh, view_from_object: np.ndarray) -> Primitives:
    """Chooses points or polygons for each instance of a mesh as a whole.

    `view_from_object`: (I, 4, 4) float64.
    """
    rows = np.arange(len(view_from_object))
    found = _points_unless_polygons(view, measured, view_from_object)
    if found is not None:
        return Primitives(found, rows[:0])
    near = _too_near_for_points(view, measured, view_from_object)
    polygons, far = rows[near], rows[~near]
    if len(far) == 0:
        return Primitives([], polygons)
    # Instances that are not near are small enough on the screen to be points.
    found = _points_unless_polygons(view, measured, view_from_object[far], all_far=True)
    if found is None:
        return Primitives([], np.concatenate([polygons, far]))
    return Primitives([(points, far[some]) for points, some in found], polygons)


def points_of_instances(
    view: View, measured: MeasuredMesh, view_from_object: np.ndarray
) -> list[tuple[PointSet, np.ndarray]]:
    """Returns point sets for instances that are all drawn as points, each with the rows (K,) that it is drawn for.

    `view_from_object`: (I, 4, 4) float64. The list is empty if no triangle is in view.
    """
    needed = _needed_spacing(view, measured, view_from_object)
    if not np.isfinite(needed):  # bounding boxes overlap the picture, but no triangle does
        return []
    return _points_by_octave(view, measured, needed, view_from_object)


def _points_unless_polygons(
    view: View, measured: MeasuredMesh, view_from_object: np.ndarray, all_far: bool = False
) -> list[tuple[PointSet, np.ndarray]] | None:
    """Returns point sets with the rows that each is drawn for; None if the mesh is better drawn as polygons.

    `all_far`: the triangles of all instances are known to be small on the screen.
    """
    if is_polygons(view, measured.geometry):
        return None
    needed = _needed_spacing(view, measured, view_from_object)
    if not np.isfinite(needed):
        return []
    if measured.geometry.primitive == "AUTO":
        if not all_far and measured.typical_edge * view.settings.tolerance > POLYGON_PIXELS * needed:
            return None
        if measured.is_drawable_foliage(len(view_from_object)):
            return None
    return _points_by_octave(view, measured, needed, view_from_object)


def is_chosen_by_buffer(view: View, geometry: Geometry) -> bool:
    """Tells whether the visibility buffer chooses what a mesh is drawn as: polygons, which cost less there than points
    of as many pixels, or nodes far away."""
    return view.settings.technique == "VISIBILITY" and geometry.primitive == "AUTO"


def is_polygons(view: View, geometry: Geometry) -> bool:
    """Tells whether a mesh is drawn as polygons whatever the view is."""
    return is_chosen_by_buffer(view, geometry) or geometry.primitive == "POLYGONS"


def _too_near_for_points(view: View, measured: MeasuredMesh, view_from_object: np.ndarray) -> np.ndarray:
    """Returns (I,) bool: which instances may be so large on the screen that they are drawn as polygons."""
    if is_polygons(view, measured.geometry) or len(view_from_object) == 1 or not view.camera.perspective:
        return np.ones(len(view_from_object), bool)
    allowed = spacing_allowed_by_bounds(view, measured, view_from_object)
    near = measured.typical_edge * view.settings.tolerance > POLYGON_PIXELS * allowed
    return near & visible_instances(view_from_object, *measured.ball, view.camera)


# Density of points


def _needed_spacing(view: View, measured: MeasuredMesh, view_from_object: np.ndarray) -> float:
    """Returns the sample spacing, in object units, that instances need in this view; inf: none is in view."""
    parts = measured.parts if len(measured.mesh.triangles) >= MIN_TRIANGLES_FOR_PARTS else None
    return required_spacing(
        measured.mesh, view_from_object, view.camera, view.settings.tolerance, max_samples=None, parts=parts
    )


def spacing_allowed_by_bounds(view: View, measured: MeasuredMesh, view_from_object: np.ndarray) -> np.ndarray:
    """Returns (I,) the spacing, in object units, that suffices at the nearest point of each bounding sphere."""
    middle, reach = measured.ball
    scale = largest_singular_value(view_from_object[:, :3, :3])
    depth = -(view_from_object[:, 2, :3] @ middle + view_from_object[:, 2, 3]) - reach * scale
    focal = max(abs(f) for f in view.camera.pixel_from_view()[:2])
    depth = np.maximum(depth, view.camera.near) if view.camera.perspective else 1.0
    with np.errstate(all="ignore"):
        return depth * view.settings.tolerance / (focal * scale)


def _points_by_octave(
    view: View, measured: MeasuredMesh, needed: float, view_from_object: np.ndarray
) -> list[tuple[PointSet, np.ndarray]]:
    """Returns point sets at the spacing `needed`, or octaves coarser for instances that allow it, with their rows."""
    if len(view_from_object) >= MANY_INSTANCES:
        needed = min(needed, _coarsest_shared_spacing(measured))
    octave = _coarser_octaves(view, measured, needed, view_from_object)
    return [(_points_at_octave(view, measured, needed, int(n)), np.flatnonzero(octave == n)) for n in np.unique(octave)]


def _coarser_octaves(view: View, measured: MeasuredMesh, needed: float, view_from_object: np.ndarray) -> np.ndarray:
    """Returns (I,) int: by how many octaves each instance may be sampled more coarsely than `needed`."""
    if measured.geometry.spacing > 0 or not view.camera.perspective or len(view_from_object) == 1:
        return np.zeros(len(view_from_object), int)
    many = len(view_from_object) > EXACT_INSTANCES
    if not many and len(view_from_object) * len(measured.mesh.triangles) <= MAX_EXACT_TRIANGLES:
        allowed = np.array([_needed_spacing(view, measured, matrix) for matrix in view_from_object])
    else:
        allowed = spacing_allowed_by_bounds(view, measured, view_from_object)
    with np.errstate(all="ignore"):
        # Relative to the octave that `needed` is rounded to, so that the coarser ones round alike.
        coarser = np.floor(np.log2(allowed / quantise_spacing(needed)))
        # Each triangle has a sample, however coarse the spacing is.
        most = measured.typical_edge
        if len(view_from_object) >= MANY_INSTANCES:
            most = min(most, _coarsest_shared_spacing(measured))
        most = np.clip(np.ceil(np.log2(most / needed)), 0, COARSEST_OCTAVE)
    return np.clip(np.nan_to_num(coarser), 0, np.nan_to_num(most)).astype(int)


def _coarsest_shared_spacing(measured: MeasuredMesh) -> float:
    """Returns the coarsest spacing, in object units, at which a mesh with many instances is sampled.

    Outlines grow by about a quarter of the spacing; coarser nodes over finer samples do not grow them.
    """
    return 2 * measured.ball[1] / SHARED_CELLS


def _points_at_octave(view: View, measured: MeasuredMesh, needed: float, octave: int) -> PointSet:
    """Returns samples of a mesh `octave` octaves coarser than the spacing `needed`.

    In views that remember, samples are only ever refined: if an earlier view needed a finer spacing, it is that one.
    """
    geometry, mesh, sampling_key, store = measured.geometry, measured.mesh, measured.sampling_key, view.store
    spacing = geometry.spacing if geometry.spacing > 0 else needed
    asked = Key(Kind.FINEST_SPACING, sampling_key, spacing=geometry.spacing)
    known = store.finest_spacing(asked, np.inf) if view.remembers else np.inf
    measures = measured.measures
    if geometry.spacing <= 0 and spacing < known:
        octave_of, most = quantise_spacing(spacing), max_samples(view.settings.tolerance)
        spacing = store.lookup(
            Key(Kind.LIMITED_SPACING, sampling_key, spacing=octave_of, other=most),
            lambda: limit_spacing(mesh, octave_of, most, measures=measures),
        )
    spacing = (store.finest_spacing(asked, spacing) if view.remembers else spacing) * 2.0**octave
    needed *= 2.0**octave
    # Vertices may be farther apart than samples: their disks cover the mesh whatever length its edges have.
    look = digest(mesh, view.scene.materials)
    loose = max(spacing, needed * (1.0 if look else VERTEX_PIXELS))
    method = store.lookup(
        Key(Kind.SAMPLING_METHOD, sampling_key, spacing=loose), lambda: choose_method(mesh, loose, measures=measures)
    )
    if view.coarse and geometry.spacing <= 0 and method != "VERTICES":
        # Samples that are too fine for the time budget are drawn once nodes can replace them.
        own, name = quantise_spacing(needed), Key(Kind.MESH_POINTS, geometry.key, look, method, spacing)
        if own > spacing:
            found = points_once_they_have_nodes(
                view, name, lambda: _sampled_points(view, measured, method, spacing, loose)
            )
            return _sampled_points(view, measured, method, own, loose) if found is None else found
    return _sampled_points(view, measured, method, spacing, loose)


def fewest_samples(view: View, measured: MeasuredMesh) -> PointSet:
    """Returns the fewest samples that cover a mesh: its vertices, or one on each triangle."""
    spacing = quantise_spacing(2 * measured.measures.longest)
    return _sampled_points(
        view, measured, choose_method(measured.mesh, spacing, measures=measured.measures), spacing, spacing
    )


def _sampled_points(view: View, measured: MeasuredMesh, method: str, spacing: float, loose: float) -> PointSet:
    """Returns the points of a mesh that is sampled by `method` at `spacing`, in object units.

    `loose`: the spacing of samples at vertices, which may be larger.
    """
    geometry, mesh, sampling_key, store, table = (
        measured.geometry,
        measured.mesh,
        measured.sampling_key,
        view.store,
        view.scene.materials,
    )
    look = digest(mesh, table)
    spacing = 0.0 if method == "VERTICES" else spacing
    at = Key(Kind.SAMPLES, sampling_key, method=method, spacing=spacing)
    samples, origin = store.lookup(
        at,
        lambda: (sample_mesh(mesh, spacing or loose, method, measures=measured.measures), mesh_centre(mesh)),
    )
    key = Key(Kind.MESH_POINTS, geometry.key, look, method, spacing)

    def make() -> PointCloud:
        evaluated = evaluate(mesh, samples, origin)
        return point_cloud(mesh, samples, evaluated, table)

    family = Key(Kind.SHARED_HIERARCHY, sampling_key, look, method, spacing)
    return PointSet(key, store.lookup(key, make), family=family, samples=at)


def sample_area_function(view: View, geometry: Geometry, points: PointSet) -> Callable[[], np.ndarray] | None:
    """Returns a function that finds the area (N,) of the mesh around each sample, in object units squared.

    Returns None if the points are not samples of a whole mesh, or if the samples are no longer cached.
    """
    measured = measured_mesh(view, geometry)
    if measured is None or points.samples is None or points.samples not in view.store:
        return None
    samples, _ = view.store.lookup(points.samples, lambda: None)
    if len(samples) != len(points.cloud):
        return None
    return lambda: sample_areas(measured.mesh, samples)
