"""Merges splats into nodes, bottom up: moments, kernels, bounds, normal cones, means and sums (Pajarola 2003, section
4).

A uniform disk of radius r has the variance r^2 / 4 along each axis of its plane, hence half-axes are
2 sqrt(eigenvalue), with eigenvalues from l^2 - tr l + det = 0.
"""

from __future__ import annotations

import numpy as np

from ...numeric.linear import bilinear_form, outer_product, principal_axes
from ...numeric.record import value_record
from ...numeric.segments import batches, owners, starts
from ...numeric.vectors import basis, lengths
from ...scene.cloud import PointCloud
from .bounds import bounds_of_runs
from .optics import merged_shells
from .rows import NodeRows, rows_of_points
from .tree import CHUNK, Tree, leaves_in_tree_order


def _merge_runs(rows: NodeRows, count: np.ndarray, cloud: PointCloud) -> NodeRows:
    """Merges consecutive runs of rows, of `count` (n,) each, into one row each."""
    begin = starts(count)
    owner = owners(count)

    # Moments about each parent's own mean.
    weight = np.add.reduceat(rows.weight, begin)
    mean = np.add.reduceat(rows.weight * rows.mean, begin, axis=1) / weight
    step = rows.mean - mean.take(owner, axis=1)
    second = np.add.reduceat(rows.second + rows.weight * outer_product(step), begin, axis=1)

    # The kernel, in the plane of the mean normal where there is one.
    facing = np.add.reduceat(rows.weight * rows.facing, begin, axis=1) / weight
    fitted = _fit_kernel(second / weight, facing)
    normal, axis, radii = fitted.normal, fitted.axis, fitted.radii

    # Bounds refer to the rounded center and the rounded frame, with which they will be used.
    center = mean.astype(np.float32)
    bound, sphere = bounds_of_runs(rows, begin, owner, center, normal, axis, radii)
    angle = 2 * np.arcsin(np.minimum(lengths(rows.normal - normal.take(owner, axis=1)) / 2, 1))
    angle = np.maximum.reduceat(angle + rows.angle, begin) + 1e-6
    smallest = np.minimum.reduceat(rows.smallest, begin)
    sums = np.add.reduceat(rows.sums, begin, axis=1)
    size = np.minimum(sphere, np.hypot(bound[0], bound[2]))
    single = (count == 1) & np.isinf(smallest)

    return NodeRows(
        weight, mean, second, facing, center, normal, axis, radii, bound, sphere,
        angle=np.where(fitted.faces, np.minimum(angle, np.pi), np.pi),
        smallest=np.where(single, np.inf, np.minimum(smallest, size)),
        averages=np.add.reduceat(rows.weight * rows.averages, begin, axis=1) / weight,
        sums=merged_shells(cloud, sums, radii) if len(sums) and cloud.extinction is None else sums,
        material=_heaviest_material(rows, begin, owner),
    )  # fmt: skip


@value_record
class _Kernels:
    """Ellipses of n nodes."""

    normal: np.ndarray  # (3, n) float32, unit
    axis: np.ndarray  # (3, n) float32, unit: the major axis
    radii: np.ndarray  # (3, n) float32: half-axes along axis, across it, along normal
    faces: np.ndarray  # (n,) bool: whether there is a mean normal


def _fit_kernel(covariance: np.ndarray, facing: np.ndarray) -> _Kernels:
    """The ellipses of covariances (6, n) in the planes of the mean normals `facing` (3, n), not normalised.

    In the plane of the mean normal the eigenvalues are those of the projected covariance (Pajarola 2003,
    section 4, with the sign of equation 5 corrected); where normals cancel or are absent, of all three dimensions.
    """
    length = lengths(facing)
    flat = length > 1e-3
    if not flat.any():
        return _Kernels(*principal_axes(covariance), flat)
    normal = np.where(flat, facing / np.maximum(length, 1e-3), [[0.0], [0.0], [1.0]]).astype(np.float32)
    u, v = basis(normal.astype(np.float64))
    uu, uv, vv = bilinear_form(covariance, u, u), bilinear_form(covariance, u, v), bilinear_form(covariance, v, v)

    # Half the angle whose cosine is (uu - vv) / 2 over the root of the discriminant.
    middle, difference = (uu + vv) / 2, (uu - vv) / 2
    root = np.hypot(difference, uv)
    cosine = difference / np.maximum(root, np.finfo(float).tiny)
    axis = np.sqrt(np.clip((1 + cosine) / 2, 0, 1)) * u + np.copysign(np.sqrt(np.clip((1 - cosine) / 2, 0, 1)), uv) * v
    variance = np.stack([middle + root, middle - root, bilinear_form(covariance, normal, normal)])
    axis, radii = axis.astype(np.float32), (2 * np.sqrt(np.maximum(variance, 0))).astype(np.float32)

    rest = np.flatnonzero(~flat)
    if len(rest):
        normal[:, rest], axis[:, rest], radii[:, rest] = principal_axes(covariance[:, rest])
    return _Kernels(normal, axis, radii, flat)


def _heaviest_material(rows: NodeRows, begin: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """The material of the heaviest row of each run, (1, n); the first of them where several are as heavy."""
    if len(rows.material) == 0:
        return np.empty((0, len(begin)), np.uint16)
    top = np.flatnonzero(rows.weight == np.maximum.reduceat(rows.weight, begin).take(owner))
    _, first = np.unique(owner[top], return_index=True)
    return rows.material[:, top[first]]


def merge_nodes(cloud: PointCloud, tree: Tree) -> NodeRows:
    """The rows of all nodes over points in tree order: leaves from their points, then one level after the other."""
    nodes = NodeRows.empty(rows_of_points(cloud, slice(0, 0)), len(tree))
    leaves = leaves_in_tree_order(tree, len(cloud))
    begin = np.append(tree.first_point[leaves], len(cloud))
    for a, b in batches(tree.point_count[leaves], CHUNK):
        rows = rows_of_points(cloud, slice(begin[a], begin[b]))
        nodes.put(leaves[a:b], _merge_runs(rows, tree.point_count[leaves[a:b]], cloud))
    for first, last in zip(tree.levels[-2::-1], tree.levels[:0:-1], strict=True):
        parents = first + np.flatnonzero(tree.child_count[first:last])
        count = tree.child_count[parents].astype(np.int64)
        for a, b in batches(count, CHUNK):
            begin = tree.first_child[parents[a]]
            end = tree.first_child[parents[b - 1]] + count[b - 1]
            nodes.put(parents[a:b], _merge_runs(nodes.take(slice(begin, end)), count[a:b], cloud))
    return nodes
