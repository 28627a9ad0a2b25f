"""Meshes of fewer triangles: vertices that lie in one cell of a grid become one (Rossignac and Borrel 1993)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...numeric.morton import DEPTH, codes_in_cube, sorted_by_code
from ...numeric.vectors import each_block, take_rows
from ...scene.bounds import bounding_box
from ...scene.mesh import Mesh


def clustered(mesh: Mesh, edge: float) -> Mesh:
    """Returns a mesh with one vertex in each cell, the mean of those in it, and the triangles whose corners lie in
    three cells.

    `mesh`: without values of corners; what it has of them is lost, and so is what has no area. `edge`: of the cells,
    object units, at least 2^-DEPTH of the mesh.
    """
    low, high = bounding_box(mesh.position)
    level = max(math.ceil(math.log2(max(float((high - low).max()) / edge, 1.0))), 0)
    order, code = sorted_by_code(codes_in_cube(mesh.position.T, low.tolist(), edge * 2.0**level))
    new = np.ones(len(code), bool)
    new[1:] = (code[1:] ^ code[:-1]) >> np.uint64(3 * (DEPTH - level)) != 0
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(code)))
    vertex = np.empty(len(code), np.int32)
    vertex[order] = np.repeat(np.arange(len(first), dtype=np.int32), count)

    def mean(rows: np.ndarray) -> np.ndarray:
        sorted_rows = take_rows(rows, order)
        sums = [np.add.reduceat(column, first, dtype=np.float64) for column in sorted_rows.T]
        return (np.stack(sums, axis=1) / count[:, None]).astype(np.float32)

    triangles, kept = np.empty_like(mesh.triangles, np.int32), np.empty(len(mesh.triangles), bool)

    def rename(some: slice) -> None:
        triangles[some] = found = vertex[mesh.triangles[some]]
        a, b, c = found.T
        kept[some] = (a != b) & (b != c) & (c != a)

    each_block(len(triangles), rename)
    return replace(
        mesh,
        key=f"{mesh.key} in cells of {edge:.9g}",
        topology=f"{mesh.topology} in cells of {edge:.9g}",
        position=mean(mesh.position),
        triangles=triangles[kept],
        vertex_normal=None if mesh.vertex_normal is None else mean(mesh.vertex_normal),
        corner_normal=None, uv={}, colors={}, active_uv=None, generated=None,
        material=None if mesh.material is None else mesh.material[kept],
    )  # fmt: skip


def area(mesh: Mesh, some_rows: np.ndarray | None = None) -> float:
    """Returns the area of a mesh; with `some_rows` (n,) int, estimated by these of its triangles."""
    triangles = mesh.triangles if some_rows is None else mesh.triangles[some_rows]
    found = []

    def add(some: slice) -> None:
        a, b, c = mesh.position[triangles[some]].astype(np.float64).transpose(1, 2, 0)
        u, v = b - a, c - a
        found.append(float(np.sqrt(sum((u[i] * v[j] - u[j] * v[i]) ** 2 for i, j in ((1, 2), (2, 0), (0, 1)))).sum()))

    each_block(len(triangles), add)
    return 0.5 * sum(sorted(found)) * len(mesh.triangles) / max(len(triangles), 1)
