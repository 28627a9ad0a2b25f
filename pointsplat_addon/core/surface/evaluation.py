"""Evaluates samples on one pose of their mesh: positions, normals, and ellipses in object space."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from ..numeric.vectors import cross, dot, each_block
from ..scene.bounds import mesh_centre
from ..scene.mesh import Mesh, copy_to_columns, copy_to_rows, triangle_corners
from .samples import Samples, corner_of_sample
from .vertex_sampling import normalised, one_rings

_MIN_ASPECT = 2.0**-20  # minor over major half-axis: keeps conics invertible in float32


@record
class Evaluated:
    """Samples on one pose of their mesh: what a PointCloud needs of geometry."""

    origin: np.ndarray  # (3,) float64, object space
    position: np.ndarray  # (N, 3) float32, relative to origin
    normal: np.ndarray  # (N, 3) float32, unit, for shading: the mesh's own normals, interpolated
    plane: np.ndarray  # (N, 3) float32, unit, of the splat's plane: the triangle's, or the one-ring's mean
    radii: np.ndarray  # (N, 1) float32 radius of a disk, or (N, 2) half-axes of an ellipse, major first
    axis: np.ndarray | None = None  # (N, 3) float32, unit, perpendicular to `plane`: the major half-axis


def evaluate(
    mesh: Mesh, samples: Samples, origin: np.ndarray | None = None, which: np.ndarray | None = None
) -> Evaluated:
    """Evaluates positions, normals and ellipses of samples on their mesh, in the pose that was sampled or another one.

    `origin` (3,) float64 is what positions are relative to; None takes `mesh_centre`, so that coordinates far from
    zero keep the precision of the mesh. `which` (T,) bool: the triangles that were sampled; None: all. Samples of
    triangles that lost their area in this pose have a radius of rounding size and some unit normal.
    """
    origin = mesh_centre(mesh) if origin is None else np.asarray(origin, np.float64)
    if samples.ellipse is None:
        return _evaluate_vertices(mesh, samples, origin, which)
    return _evaluate_ellipses(mesh, samples, samples.ellipse, origin)


def _evaluate_ellipses(mesh: Mesh, samples: Samples, ellipse: np.ndarray, origin: np.ndarray) -> Evaluated:
    count = len(samples)
    position, plane, axis = (np.empty((count, 3), np.float32) for _ in range(3))
    normal = plane if mesh.vertex_normal is None and mesh.corner_normal is None else np.empty_like(plane)
    radii = np.empty((count, 2), np.float32)

    def fill(block: slice) -> None:
        triangles, own = _grouped(samples.triangle[block])
        flat, metric, normals = _per_triangle(mesh, triangles, origin, normal is not plane)
        weights = samples.barycentric[block].T.astype(np.float64, order="C")
        # What `own` holds is in range: nothing needs to be checked.
        flat, metric = flat.take(own, axis=1, mode="clip"), metric.take(own, axis=1, mode="clip")
        first, edges, face = flat[:3], (flat[3:6], flat[6:9]), flat[9:]
        place = _along(edges, weights) + first
        copy_to_columns(place, position[block])
        copy_to_columns(face, plane[block])

        shape = ellipse[block].transpose(1, 2, 0).astype(np.float64, order="C")
        major, length = _major_half_axis(edges, metric, shape)
        copy_to_columns(normalised(major, length, fallback=0), axis[block])
        # The product of the half-axes follows from the area, so that needles lose no digits.
        determinant = np.abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
        minor = determinant * metric[3] / np.maximum(length, np.finfo(np.float64).tiny)
        rounding = 2.0**-23 * np.abs(place).max(axis=0)  # of `position`: neighbours still meet
        radii[block, 0] = length + rounding
        radii[block, 1] = np.maximum(minor, _MIN_ASPECT * length) + rounding
        if normals is not None:
            smooth = normals.take(own, axis=1, mode="clip")
            with np.errstate(invalid="ignore"):  # as where they were taken
                mixed = smooth[:3] + _along((smooth[3:6], smooth[6:]), weights)
            copy_to_columns(normalised(mixed, np.sqrt(dot(mixed, mixed)), face), normal[block])

    each_block(count, fill)
    return Evaluated(origin, position, normal, plane, radii, axis)


def _grouped(triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, and of which of them each sample is. Samples of a triangle follow one another."""
    first = np.ones(len(triangle), bool)
    np.not_equal(triangle[1:], triangle[:-1], out=first[1:])
    return triangle[first], np.cumsum(first) - 1


