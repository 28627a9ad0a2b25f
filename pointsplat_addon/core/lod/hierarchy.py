"""The point-octree: a data-driven hierarchy of elliptical splats (Pajarola 2003, sections 3 to 5).

Points are split at their mean into eight octants until at most `leaf_size` remain. Nodes lie breadth
first with the children of a node next to each other, and points lie in tree order, so that a level is
a slice, the coarse model a prefix, and the points of a node one range.

Second moments follow Pajarola's generic homogeneous covariance, M' = T M T^T, in float64. Each M is
held about its own mean, where the first-order row of M vanishes; what remains of the translation is
S' = S + w d d^T with d the step between the means. Sums about a far origin, which cancel, never occur.
A uniform disk of radius r has the variance r^2 / 4 along each axis of its plane, hence half-axes
are 2 sqrt(eigenvalue), with eigenvalues from l^2 - tr l + det = 0.

Nodes of translucent clouds let as much light through as the splats below them, drawn by the same law, T = exp(-tau).
Optical masses add up where splats fill a node evenly; where they are strewn, cross-sections do (`absorbed`: the area
of which a splat alone takes the light), since light passes between them, however thick they are.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ..numeric.vectors import as_columns, as_rows
from ..scene.cloud import ATTRIBUTES, PointCloud
from ..splat.ellipsoids import splat_frames, splat_weight
from .foliage import disconnected_nodes
from .nodes.merging import merge_nodes
from .nodes.octree import partition
from .nodes.optics import node_optics, optical_sums
from .nodes.rows import AVERAGED
from .nodes.tree import CHUNK, Tree, sum_over_nodes

LEAF_SIZE = 12  # points: balances the nodes' memory against the points that a cut must show instead

# What describes the shape of every point; nodes have center, normal, axis and radii instead.
GEOMETRY = ("position", "normal", "axis", "radii")
# Further columns of nodes, name: (shape of one node's value, dtype), as in ATTRIBUTES; memory, disk and device follow
# this table. Those that points have too are in ATTRIBUTES under the same name.
NODE_ATTRIBUTES: dict[str, tuple[tuple[int, ...] | None, type]] = {
    **{name: ATTRIBUTES[name] for name in (*AVERAGED, "material", "kernel", "disconnected")},
    "mass": (None, np.float32),
    "covered": ((), np.float32),
    "section": ((), np.float32),
}


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Points in tree order and the nodes above them. Lengths are object units, positions relative to cloud.origin.

    The *kernel* (axis, radii) matches the moments of the descendant disks and is what is drawn. The *bound* holds
    every descendant disk: the elliptic cylinder about `center` whose base has the half-axes bound[:, :2] along
    `axis` and `normal` x `axis`, and whose half height along `normal` is bound[:, 2]. So does the ball of radius
    `sphere`. In a cloud without normals, axis and normal are the first and last principal axis.
    """

    cloud: PointCloud  # N points in tree order
    order: np.ndarray  # (N,) int32: the original index of each point
    tree: Tree
    center: np.ndarray  # (M, 3) float32, weighted mean
    normal: np.ndarray  # (M, 3) float32, unit, weighted mean
    axis: np.ndarray  # (M, 3) float32, unit, perpendicular to normal: the major axis
    radii: np.ndarray  # (M, 3) float32, kernel half-axes: major, minor, along the normal
    bound: np.ndarray  # (M, 3) float32
    sphere: np.ndarray  # (M,) float32
    cone: np.ndarray  # (M, 2) float32: cosine and sine of the half-angle that holds all normals about `normal`
    smallest: np.ndarray  # (M,) float32: least `size` among the node and its descendants of two or more points
    color: np.ndarray | None = None  # (M, 3) float32, weighted mean, as all below
    opacity: np.ndarray | None = None  # (M,) float32: by which exp(-tau) is the node's transmittance
    surface: np.ndarray | None = None  # (M, 2) float32
    emission: np.ndarray | None = None  # (M, 3) float32
    shading_normal: np.ndarray | None = None  # (M, 3) float32, not normalised
    extinction: np.ndarray | None = (
        None  # (M,) or (M, C) float32, of the splat that `splats` gives, as is emission then
    )
    value: np.ndarray | None = None  # (M,) float32
    material: np.ndarray | None = None  # (M,) uint16, of the heaviest child
    kernel: np.ndarray | None = None  # (M,) uint8, 0: many splats of any shape look like one of the default
    mass: np.ndarray | None = None  # (M,) or (M, C) float32: integral of extinction, or of optical depth over area
    covered: np.ndarray | None = None  # (M,) float32: fraction of the kernel's volume (shells: ellipse) that is filled
    # Of opaque clouds with splats that stand apart, all (M,): whether most of the node's do, and then, the area of the
    # disk that hides as much as they.
    disconnected: np.ndarray | None = None  # bool
    section: np.ndarray | None = None  # float32

    def __len__(self) -> int:
        return len(self.tree)

    @property
    def size(self) -> np.ndarray:
        """(M,) float32: no descendant disk reaches farther than this from the center."""
        return np.minimum(self.sphere, np.hypot(self.bound[:, 0], self.bound[:, 2]))

    @property
    def nbytes(self) -> int:
        held = [getattr(self, f.name) for f in fields(self)] + [getattr(self.tree, f.name) for f in fields(self.tree)]
        return self.cloud.nbytes + sum(a.nbytes for a in held if isinstance(a, np.ndarray))


