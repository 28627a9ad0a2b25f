"""Triangles of a mesh, and their corners and edges as rows of coordinates; many small meshes as one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace

import numpy as np

from ..numeric.record import record
from ..numeric.segments import offsets
from ..numeric.vectors import dot

SMALLEST, LARGEST = 1e-18, 1e18  # edge length and coordinate whose squares float32 still holds
# A scene may have thousands of meshes: a call for each costs more than what it measures, but of larger ones
FEW_TRIANGLES = 1 << 12
TOGETHER = 1 << 16  # triangles that are joined, about: as many as the processor's caches hold


@record
class Mesh:
    """Triangles of one evaluated mesh, in object space. Per-corner attributes are (T, 3, ...)."""

    key: str  # content key: equal keys mean equal arrays
    name: str  # the object's name, for messages
    position: np.ndarray  # (V, 3) float32
    triangles: np.ndarray  # (T, 3) int32, rows of position
    vertex_normal: np.ndarray | None = None  # (V, 3) float32; set when every corner of a vertex shares it
    corner_normal: np.ndarray | None = None  # (T, 3, 3) float32; set otherwise
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # map name to (T, 3, 2) float32
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # attribute name to (T, 3, 4) float32, scene-linear
    active_uv: str | None = None  # the map that a texture node without a UV Map node reads
    # (V, 3) float32: where vertices lie in the mesh's texture space, before what deforms it; None: their places within
    # its bounds, or nothing reads them
    generated: np.ndarray | None = None
    material: np.ndarray | None = None  # (T,) uint16, rows of Scene.materials; None: all `materials[0]`
    materials: tuple[int, ...] = (0,)  # the rows in use
    # Values of the object that shows the mesh, by name, (1, C); of several objects, of whose samples it is known which
    # one they lie on (Samples.object), (I, C)
    objects: dict[str, np.ndarray] = field(default_factory=dict)
    topology: str = ""  # content key of all but positions and normals: equal keys mean that samples can be kept

    @property
    def nbytes(self) -> int:
        arrays = [self.position, self.triangles, self.vertex_normal, self.corner_normal, self.material, self.generated]
        arrays += [*self.uv.values(), *self.colors.values()]
        return sum(a.nbytes for a in arrays if a is not None)

    def take(self, rows: np.ndarray) -> Mesh:
        """Returns the mesh with the triangles `rows` (n,) int alone, in their order; vertices and keys stay."""
        return replace(
            self,
            triangles=self.triangles[rows],
            corner_normal=None if self.corner_normal is None else self.corner_normal[rows],
            uv={name: array[rows] for name, array in self.uv.items()},
            colors={name: array[rows] for name, array in self.colors.items()},
            material=None if self.material is None else self.material[rows],
        )


def triangle_corners(mesh: Mesh, rows: np.ndarray | slice, origin: np.ndarray | float = 0.0) -> np.ndarray:
    """(3 corners, 3 coordinates, n) float64 of the triangles that `rows` selects, relative to `origin`."""
    triangles = mesh.triangles[rows] if isinstance(rows, slice) else mesh.triangles.take(rows, axis=0)
    corners = np.empty((3, 3, len(triangles)))
    for corner, vertex in zip(corners, triangles.T, strict=True):
        copy_to_rows(mesh.position.take(vertex, axis=0), corner)
    if np.any(origin):
        corners -= np.asarray(origin, np.float64).reshape(-1, 1)
    return corners


def copy_to_rows(values: np.ndarray, out: np.ndarray) -> None:
    """(n, C) into (C, n). NumPy copies a whole transposed array several times more slowly."""
    for row, column in zip(out, values.T, strict=True):
        row[:] = column


def copy_to_columns(values: np.ndarray, out: np.ndarray) -> None:
    """(C, n) into (n, C)."""
    for column, row in zip(out.T, values, strict=True):
        column[:] = row


def squared_edges(corners: np.ndarray) -> np.ndarray:
    """(3, n) squared lengths of the edges opposite corners 0, 1 and 2."""
    edges = [corners[2] - corners[1], corners[0] - corners[2], corners[1] - corners[0]]
    return np.stack([dot(e, e) for e in edges])


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
    """Yields all meshes with at most FEW_TRIANGLES triangles, but for those without any, about TOGETHER at a time."""
    rows: list[int] = []
    held = 0
    for row, mesh in enumerate(meshes):
        if 0 < len(mesh.triangles) <= FEW_TRIANGLES:
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
