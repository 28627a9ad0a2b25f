"""Samples: positions on triangles and ellipses around them in barycentric coordinates, and attributes at them."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from ..numeric.vectors import blocks, each_block
from ..scene.camera import Camera
from ..scene.mesh import Mesh


@record
class Samples:
    """N positions on a mesh's triangles and the ellipses of their splats, independent of pose and camera."""

    method: str  # VERTICES, AREA, or PATCHES (of core/lens/dicing.py)
    triangle: np.ndarray  # (N,) int32, rows of Mesh.triangles
    barycentric: np.ndarray  # (N, 2) float32, weights of the triangle's corners 1 and 2
    # (N, 2, 2) float32: two conjugate half-diameters of the splat's ellipse, each as weights of corners 1 and 2
    # (a vector, so that corner 0 weighs minus their sum). None for VERTICES, whose disks follow the one-ring.
    ellipse: np.ndarray | None = None

    object: np.ndarray | None = None  # (N,) integers, rows of Mesh.objects; None: all lie on the first
    # (N,) bool: seen from where the triangle's normal does not point; None: nowhere
    backfacing: np.ndarray | None = None
    eye: Camera | None = None  # by which all are seen; None: from anywhere

    def __len__(self) -> int:
        return len(self.triangle)

    @property
    def nbytes(self) -> int:
        arrays = (self.triangle, self.barycentric, self.ellipse, self.object, self.backfacing)
        return sum(a.nbytes for a in arrays if a is not None)


def corner_of_sample(samples: Samples) -> np.ndarray:
    """(N,) int8: the corner (0, 1 or 2) of its triangle at which each sample lies. Only for samples at vertices."""
    return (samples.barycentric @ np.array([1, 2], np.float32)).astype(np.int8)


def vertex_of_sample(mesh: Mesh, samples: Samples) -> np.ndarray:
    """(N,) row of the vertex of the mesh at which each sample lies. Only for samples at vertices."""
    return mesh.triangles[samples.triangle, corner_of_sample(samples)]


def interpolate(mesh: Mesh, samples: Samples, per_corner: np.ndarray) -> np.ndarray:
    """(N, C) float32: an attribute of corners, (T, 3, C), at the samples. Vertex samples take their corner's value."""
    if samples.ellipse is None:
        return np.asarray(per_corner[samples.triangle, corner_of_sample(samples)], np.float32)
    result = np.empty((len(samples), per_corner.shape[2]), np.float32)

    def fill(block: slice) -> None:
        a, b, c = per_corner.take(samples.triangle[block], axis=0).transpose(1, 2, 0)
        weights = samples.barycentric[block].T
        with np.errstate(invalid="ignore"):
            result[block] = (a + weights[0] * (b - a) + weights[1] * (c - a)).T

    each_block(len(samples), fill)
    return result


def difference_along_half_axes(samples: Samples, per_corner: np.ndarray) -> np.ndarray:
    """(2, N, C) float32: how an attribute of corners, (T, 3, C), changes along two conjugate half-diameters of each
    sample's splat. Splats at vertices reach to the middles of their triangle's edges."""
    result = np.empty((2, len(samples), per_corner.shape[2]), np.float32)
    for block in blocks(len(samples)):
        a, b, c = per_corner.take(samples.triangle[block], axis=0).transpose(1, 0, 2)
        for k in range(2):
            if samples.ellipse is None:
                result[k, block] = 0.5 * ((b - a) if k == 0 else (c - a))
            else:
                weights = samples.ellipse[block, k]
                with np.errstate(invalid="ignore"):
                    result[k, block] = weights[:, :1] * (b - a) + weights[:, 1:] * (c - a)
    return result


def material_ids(mesh: Mesh, samples: Samples) -> np.ndarray:
    """(N,) uint16, rows of the scene's material table."""
    if mesh.material is None:
        return np.full(len(samples), mesh.materials[0], np.uint16)
    return mesh.material[samples.triangle]


def take_samples(samples: Samples, rows: np.ndarray) -> Samples:
    """Returns the samples that `rows` names, in that order."""
    ellipse = None if samples.ellipse is None else samples.ellipse.take(rows, axis=0)
    owner = None if samples.object is None else samples.object[rows]
    back = None if samples.backfacing is None else samples.backfacing[rows]
    triangle, barycentric = samples.triangle[rows], samples.barycentric.take(rows, axis=0)
    return Samples(samples.method, triangle, barycentric, ellipse, owner, back, samples.eye)
