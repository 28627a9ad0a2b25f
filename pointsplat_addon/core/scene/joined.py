"""Many small meshes as one: a scene may have thousands, and a call for each costs more than what it measures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..numeric.record import record
from ..numeric.segments import offsets
from .mesh import Mesh

SMALL = 1 << 12  # triangles, at most; calls for larger meshes cost little beside their arithmetic
TOGETHER = 1 << 16  # triangles, about: as many as the processor's caches hold


@record
class Joined:
    """The triangles of M meshes, of one after the other."""

    rows: list[int]  # which meshes
    position: np.ndarray  # (V, 3) float32
    triangles: np.ndarray  # (T, 3) int32, rows of position
    first_vertex: np.ndarray  # (M + 1,) int64: of each mesh
    first: np.ndarray  # (M + 1,) int64: triangle of each mesh

    @property
    def corners(self) -> np.ndarray:
        """(3T, 3) float32: positions of the corners."""
        return self.position.take(self.triangles.reshape(-1), axis=0)


def joined(meshes: Sequence[Mesh]) -> Iterator[Joined]:
    """Yields all meshes of at most SMALL triangles, but for those without any, about TOGETHER triangles at a time."""
    rows: list[int] = []
    held = 0
    for row, mesh in enumerate(meshes):
        if 0 < len(mesh.triangles) <= SMALL:
            rows.append(row)
            held += len(mesh.triangles)
        if rows and (held >= TOGETHER or row == len(meshes) - 1):
            yield _join(rows, [meshes[one] for one in rows])
            rows, held = [], 0


def _join(rows: list[int], meshes: list[Mesh]) -> Joined:
    vertices = offsets([len(mesh.position) for mesh in meshes])
    first = offsets([len(mesh.triangles) for mesh in meshes])
    triangles = np.concatenate([mesh.triangles for mesh in meshes])
    triangles += np.repeat(vertices[:-1], np.diff(first)).astype(triangles.dtype)[:, None]
    return Joined(rows, np.concatenate([mesh.position for mesh in meshes]), triangles, vertices, first)
