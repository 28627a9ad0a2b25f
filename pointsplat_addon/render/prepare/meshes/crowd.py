"""Cells of neighbouring instances: what a view cannot see of a crowd is left out before anything of it is prepared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.numeric.linear import all_finite
from ....core.numeric.morton import morton_codes, sorted_by_code
from ....core.numeric.record import record
from ....core.numeric.segments import ranges
from ....core.numeric.vectors import each_block
from ....core.scene.bounds import bounding_box
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Instances, Scene
from ....core.surface.appearance import passing
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ..layers import MANY_INSTANCES

FEWEST = 1 << 14  # instances of a scene: fewer are prepared in no time
IN_CELL = 64  # instances


@record
class Crowd:
    """The instances of opaque meshes that many instances show, N in C cells. Boxes are low and high corners."""

    row: np.ndarray  # (N,) int64: rows of the scene's instances, cell by cell
    first: np.ndarray  # (C + 1,) int64: where cells begin, and N
    cell_box: np.ndarray  # (C, 2, 3) float64, in the world
    cell_triangles: np.ndarray  # (C,) int64
    box: np.ndarray  # (G, 2, 3) float64, of meshes in object space
    triangles: np.ndarray  # (G,) int64, of meshes
    geometry: np.ndarray  # (I,) int32, of instances
    world_from_object: np.ndarray  # (I, 4, 4) float64

    @property
    def nbytes(self) -> int:
        return sum(array.nbytes for array in self.__dict__.values())

    def members(self, cells: np.ndarray) -> np.ndarray:
        """Returns the items, (n,) int64, of cells, (c,) int."""
        return ranges(self.first[cells], self.first[cells + 1] - self.first[cells])


def crowd_of(scene: Scene, store: Store) -> Crowd | None:
    """Returns the crowd of a valid scene; None if there is none."""
    instances = scene.instances
    if len(instances) < FEWEST:
        return None
    uses = np.bincount(instances.geometry, minlength=len(scene.geometries))
    meshes = {
        int(row): mesh
        for row in np.flatnonzero(uses >= MANY_INSTANCES)
        if (mesh := scene.geometries[row].mesh) is not None and passing(mesh, scene.materials) is None
    }
    if int(uses[list(meshes)].sum()) < FEWEST:
        return None
    # By the arrays themselves, which it keeps: reading all of them for a digest takes as long as all else in a view.
    content = tuple(scene.geometries[row].key for row in meshes)
    key = Key(Kind.CROWD, content, other=(id(instances.geometry), id(instances.world_from_object)))
    return store.lookup(key, lambda: _make(instances, len(scene.geometries), meshes))


def _make(instances: Instances, geometries: int, meshes: dict[int, Mesh]) -> Crowd:
    geometry, world_from_object = instances.geometry, instances.world_from_object
    box, triangles = np.zeros((geometries, 2, 3)), np.full(geometries, -1)
    for number, mesh in meshes.items():
        box[number], triangles[number] = bounding_box(mesh.position), len(mesh.triangles)
    middle, half = (box[:, 1] + box[:, 0]) / 2, (box[:, 1] - box[:, 0]) / 2
    row = np.flatnonzero((triangles[geometry] >= 0) & all_finite(world_from_object))
    centre, extent = np.empty((2, len(row), 3))

    def place(some: slice) -> None:
        matrix, shown = world_from_object[row[some]], geometry[row[some]]
        linear = matrix[:, :3, :3]
        centre[some] = (linear @ middle[shown][..., None])[..., 0] + matrix[:, :3, 3]
        extent[some] = (np.abs(linear) @ half[shown][..., None])[..., 0]

    each_block(len(row), place)
    order = sorted_by_code(morton_codes(centre.astype(np.float32))[0])[0]
    row, centre, extent = row[order], centre[order], extent[order]
    first = np.append(np.arange(0, len(row), IN_CELL), len(row))
    low, high = np.minimum.reduceat(centre - extent, first[:-1]), np.maximum.reduceat(centre + extent, first[:-1])
    of_cells = np.add.reduceat(triangles[geometry[row]], first[:-1])
    return Crowd(row, first, np.stack([low, high], axis=1), of_cells, box, triangles, geometry, world_from_object)


def with_seen(scene: Scene, crowd: Crowd, items: np.ndarray) -> Scene:
    """Returns a scene of whose crowd the camera sees some items, (n,) int, alone."""
    before = scene.instances.seen
    seen = np.ones(len(scene.instances), bool)
    seen[crowd.row] = False
    seen[crowd.row[items]] = True
    return replace(scene, instances=replace(scene.instances, seen=seen if before is None else seen & before))
