"""What of a view is out of focus, as splats of one layer (core/defocus.py); what is in focus is drawn as always."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..core import ewa, pieces, sampling
from ..core.appearance import digest, point_cloud
from ..core.cloud import PointCloud, finite
from ..core.cut import forest, fully, largest_singular_value, select
from ..core.defocus import BLURRED, IN_FOCUS, Blur
from ..core.hierarchy import sum_up
from ..core.instances import joined
from ..core.scene import Camera, Geometry, Mesh, Scene
from .store import Layer, PointSet, Store

# A node covers no more than this of its ellipse, whatever lies in it: a square of its moments.
NODE_SHARE = 3 / np.pi


@dataclass(frozen=True, eq=False)
class Blurred(Layer):
    """Opaque splats that may be out of focus."""

    # By key of point_sets, what of its ellipse each splat covers: (N + M,) float32, points before nodes, or one number.
    shares: dict[int, np.ndarray | float] = field(default_factory=dict)


@dataclass
class Focus:
    """Sorts what a view draws into what is in focus and what is not."""

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

    def reaches(self, instance: np.ndarray, middle: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Of instances whose geometry lies in a ball in object space, which may be in focus somewhere, and which may be
        out of it."""
        matrix = self.view_from_object[instance]
        depth = -(matrix[:, 2, :3] @ middle + matrix[:, 2, 3])
        reach = radius * largest_singular_value(matrix[:, :3, :3])
        near = max(self.camera.near, 0.0)
        least, most = self.blur.bounds(np.maximum(depth - reach, near), np.maximum(depth + reach, near))
        return least < BLURRED, most > IN_FOCUS

    def add_points(self, instance: np.ndarray, points: PointSet, areas: Callable[[], np.ndarray] | None) -> None:
        """Points and their nodes. `areas`: (N,) what each point stands for; None: it is not known."""
        key = self._add(instance, points)
        made = self.store.lookup(("shares", areas is not None, *points.key), lambda: _shares(points, areas))
        self.shares[key] = made

    def add_mesh(self, instance: np.ndarray, geometry: Geometry, mesh: Mesh, ok: np.ndarray) -> None:
        """Triangles, cut for this view."""
        rows = np.flatnonzero(ok)
        origin, table = sampling.centre(mesh), self.scene.materials
        look = digest(mesh, table)
        for i in instance.tolist():
            matrix = self.view_from_object[i]
            seen = (
                matrix.tobytes(),
                self.camera.clip_from_view.tobytes(),
                self.camera.window,
                self.blur,
                self.tolerance,
            )
            key = ("pieces", geometry.key, look, *seen)

            def make(matrix: np.ndarray = matrix) -> PointCloud:
                samples = pieces.cut(mesh, rows, matrix, self.camera, self.tolerance, self.blur)
                return finite(point_cloud(mesh, samples, sampling.evaluate(mesh, samples, origin, ok), table))[0]

            points = PointSet(key, self.store.lookup(key, make))
            if len(points):
                self.shares[self._add(np.array([i]), points)] = float(pieces.SHARE)

    def _add(self, instance: np.ndarray, points: PointSet) -> int:
        key = len(self.sets)
        self.sets[key] = points
        self.set_of_instance[instance] = key
        return key

    def layer(self) -> Blurred:
        """All that was added, cut for this view."""
        bare = {key: points for key, points in self.sets.items() if points.hierarchy is None}
        counts = np.zeros(len(self.sets) + 1, np.int64)
        for key, points in bare.items():
            counts[key] = len(points.cloud)
        cuts = [fully(counts, self.set_of_instance)]
        trees = {key: points.hierarchy for key, points in self.sets.items() if points.hierarchy is not None}
        if trees:
            known = ("forest", *((key, self.sets[key].key) for key in trees))
            found = self.store.lookup(known, lambda: forest(trees))
            own = np.where(np.isin(self.set_of_instance, list(trees)), self.set_of_instance, -1)
            cuts.append(
                select(found, own, self.view_from_object, self.camera, self.tolerance, blur=self.blur, wanted="BLURRED")
            )
        return Blurred(self.sets, self.set_of_instance, joined(cuts), self.shares)


def _shares(points: PointSet, areas: Callable[[], np.ndarray] | None) -> np.ndarray | float:
    """What of its ellipse each splat of a set covers. Points of unknown area stand for the cell that their ellipse goes
    around; what stands apart covers all of itself; nodes what their points cover, as far as they lie side by side."""
    cloud, tree = points.cloud, points.hierarchy
    if cloud.radii is None:
        return 1.0
    radii = cloud.radii[:, : min(cloud.radii.shape[1], 2)].astype(np.float64)
    ellipse = np.pi * radii[:, 0] * radii[:, -1]
    area = ellipse * ewa.SHARE if areas is None else areas()
    if tree is not None:
        area = area[tree.order]
        ellipse = ellipse[tree.order]
    strewn = (tree.cloud if tree is not None else cloud).apart
    if strewn is not None:
        area = np.where(strewn, ellipse, area)
    share = area / np.maximum(ellipse, 1e-300)
    if tree is not None:
        below = sum_up(tree.tree, len(cloud), lambda which: area[None, which])[0]
        whole = np.pi * np.prod(tree.radii[:, :2].astype(np.float64), axis=1)
        nodes = np.minimum(below / np.maximum(whole, 1e-300), NODE_SHARE)
        if tree.apart is not None:
            nodes = np.where(tree.apart, 1.0, nodes)
        share = np.concatenate([share, nodes])
    return share.astype(np.float32)
