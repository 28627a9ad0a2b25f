"""Splats as rows of a table that merging works on, points and nodes alike.

Second moments follow Pajarola's generic homogeneous covariance, M' = T M T^T, in float64. Each M is held about its own
mean, where the first-order row of M vanishes; what remains of a translation is S' = S + w d d^T with d the step between
the means. Sums about a far origin, which cancel, never occur.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...numeric.linear import outer_product
from ...numeric.vectors import as_rows, cross
from ...scene.cloud import PointCloud
from ...splat.ellipsoids import splat_frames, splat_weight
from .optics import optical_sums

# Attributes of nodes that are weighted means of those of their points
AVERAGED = ("color", "opacity", "surface", "emission", "shading_normal", "velocity", "extinction", "shaded", "value")


@dataclass
class NodeRows:
    """Splats to be merged, one column of every array for each."""

    weight: np.ndarray  # (n,) float64
    mean: np.ndarray  # (3, n) float64
    second: np.ndarray  # (6, n) float64: xx, xy, xz, yy, yz, zz of sum w (p - mean)(p - mean)^T
    facing: np.ndarray  # (3, n) float32: mean normal, not normalised; (0, n) without normals
    center: np.ndarray  # (3, n) float32: the rounded mean
    normal: np.ndarray  # (3, n) float32
    axis: np.ndarray  # (3, n) float32
    radii: np.ndarray  # (3, n) float32
    bound: np.ndarray  # (3, n) float32
    sphere: np.ndarray  # (n,) float32
    angle: np.ndarray  # (n,) float32: half-angle of the normal cone
    smallest: np.ndarray  # (n,) float32
    averages: np.ndarray  # (A, n) float32
    sums: np.ndarray  # (B, n) float64: what adds up, see `optics.optical_sums`
    material: np.ndarray  # (1, n) uint16; (0, n) without materials

    @staticmethod
    def empty(like: NodeRows, n: int) -> NodeRows:
        """Uninitialised rows for n splats with the attributes of `like`."""
        given = {f.name: getattr(like, f.name) for f in fields(NodeRows)}
        return NodeRows(**{name: np.empty((*a.shape[:-1], n), a.dtype) for name, a in given.items()})

    def take(self, which: slice) -> NodeRows:
        return NodeRows(**{f.name: getattr(self, f.name)[..., which] for f in fields(NodeRows)})

    def put(self, which: slice | np.ndarray, rows: NodeRows) -> None:
        for f in fields(NodeRows):
            getattr(self, f.name)[..., which] = getattr(rows, f.name)


def rows_of_points(cloud: PointCloud, which: slice) -> NodeRows:
    """The rows of a range of points of a cloud."""
    position = np.ascontiguousarray(cloud.position[which].T)
    normal, axis, radii = splat_frames(cloud, which)
    weight = splat_weight(cloud, which)
    a, b, c = 0.25 * weight * radii**2
    second = a * outer_product(axis) + b * outer_product(cross(normal, axis))
    if c.any():
        second += c * outer_product(normal)
    columns = [as_rows(array, which) for name, array in cloud.arrays().items() if name in AVERAGED]
    return NodeRows(
        weight, position.astype(np.float64), second,
        facing=np.empty((0, len(weight)), np.float32) if cloud.normal is None else normal.astype(np.float32),
        center=position, normal=normal.astype(np.float32), axis=axis.astype(np.float32),
        radii=radii.astype(np.float32), bound=radii.astype(np.float32),
        sphere=radii.max(axis=0).astype(np.float32), angle=np.zeros(len(weight), np.float32),
        smallest=np.full(len(weight), np.inf, np.float32),
        averages=np.concatenate(columns) if columns else np.empty((0, len(weight)), np.float32),
        sums=optical_sums(cloud, which, radii),
        material=np.empty((0, len(weight)), np.uint16) if cloud.material is None else cloud.material[None, which],
    )  # fmt: skip
