"""The corners of a mesh's triangles in the order in which they are drawn, as texels."""

from __future__ import annotations

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import corner_normals
from ...device.packing import PAGE_WIDTH, octahedral

BLOCK = 1 << 13  # triangles whose corners fit the processor's cache


def corner_texels(mesh: Mesh, order: np.ndarray | None, origin: np.ndarray) -> np.ndarray:
    """(H PAGE_WIDTH, 4) float32, zero padded: position relative to `origin` and packed normal of each corner.

    order: (T,) rows of triangles; None: as they come. origin: (3,) float64, numbers that float32 holds.
    """
    count = 3 * len(mesh.triangles)
    texels = np.empty((max(1, -(-count // PAGE_WIDTH)) * PAGE_WIDTH, 4), np.float32)
    texels[count:] = 0
    normals = mesh.corner_normal
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

    def pack_corners(block: slice) -> None:
        rows = mesh.triangles[block] if order is None else mesh.triangles.take(order[block], axis=0)
        out = texels[3 * block.start : 3 * block.stop]
        np.take(vertices, rows.reshape(-1), axis=0, out=out, mode="clip")  # other modes copy `out`
        if normals is not None:
            own = normals[block] if order is None else normals.take(order[block], axis=0)
            out[:, 3] = octahedral(own.reshape(-1, 3))

    each_block(len(vertices), pack_vertices)
    each_block(len(mesh.triangles), pack_corners, BLOCK)
    return texels
