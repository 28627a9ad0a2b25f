"""Sorts primitives of a view by focus: those out of focus become splats of one layer (core/splat/blur.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...core.lens import dicing
from ...core.lens.strand_splats import RECTANGLE_SHARE, dice_strands, may_be_in_focus
from ...core.lod.area_share import area_shares
from ...core.lod.cut import cut_of_all_points, select_cut
from ...core.lod.instances import joined_cuts
from ...core.lod.node_table import node_table
from ...core.numeric.linear import largest_singular_value
from ...core.numeric.record import record
from ...core.scene.bounds import mesh_centre
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Scene
from ...core.scene.strands import Strands
from ...core.splat.blur import IN_FOCUS, OUT_OF_FOCUS, Blur
from ...core.strand.levels import StrandLevels
from ...core.strand.segments import Segments
from ...core.surface.appearance import digest, point_cloud, shown_by
from ...core.surface.evaluation import evaluate
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .point_sets import Layer, PointSet

# Sizes of patches that light passes, over those of opaque ones. A sum of kernels that is almost whole is taken for
# whole where it hides all; of what is seen through, each percent shows.
SEEN_THROUGH = 0.7


@record
class OutOfFocusLayer(Layer):
    """Opaque splats that may be out of focus, with the fraction of its ellipse that each covers."""

    # By key of point_sets, the covered fraction of each splat's ellipse: (N + M,) float32, points before nodes, or one.
    shares: dict[int, np.ndarray | float] = field(default_factory=dict)


@dataclass
class FocusSorter:
    """Sorts the primitives of a view by focus, and collects those that may be out of focus as splats."""

    scene: Scene
    camera: Camera
    blur: Blur
    tolerance: float
    store: Store
    view_from_object: np.ndarray  # (I, 4, 4) float64
    sets: dict[int, PointSet] = field(default_factory=dict)
    shares: dict[int, np.ndarray | float] = field(default_factory=dict)
    set_of_instance: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.set_of_instance = np.full(len(self.view_from_object), -1)

    def in_and_out_of_focus(
        self, instance: np.ndarray, middle: np.ndarray, radius: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns which instances may be in focus somewhere, and which may be out of focus somewhere: both (I,) bool.

        Their geometry lies in a ball with the centre `middle` (3,) and `radius` in object space.
        """
        matrix = self.view_from_object[instance]
        depth = -(matrix[:, 2, :3] @ middle + matrix[:, 2, 3])
        reach = radius * largest_singular_value(matrix[:, :3, :3])
        near = self.camera.nearest
        least, most = self.blur.radius_range(np.maximum(depth - reach, near), np.maximum(depth + reach, near))
        return least < OUT_OF_FOCUS, most > IN_FOCUS

    def add_points(self, instance: np.ndarray, points: PointSet, areas: Callable[[], np.ndarray] | None) -> None:
        """Adds points and their nodes, drawn by the instances (K,) int.

        `areas` returns the area (N,) that each point samples, in object units squared; None: it is unknown.
        """
        key = self._add(instance, points)
        made = self.store.lookup(
            Key(Kind.AREA_SHARES, points.key, other=areas is not None),
            lambda: area_shares(points.hierarchy or points.cloud, areas),
        )
        self.shares[key] = made

    def add_balls(self, instance: np.ndarray, points: PointSet) -> None:
        """Adds balls that are drawn one by one, diced for each of the instances (K,) int."""
        for i in instance.tolist():
            matrix = self.view_from_object[i]
            key = Key(Kind.DICED, points.key, other=self._view_key(matrix))

            def make(matrix: np.ndarray = matrix) -> PointCloud:
                return dicing.dice_balls(points.cloud, matrix, self.camera, self.tolerance, self.blur)

            self._add_diced(i, PointSet(key, self.store.lookup(key, make)), dicing.DISK_SHARE)

    def add_mesh(self, instance: np.ndarray, geometry: Geometry, mesh: Mesh) -> None:
        """Adds the triangles of a mesh, diced for each of the instances (K,) int in this view."""
        for i in instance.tolist():
            self._add_diced(i, self.diced(i, geometry, mesh), dicing.TRIANGLE_SHARE)

    def diced(self, instance: int, geometry: Geometry, mesh: Mesh, seen_through: bool = False) -> PointSet:
        """Returns the triangles of a mesh, diced for one instance in this view. `seen_through`: light passes them; they
        are all splats then, in focus or not."""
        rows, origin, table = np.arange(len(mesh.triangles)), mesh_centre(mesh), self.scene.materials
        matrix, own = self.view_from_object[instance], shown_by(mesh, self.scene.instances, instance)
        key = Key(Kind.DICED, geometry.key, digest(own, table), other=(seen_through, *self._view_key(matrix)))
        size = SEEN_THROUGH if seen_through else 1.0
        finest, blur = size * self.tolerance, replace(self.blur, node=size * self.blur.node)

        def make() -> PointCloud:
            samples = dicing.dice_triangles(own, rows, matrix, self.camera, finest, blur, seen_through)
            samples = replace(samples, eye=self.camera)
            return point_cloud(own, samples, evaluate(own, samples, origin), table)

        return PointSet(key, self.store.lookup(key, make))

    def add_strands(self, geometry: Geometry, strands: Strands, levels: StrandLevels, segments: Segments) -> Segments:
        """Adds segments that may be out of focus, diced for this view; returns those that may be in focus."""
        kept = np.zeros(len(segments), bool)
        for i in np.unique(segments.instance).tolist():
            mine = np.flatnonzero(segments.instance == i)
            ends, matrix = segments.ends[mine], self.view_from_object[i]
            kept[mine] = may_be_in_focus(levels, ends, matrix, self.camera, self.blur)
            key = Key(Kind.DICED, geometry.key, other=self._view_key(matrix))

            def make(ends: np.ndarray = ends, matrix: np.ndarray = matrix) -> PointCloud:
                return dice_strands(levels, strands, ends, matrix, self.camera, self.tolerance, self.blur)

            self._add_diced(i, PointSet(key, self.store.lookup(key, make)), RECTANGLE_SHARE)
        return segments if kept.all() else segments.take(np.flatnonzero(kept))

    def _view_key(self, matrix: np.ndarray) -> tuple:
        """Returns the properties of the view that an instance's diced splats depend on; `matrix`: view from object."""
        camera = self.camera
        seen = camera.view_from_world.tobytes(), camera.clip_from_view.tobytes()
        return matrix.tobytes(), *seen, camera.window, self.blur, self.tolerance

    def _add_diced(self, instance: int, points: PointSet, share: float) -> None:
        """Adds splats that were diced for this view, each of which covers `share` of its ellipse."""
        if len(points):
            self.shares[self._add(np.array([instance]), points)] = float(share)

    def _add(self, instance: np.ndarray, points: PointSet) -> int:
        """Adds a point set, drawn by the instances (K,) int, and returns its key."""
        key = len(self.sets)
        self.sets[key] = points
        self.set_of_instance[instance] = key
        return key

    def layer(self) -> OutOfFocusLayer:
        """Returns all splats that were added, as one layer, cut for this view."""
        bare = {key: points for key, points in self.sets.items() if points.hierarchy is None}
        counts = np.zeros(len(self.sets) + 1, np.int64)
        for key, points in bare.items():
            counts[key] = len(points.cloud)
        cuts = [cut_of_all_points(counts, self.set_of_instance)]
        trees = {key: points.hierarchy for key, points in self.sets.items() if points.hierarchy is not None}
        if trees:
            known = Key(Kind.FOREST, tuple((key, self.sets[key].key) for key in trees))
            found = self.store.lookup(known, lambda: node_table(trees))
            own = np.where(np.isin(self.set_of_instance, list(trees)), self.set_of_instance, -1)
            cuts.append(
                select_cut(
                    found, own, self.view_from_object, self.camera, self.tolerance, blur=self.blur, wanted="BLURRED"
                )
            )
        return OutOfFocusLayer(self.sets, self.set_of_instance, joined_cuts(cuts), self.shares)