def build(cloud: PointCloud, leaf_size: int = LEAF_SIZE) -> Hierarchy:
    """The point-octree of a cloud, with leaves of at most `leaf_size` points where points are distinct.

    Raises ValueError for a NaN or infinity in any attribute, negative radii, leaf_size < 1, or 2^31 points or more.
    """
    if leaf_size < 1:
        raise ValueError(f"leaf_size is {leaf_size}, expected at least 1")
    if len(cloud) >= 2**31:
        raise ValueError(f"{len(cloud)} points do not fit 32-bit links")
    require_finite(cloud)
    order, tree = partition(cloud.position, leaf_size)
    return _evaluate(_take_in_tree_order(cloud, order), order, tree)


def refit(hierarchy: Hierarchy, cloud: PointCloud, in_tree_order: bool = False) -> Hierarchy:
    """The same partition over new attributes of the same points (a moved armature, new colours), bottom up.

    `cloud` is in the original order unless `in_tree_order`. Raises ValueError as `build` does, or where the
    number of points differs.
    """
    if len(cloud) != len(hierarchy.cloud):
        raise ValueError(f"refit with {len(cloud)} points of a hierarchy of {len(hierarchy.cloud)}")
    require_finite(cloud)
    return _evaluate(
        cloud if in_tree_order else _take_in_tree_order(cloud, hierarchy.order), hierarchy.order, hierarchy.tree
    )


def recolor(hierarchy: Hierarchy, cloud: PointCloud, in_tree_order: bool = False) -> Hierarchy:
    """The same points and nodes in other colours, surfaces, emission, extinction, values: what a transfer function
    changes. Equal to `refit`, in half the time where splats are not weighted by their opacity.

    `cloud` has the attributes of the hierarchy's, in the original order unless `in_tree_order`; places, normals,
    half-axes, materials and kernels stay the hierarchy's. Raises ValueError as `refit` does, or where attributes are
    others.
    """
    if cloud.arrays().keys() != hierarchy.cloud.arrays().keys():
        raise ValueError("recolor with other attributes than the hierarchy has")
    if len(cloud) != len(hierarchy.cloud) or cloud.opacity is not None:
        return refit(hierarchy, cloud, in_tree_order)
    given = {name: array for name, array in cloud.arrays().items() if name in AVERAGED}
    if not in_tree_order:
        given = {name: array[hierarchy.order] for name, array in given.items()}
    cloud = replace(hierarchy.cloud, **given)
    require_finite(cloud)

    def columns(which: slice) -> np.ndarray:
        weight = splat_weight(cloud, which)
        averages = [as_rows(array, which) for array in given.values()]
        return np.concatenate(
            [weight[None], *(weight * a for a in averages), optical_sums(cloud, which, splat_frames(cloud, which)[2])]
        )

    weight, totals = np.split(sum_over_nodes(hierarchy.tree, len(cloud), columns), [1])
    width = sum(int(np.prod(array.shape[1:])) for array in given.values())
    named = _averages(cloud, totals[:width] / weight)
    if len(totals) > width:
        named |= node_optics(cloud, hierarchy.radii.T, totals[width:])
    return replace(hierarchy, cloud=cloud, **named)


