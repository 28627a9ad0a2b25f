"""Computes the area of a mesh that each of its samples stands for."""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import blocks
from ..scene.mesh import Mesh
from .area_sampling import STEINER, cell_areas
from .samples import Samples, corner_of_sample
from .triangles import rows_of, triangle_areas

WHOLE_PATCH = float(
    np.linalg.det(STEINER / np.sqrt(2))
)  # determinant of the ellipse of a patch that is a whole triangle


def sample_areas(mesh: Mesh, samples: Samples, which: np.ndarray | None = None) -> np.ndarray:
    """(N,) float64: the area, in object units squared, that each sample stands for on this pose of its mesh.

    A vertex stands for a third of each valid triangle around it. Samples of areas share their own triangle, by what of
    it lies in their cells: they add up to the triangle's area, and where a pose only stretches it, each keeps its
    share. A patch has its own area: others of its triangle may be out of view. `which` (T,) bool: the triangles that
    were sampled; None: all.
    """
    if samples.ellipse is None:
        rows = rows_of(mesh, which)
        area, vertices = triangle_areas(mesh, rows), len(mesh.position)
        ring = sum((np.bincount(corner, area / 3, vertices) for corner in mesh.triangles[rows].T), np.zeros(vertices))
        return ring[mesh.triangles[samples.triangle, corner_of_sample(samples)]]
    if samples.method == "PATCHES":
        whole = triangle_areas(mesh, np.arange(len(mesh.triangles)))
        return patch_shares(samples.ellipse) * whole[samples.triangle]
    share = np.empty(len(samples))
    for block in blocks(len(samples)):
        shape = samples.ellipse[block].transpose(1, 2, 0).astype(np.float64)
        share[block] = np.abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
        if samples.method == "AREA":
            weights = samples.barycentric[block].T.astype(np.float64)
            # What is nothing but rounding still counts.
            share[block] = np.maximum(cell_areas(weights, shape), 1e-6 * share[block])
    total = np.bincount(samples.triangle, share, len(mesh.triangles))
    used = np.flatnonzero(total)
    per_share = np.zeros(len(total))
    per_share[used] = triangle_areas(mesh, used) / total[used]
    return share * per_share[samples.triangle]


def patch_shares(ellipse: np.ndarray) -> np.ndarray:
    """Returns which shares of their triangles patches with these ellipses (N, 2, 2) are, (N,) float64."""
    return np.abs(np.linalg.det(ellipse.astype(np.float64))) / WHOLE_PATCH
