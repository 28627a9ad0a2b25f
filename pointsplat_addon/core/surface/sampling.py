"""Triangles to surface samples, two ways: the vertices, and area-uniform rows.

A sample is a place on a triangle and an ellipse in barycentric coordinates, never a place in space. Both are
affine, so a mesh that deforms without changing its topology re-evaluates its samples: they neither move over
the surface nor open holes, whatever the pose or the camera.

The ellipses of a triangle's samples cover the triangle without holes, by construction:

- AREA cuts a triangle into cells and gives each cell an ellipse around it. A rectangle of half-sides
  (w, h) lies in the ellipse of half-axes sqrt(2) (w, h); a triangle lies in its Steiner circumellipse.
- VERTICES gives each vertex a disk as large as the farthest point of its triangles that has no nearer vertex.

Paper: Gunjee et al. 2007, section 4 (subdivide until a triangle is below a splat's area).

Lengths are object units. The work is done in float64 on blocks that fit the cache; what is kept is float32.
"""

from __future__ import annotations

import numpy as np

from ..scene.mesh import Mesh
from .area_sampling import ONE_SAMPLE, check_spacing, sample_area
from .samples import Samples
from .triangles import Measures, measure_triangles
from .vertex_sampling import sample_vertices

METHODS = ("AUTO", "VERTICES", "AREA")


def sample_mesh(
    mesh: Mesh,
    spacing: float,
    method: str = "AUTO",
    which: np.ndarray | None = None,
    measures: Measures | None = None,
) -> Samples:
    """Samples the triangles `which` (T,) bool of a mesh, None: all, by one of METHODS. `measures`: of these triangles,
    where they are at hand.

    Raises ValueError for an unknown method, a spacing that is not a positive number, or more than 2^31 samples.
    """
    if method not in METHODS:
        raise ValueError(f"unknown sampling method {method!r}, expected one of {', '.join(METHODS)}")
    if method == "AUTO":
        method = choose_method(mesh, spacing, which, measures)
    if method == "VERTICES":
        return sample_vertices(mesh, which)
    return sample_area(mesh, spacing, which, measures)


def choose_method(mesh: Mesh, spacing: float, which: np.ndarray | None = None, measures: Measures | None = None) -> str:
    """VERTICES where AREA would give no triangle more than one sample and vertices are fewer; else AREA."""
    check_spacing(spacing)
    m = measure_triangles(mesh, which) if measures is None else measures
    return "VERTICES" if m.longest <= ONE_SAMPLE * spacing and m.vertices <= len(m.triangle) else "AREA"