def moments(hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zeroth, first and second moments of each node: weight (M,), mean (M, 3), covariance (M, 3, 3), float64.

    The weight of a point is the product of its first two half-axes times its opacity, in media of all three
    (`splat_weight`).
    """
    nodes = merge_nodes(hierarchy.cloud, hierarchy.tree)
    xx, xy, xz, yy, yz, zz = nodes.second / np.maximum(nodes.weight, np.finfo(float).tiny)
    covariance = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    return nodes.weight, nodes.mean.T, covariance


def _evaluate(cloud: PointCloud, order: np.ndarray, tree: Tree) -> Hierarchy:
    """Attributes of all nodes over points in tree order."""
    rows = merge_nodes(cloud, tree)
    named = _averages(cloud, rows.averages)
    if len(rows.sums):
        named |= node_optics(cloud, rows.radii, rows.sums)
    if cloud.disconnected is not None:
        named |= disconnected_nodes(cloud, tree, rows.radii)
    return Hierarchy(
        cloud, order, tree,
        center=as_columns(rows.center), normal=as_columns(rows.normal), axis=as_columns(rows.axis),
        radii=as_columns(rows.radii), bound=as_columns(rows.bound), sphere=rows.sphere,
        cone=np.stack([np.cos(rows.angle), np.sin(rows.angle)], axis=1), smallest=rows.smallest,
        material=None if cloud.material is None else rows.material[0],
        kernel=None if cloud.kernel is None else np.zeros(len(tree), np.uint8),
        **named,
    )  # fmt: skip


def _averages(cloud: PointCloud, averages: np.ndarray) -> dict[str, np.ndarray]:
    """Rows (A, n) by name, in the shape that they have in the cloud."""
    named, at = {}, 0
    for name in AVERAGED:
        given = getattr(cloud, name)
        if given is None:
            continue
        width = int(np.prod(given.shape[1:]))
        named[name] = as_columns(averages[at : at + width]).reshape(-1, *given.shape[1:])
        at += width
    return named


def _take_in_tree_order(cloud: PointCloud, order: np.ndarray) -> PointCloud:
    """`cloud.take(order)`, by way of records of all float attributes: one far access per point, not one for each."""
    arrays = {name: array for name, array in cloud.arrays().items() if array.dtype == np.float32}
    widths = [int(np.prod(array.shape[1:])) for array in arrays.values()]
    ends = np.cumsum(widths)
    record = np.empty((len(order), ends[-1]), np.float32)
    for array, end, width in zip(arrays.values(), ends, widths, strict=True):
        record[:, end - width : end] = array.reshape(-1, width)
    taken = {name: np.empty_like(array) for name, array in arrays.items()}
    for i in range(0, len(order), CHUNK):
        part = record.take(order[i : i + CHUNK], axis=0)
        for array, end, width in zip(taken.values(), ends, widths, strict=True):
            array[i : i + CHUNK] = part[:, end - width : end].reshape(-1, *array.shape[1:])
    rest = {name: array[order] for name, array in cloud.arrays().items() if name not in arrays}
    return replace(cloud, **taken, **rest)


def require_finite(cloud: PointCloud) -> None:
    """Raise ValueError for attributes that are not finite, or negative radii. Extremes propagate NaN."""
    for name, array in cloud.arrays().items():
        if array.size and array.dtype.kind == "f" and not np.isfinite([array.min(), array.max()]).all():
            raise ValueError(f"PointCloud.{name} holds a NaN or an infinity")
    if cloud.radii is not None and cloud.radii.size and cloud.radii.min() < 0:
        raise ValueError("PointCloud.radii holds a negative half-axis")
