"""Hierarchies of splats over points: the type, and how they are built and refitted (Pajarola 2003, sections 3 to 5).

Points are split at their mean into eight octants until at most `leaf_size` remain; nodes are merged bottom up. The room
`nodes/` has each step.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from ..numeric.record import record
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


@record
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
    center: np.ndarray  # (M, 3) float32, weighted mean of the points
    normal: np.ndarray  # (M, 3) float32, unit, weighted mean
    axis: np.ndarray  # (M, 3) float32, unit, perpendicular to normal: the major axis
    radii: np.ndarray  # (M, 3) float32, kernel half-axes: major, minor, along the normal
    bound: np.ndarray  # (M, 3) float32
    sphere: np.ndarray  # (M,) float32
    cone: np.ndarray  # (M, 2) float32: cosine and sine of the half-angle that holds all normals about `normal`
    smallest: np.ndarray  # (M,) float32: least `size` among the node and its descendants of two or more points
    # NODE_ATTRIBUTES follow; means are weighted by `splat_weight`, those of emission and color in media by mass.
    color: np.ndarray | None = None  # (M, 3) float32, mean
    # (M,) or (M, 3) float32: one minus the transmittance of the node's kernel as it is drawn
    opacity: np.ndarray | None = None
    surface: np.ndarray | None = None  # (M, 2) float32, mean
    emission: np.ndarray | None = None  # (M, 3) float32, mean; in media of the kernel as it is drawn
    shading_normal: np.ndarray | None = None  # (M, 3) float32, mean, not normalised
    velocity: np.ndarray | None = None  # (M, 3) float32, mean
    extinction: np.ndarray | None = None  # (M,) or (M, C) float32, of the kernel as it is drawn (`points_and_nodes`)
    shaded: np.ndarray | None = None  # (M, 3) float32, mean
    value: np.ndarray | None = None  # (M,) float32, mean
    material: np.ndarray | None = None  # (M,) uint16, of the heaviest child
    kernel: np.ndarray | None = None  # (M,) uint8, 0: many splats of any profile look like one of the default
    disconnected: np.ndarray | None = None  # (M,) bool: foliage: most of the node's area is of disconnected splats
    mass: np.ndarray | None = None  # (M,) or (M, C) float32: integral of extinction, or of optical depth over area
    covered: np.ndarray | None = None  # (M,) float32: fraction of the kernel's volume (shells: ellipse) that is filled
    section: np.ndarray | None = None  # (M,) float32, with `disconnected`: area of the disk that hides as much as all

    def __len__(self) -> int:
        return len(self.tree)

    @property
    def size(self) -> np.ndarray:
        """Radius (M,) float32 of a ball about the center that holds every descendant disk."""
        return np.minimum(self.sphere, np.hypot(self.bound[:, 0], self.bound[:, 2]))

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, those of the points included."""
        held = [getattr(self, f.name) for f in fields(self)] + [getattr(self.tree, f.name) for f in fields(self.tree)]
        return self.cloud.nbytes + sum(a.nbytes for a in held if isinstance(a, np.ndarray))


def build(cloud: PointCloud, leaf_size: int = LEAF_SIZE) -> Hierarchy:
    """Builds the point-octree of a cloud, with leaves of at most `leaf_size` points where points are distinct.

    Raises ValueError for a NaN or infinity in any attribute, negative radii, leaf_size < 1, or 2^31 points or more.
    """
    if leaf_size < 1:
        raise ValueError(f"leaf_size is {leaf_size}, expected at least 1")
    if len(cloud) >= 2**31:
        raise ValueError(f"{len(cloud)} points do not fit 32-bit links")
    require_finite(cloud)
    order, tree = partition(cloud.position, leaf_size)
    return _evaluate(_take_in_tree_order(cloud, order), order, tree)


def refit(hierarchy: Hierarchy, cloud: PointCloud) -> Hierarchy:
    """Evaluates the nodes of a hierarchy anew for other attributes of the same points, such as a new pose or colours.

    The partition stays. `cloud` has the points in their original order. Raises ValueError as `build` does, or where the
    number of points differs.
    """
    if len(cloud) != len(hierarchy.cloud):
        raise ValueError(f"refit with {len(cloud)} points of a hierarchy of {len(hierarchy.cloud)}")
    require_finite(cloud)
    return _evaluate(_take_in_tree_order(cloud, hierarchy.order), hierarchy.order, hierarchy.tree)


def recolor(hierarchy: Hierarchy, cloud: PointCloud) -> Hierarchy:
    """Refits what a transfer function changes: colours, surfaces, emission, extinction and values (AVERAGED).

    The result equals that of `refit`, in half the time where splats are not weighted by their opacity. `cloud` has the
    attributes of the hierarchy's cloud, in the original order; positions, normals, half-axes, materials and kernels
    stay those of the hierarchy. Raises ValueError as `refit` does, or where the cloud has other attributes.
    """
    if cloud.arrays().keys() != hierarchy.cloud.arrays().keys():
        raise ValueError("recolor with other attributes than the hierarchy has")
    if len(cloud) != len(hierarchy.cloud) or cloud.opacity is not None:
        return refit(hierarchy, cloud)
    given = {name: array[hierarchy.order] for name, array in cloud.arrays().items() if name in AVERAGED}
    cloud = replace(hierarchy.cloud, **given)
    require_finite(cloud)

    def columns(which: slice) -> np.ndarray:
        weight = splat_weight(cloud, which)
        averages = [as_rows(array, which) for array in given.values()]
        return np.concatenate(
            [
                weight[None],
                *(weight * a for a in averages),
                optical_sums(cloud, which, splat_frames(cloud, which).radii),
            ]
        )

    weight, totals = np.split(sum_over_nodes(hierarchy.tree, len(cloud), columns), [1])
    width = sum(int(np.prod(array.shape[1:])) for array in given.values())
    named = _averages(cloud, totals[:width] / weight)
    if len(totals) > width:
        named |= node_optics(cloud, hierarchy.radii.T, totals[width:])
    return replace(hierarchy, cloud=cloud, **named)


def _evaluate(cloud: PointCloud, order: np.ndarray, tree: Tree) -> Hierarchy:
    """The hierarchy over a cloud whose points are in tree order already."""
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
    """Rows (A, n) of averages by attribute, each in the shape that it has in the cloud."""
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
    """`cloud.take(order)`, faster: float attributes are gathered as records, so that each point is one distant
    access."""
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
    """Raises ValueError for attributes that are not finite, and for negative radii."""
    # NaN propagates through the extremes.
    for name, array in cloud.arrays().items():
        if array.size and array.dtype.kind == "f" and not np.isfinite([array.min(), array.max()]).all():
            raise ValueError(f"PointCloud.{name} holds a NaN or an infinity")
    if cloud.radii is not None and cloud.radii.size and cloud.radii.min() < 0:
        raise ValueError("PointCloud.radii holds a negative half-axis")
