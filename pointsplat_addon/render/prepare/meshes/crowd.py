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
from ....core.scene.scene import Scene
from ....core.surface.appearance import passing
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ..layers import MANY_INSTANCES

FEWEST = 1 << 14  # instances of a scene: fewer are prepared in no time
IN_CELL = 64  # instances


@record
class Crowd:
    """The instances of opaque meshes that many instances show, N in C cells, with boxes, low and high corner, in the
    world."""

    row: np.ndarray  # (N,) int64: rows of the scene's instances, cell by cell
    first: np.ndarray  # (C + 1,) int64: where cells begin, and N
    box: np.ndarray  # (N, 2, 3) float64
    cell_box: np.ndarray  # (C, 2, 3) float64
    triangles: np.ndarray  # (N,) int64
    of: tuple[np.ndarray, ...]  # what it was made of

    @property
    def nbytes(self) -> int:
        arrays = (self.row, self.first, self.box, self.cell_box, self.triangles, *self.of)
        return sum(array.nbytes for array in arrays)

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
    of = instances.geometry, instances.world_from_object
    content = tuple(scene.geometries[row].key for row in meshes)
    key = Key(Kind.CROWD, content, other=(id(of[0]), id(of[1])))
    return store.lookup(key, lambda: _make(of, {row: (m.position, len(m.triangles)) for row, m in meshes.items()}))


def _make(of: tuple[np.ndarray, np.ndarray], meshes: dict[int, tuple[np.ndarray, int]]) -> Crowd:
    geometry, world_from_object = of
    middle, half = np.zeros((2, int(geometry.max()) + 1, 3))
    triangles, known = np.zeros(len(middle), np.int64), np.zeros(len(middle), bool)
    for row, (position, count) in meshes.items():
        low, high = bounding_box(position)
        middle[row], half[row], triangles[row], known[row] = (low + high) / 2, (high - low) / 2, count, True
    row = np.flatnonzero(known[geometry] & all_finite(world_from_object))
    box = np.empty((len(row), 2, 3))

    def place(some: slice) -> None:
        matrix, shown = world_from_object[row[some]], geometry[row[some]]
        linear = matrix[:, :3, :3]
        centre = np.einsum("iab,ib->ia", linear, middle[shown]) + matrix[:, :3, 3]
        extent = np.einsum("iab,ib->ia", np.abs(linear), half[shown])
        box[some, 0], box[some, 1] = centre - extent, centre + extent

    each_block(len(row), place)
    code, _ = morton_codes(box.mean(axis=1).astype(np.float32))
    order = sorted_by_code(code)[0]
    row, box = row[order], box[order]
    first = np.append(np.arange(0, len(row), IN_CELL), len(row))
    low, high = np.minimum.reduceat(box[:, 0], first[:-1]), np.maximum.reduceat(box[:, 1], first[:-1])
    return Crowd(row, first, box, np.stack([low, high], axis=1), triangles[geometry[row]], of)


def with_seen(scene: Scene, crowd: Crowd, items: np.ndarray) -> Scene:
    """Returns a scene of whose crowd the camera sees some items, (n,) int, alone."""
    before = scene.instances.seen
    seen = np.ones(len(scene.instances), bool)
    seen[crowd.row] = False
    seen[crowd.row[items]] = True
    return replace(scene, instances=replace(scene.instances, seen=seen if before is None else seen & before))
