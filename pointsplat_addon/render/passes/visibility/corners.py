"""Texels of the corners of a mesh's triangles, in the order in which they are drawn."""

from __future__ import annotations

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import corner_normals
from ...device.packing import octahedral
from ...device.protocol import WriteTexels


def corner_texels(
    mesh: Mesh, order: np.ndarray | None, origin: np.ndarray, normals: np.ndarray | None = None
) -> WriteTexels:
    """Writes the position relative to `origin` and the packed normal of each corner, (n, 4); beyond the last, zeros.

    order: (T,) rows of triangles; None: as they come. origin: (3,) float64, numbers that float32 holds. normals:
    (3T, 3), by which corners are shaded; None: the mesh's own.
    """
    normals = mesh.corner_normal if normals is None else normals.reshape(-1, 3, 3)
    smooth = normals is None and mesh.vertex_normal is not None
    if normals is None and not smooth:
        normals = corner_normals(mesh).reshape(-1, 3, 3)
    # A vertex has six corners: what they share is computed once.
    vertices = np.zeros((len(mesh.position), 4), np.float32)

    def pack_vertices(block: slice) -> None:
        for column, values, middle in zip(vertices[block].T, mesh.position[block].T, origin, strict=False):
            np.subtract(values, np.float32(middle), out=column)
        if smooth:
            vertices[block, 3] = octahedral(mesh.vertex_normal[block])  # type: ignore[index]

    def pack(out: np.ndarray, first: int) -> None:
        """Writes corners from `first` on."""
        low, high = first // 3, -(-(first + len(out)) // 3)  # their triangles
        which = slice(first - 3 * low, first - 3 * low + len(out))
        rows = mesh.triangles[low:high] if order is None else mesh.triangles.take(order[low:high], axis=0)
        np.take(vertices, rows.reshape(-1)[which], axis=0, out=out, mode="clip")  # other modes copy `out`
        if normals is not None:
            own = normals[low:high] if order is None else normals.take(order[low:high], axis=0)
            out[:, 3] = octahedral(own.reshape(-1, 3)[which])

    def write(out: np.ndarray, texels: slice) -> None:
        there = out[: max(3 * len(mesh.triangles) - texels.start, 0)]
        out[len(there) :] = 0
        each_block(len(there), lambda block: pack(there[block], texels.start + block.start))

    each_block(len(vertices), pack_vertices)
    return write