def _per_triangle(
    mesh: Mesh, triangles: np.ndarray, origin: np.ndarray, smooth: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What the samples of M triangles share, as rows.

    (12, M) float64: corner 0 relative to `origin`, the edges from there to corners 1 and 2, the unit normal;
    (4, M) float64: the edges' dot products 1.1, 1.2, 2.2, and twice the area;
    (9, M) float32 where `smooth`: the mesh's own normal at corner 0, and how much those at 1 and 2 differ from it.
    """
    flat, metric = np.empty((12, len(triangles))), np.empty((4, len(triangles)))
    corners = triangle_corners(mesh, triangles, origin)
    flat[:3] = corners[0]
    first, second = (np.subtract(corners[c], corners[0], out=flat[3 * c : 3 * c + 3]) for c in (1, 2))
    metric[:3] = dot(first, first), dot(first, second), dot(second, second)
    product = cross(first, second)
    metric[3] = np.sqrt(dot(product, product))
    flat[9:] = normalised(product, metric[3])
    if not smooth:
        return flat, metric, None
    normals = np.empty((3, 3, len(triangles)), np.float32)
    if mesh.corner_normal is not None:
        of_corner = mesh.corner_normal.take(triangles, axis=0).swapaxes(0, 1)
    else:
        assert mesh.vertex_normal is not None
        vertices = mesh.triangles.take(triangles, axis=0)
        of_corner = (mesh.vertex_normal.take(vertex, axis=0) for vertex in vertices.T)
    for values, out in zip(of_corner, normals, strict=True):
        copy_to_rows(values, out)
    with np.errstate(invalid="ignore"):  # what is no number is left out where it is used
        normals[1:] -= normals[0]
    return flat, metric, normals.reshape(9, -1)


def _along(edges: tuple[np.ndarray, np.ndarray], weights: np.ndarray | tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return weights[0] * edges[0] + weights[1] * edges[1]


def _major_half_axis(
    edges: tuple[np.ndarray, np.ndarray], metric: np.ndarray, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Major half-axes (3, n) and their lengths (n,) of ellipses with conjugate half-diameters p and q, whose weights of
    `edges` are the rows of shape (2, 2, n); metric (3.., n): the edges' dot products 1.1, 1.2, 2.2.

    The half-axis is p cos a + q sin a with tan 2a = 2 p.q / (p.p - q.q).
    """
    p, q = shape
    along_p = metric[0] * p[0] + metric[1] * p[1], metric[1] * p[0] + metric[2] * p[1]
    pp, pq = along_p[0] * p[0] + along_p[1] * p[1], along_p[0] * q[0] + along_p[1] * q[1]
    qq = metric[0] * q[0] * q[0] + 2 * metric[1] * q[0] * q[1] + metric[2] * q[1] * q[1]
    difference, twice = pp - qq, 2 * pq
    hypotenuse = np.sqrt(difference * difference + twice * twice)
    # Of cos a and sin a the larger comes from |cos 2a|, the other one from sin 2a: no digits are lost.
    circle = hypotenuse == 0
    hypotenuse[circle] = difference[circle] = 1
    large = np.sqrt(0.5 + 0.5 * np.abs(difference) / hypotenuse)
    small = pq / (hypotenuse * large)
    swap = difference < 0
    cosine, sine = np.where(swap, small, large), np.where(swap, large, small)
    major = _along(edges, (cosine * p[0] + sine * q[0], cosine * p[1] + sine * q[1]))
    return major, np.sqrt(dot(major, major))


def _evaluate_vertices(mesh: Mesh, samples: Samples, origin: np.ndarray, which: np.ndarray | None) -> Evaluated:
    vertex = mesh.triangles[samples.triangle, corner_of_sample(samples)]
    mean, radius = one_rings(mesh, which)
    plane = mean[vertex]
    normal = plane
    if mesh.vertex_normal is not None:
        own = mesh.vertex_normal[vertex].T
        normal = normalised(own, np.sqrt(dot(own, own)), plane.T).T.astype(np.float32)
    position = (mesh.position[vertex] - origin).astype(np.float32)
    rounding = np.float32(2.0**-23) * np.abs(position).max(axis=1)
    return Evaluated(origin, position, normal, plane, (radius[vertex] + rounding)[:, None])
