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

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np

from ..numeric.segments import batches, owners, starts
from ..scene.cloud import PointCloud
from ..splat.kernel import SUPPORT, kernel
from .octree import Tree, partition

CHUNK = 1 << 15  # children that are merged together, for the same reason
THIN = 1e-3  # smallest ratio of the axes of a bounding ellipse
ROUNDING = 1 + 4e-7  # float32 copies of bounds are rounded outwards
LEAF_SIZE = 12  # points: balances the nodes' memory against the points that a cut must show instead
OPAQUE = 100.0  # optical depth of an opaque splat
# Kernels of media are drawn wider than their moments: those of cells side by side then add up to an even medium (a
# standard deviation of 0.29 of the cell leaves ripples of 28 %, one of 0.33 of 12 %), and outlines grow no more than
# the thickness at which they are seen shrinks.
WIDER = 1.15
CELL = 4.5 / np.pi  # surface of a cube over that of the ellipsoid that has its moments
AVERAGED = ("color", "opacity", "surface", "emission", "shading_normal", "extinction", "value")


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
    apart: np.ndarray | None = None  # bool
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
    check(cloud)
    order, tree = partition(cloud.position, leaf_size)
    return _evaluate(_gather(cloud, order), order, tree)


def refit(hierarchy: Hierarchy, cloud: PointCloud, in_tree_order: bool = False) -> Hierarchy:
    """The same partition over new attributes of the same points (a moved armature, new colours), bottom up.

    `cloud` is in the original order unless `in_tree_order`. Raises ValueError as `build` does, or where the
    number of points differs.
    """
    if len(cloud) != len(hierarchy.cloud):
        raise ValueError(f"refit with {len(cloud)} points of a hierarchy of {len(hierarchy.cloud)}")
    check(cloud)
    return _evaluate(cloud if in_tree_order else _gather(cloud, hierarchy.order), hierarchy.order, hierarchy.tree)


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
    check(cloud)

    def columns(which: slice) -> np.ndarray:
        weight = splat_weight(cloud, which)
        averages = [_rows(array, which) for array in given.values()]
        return np.concatenate(
            [weight[None], *(weight * a for a in averages), _sums(cloud, which, frames(cloud, which)[2])]
        )

    weight, totals = np.split(sum_up(hierarchy.tree, len(cloud), columns), [1])
    width = sum(int(np.prod(array.shape[1:])) for array in given.values())
    named = _averages(cloud, totals[:width] / weight)
    if len(totals) > width:
        named |= _optics(cloud, hierarchy.radii.T, totals[width:])
    return replace(hierarchy, cloud=cloud, **named)


def moments(hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zeroth, first and second moments of each node: weight (M,), mean (M, 3), covariance (M, 3, 3), float64.

    The weight of a point is the product of its first two half-axes times its opacity, in media of all three
    (`splat_weight`).
    """
    nodes = _merge_all(hierarchy.cloud, hierarchy.tree)
    xx, xy, xz, yy, yz, zz = nodes.second / np.maximum(nodes.weight, np.finfo(float).tiny)
    covariance = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    return nodes.weight, nodes.mean.T, covariance


def splats(hierarchy: Hierarchy) -> PointCloud:
    """The N points in tree order, then the M nodes, as one cloud: what a device is given once and a cut indexes.

    Flat clouds keep two half-axes (and gain axis and radii columns where their points are disks); media have three, and
    so do shells, whose nodes are ellipsoids that are equally deep in the middle from all sides. A cloud without normals
    stays one of balls, whose nodes have the radius of the major half-axis, or of the variance's mean where light passes
    through them.
    """
    cloud, drawn = hierarchy.cloud, _drawn(hierarchy.cloud, hierarchy.radii.T).T.astype(np.float32)
    arrays: dict[str, np.ndarray] = {"position": np.concatenate([cloud.position, hierarchy.center])}
    if cloud.normal is None:
        points = np.zeros(len(cloud), np.float32) if cloud.radii is None else cloud.radii[:, 0]
        arrays["radii"] = np.concatenate([points, drawn[:, 0]])[:, None]
    else:
        normal, axis, radii = (a.astype(np.float32).T for a in frames(cloud, slice(None)))
        given = 2 if cloud.radii is None else cloud.radii.shape[1]
        columns = 3 if cloud.extinction is not None or cloud.opacity is not None or given == 3 else 2
        arrays["normal"] = np.concatenate([normal, hierarchy.normal])
        arrays["axis"] = np.concatenate([axis, hierarchy.axis])
        arrays["radii"] = np.concatenate([radii, drawn])[:, :columns]
    for name in (*AVERAGED, "material", "kernel", "apart"):
        array = getattr(cloud, name)
        if array is not None:
            arrays[name] = np.concatenate([array, getattr(hierarchy, name)])
    if hierarchy.apart is not None:
        _stand_in(hierarchy, arrays)
    return replace(cloud, **arrays)


def _stand_in(hierarchy: Hierarchy, arrays: dict[str, np.ndarray]) -> None:
    """For nodes whose splats stand apart, one of these, drawn by lot, as large as to hide as much as all of them: means
    of normals say nothing of leaves, no light passes through ellipses of whole nodes, and the middles of nodes lie in
    rows, one behind the other."""
    assert hierarchy.apart is not None
    assert hierarchy.section is not None
    nodes, tree = np.flatnonzero(hierarchy.apart), hierarchy.tree
    area = np.pi * np.prod(arrays["radii"][: len(hierarchy.cloud), :2].astype(np.float64), axis=1)
    below = np.append(0.0, np.cumsum(np.maximum(area, 1e-30)))
    first = tree.first_point[nodes]
    last = first + tree.point_count[nodes]
    lot = np.random.default_rng(0).random(len(tree))[nodes]
    of = np.searchsorted(below, below[first] + lot * (below[last] - below[first]), side="right") - 1
    of = np.clip(of, first, last - 1)
    grown = np.sqrt(hierarchy.section[nodes] / np.maximum(area[of], 1e-30))
    rows = len(hierarchy.cloud) + nodes
    for name in ("position", "normal", "axis", "radii"):
        arrays[name][rows] = arrays[name][of]
    arrays["radii"][rows] *= grown[:, None]


# Attributes of nodes


@dataclass
class _Rows:
    """Splats to be merged, points and nodes alike, one column each."""

    weight: np.ndarray  # (n,) float64
    mean: np.ndarray  # (3, n) float64
    second: np.ndarray  # (6, n) float64: xx, xy, xz, yy, yz, zz of sum w (p - mean)(p - mean)^T
    facing: np.ndarray  # (3, n) float32: mean normal, not normalised; (0, n) without normals
    center: np.ndarray  # (3, n) float32
    normal: np.ndarray  # (3, n) float32
    axis: np.ndarray  # (3, n) float32
    radii: np.ndarray  # (3, n) float32
    bound: np.ndarray  # (3, n) float32
    sphere: np.ndarray  # (n,) float32
    angle: np.ndarray  # (n,) float32: half-angle of the normal cone
    smallest: np.ndarray  # (n,) float32
    averages: np.ndarray  # (A, n) float32
    sums: np.ndarray  # (B, n) float64: what adds up, see `_sums`
    material: np.ndarray  # (1, n) uint16; (0, n) without materials

    @staticmethod
    def empty(like: _Rows, n: int) -> _Rows:
        """Room for n columns of the same kinds."""
        given = {f.name: getattr(like, f.name) for f in fields(_Rows)}
        return _Rows(**{name: np.empty((*a.shape[:-1], n), a.dtype) for name, a in given.items()})

    def take(self, which: slice) -> _Rows:
        return _Rows(**{f.name: getattr(self, f.name)[..., which] for f in fields(_Rows)})

    def put(self, which: slice | np.ndarray, rows: _Rows) -> None:
        for f in fields(_Rows):
            getattr(self, f.name)[..., which] = getattr(rows, f.name)


def splat_weight(cloud: PointCloud, which: slice) -> np.ndarray:
    """(n,) float64: area over pi (1 where points have no extent) times opacity, in media the volume over 4/3 pi: what a
    splat counts in averages."""
    weight = np.ones(len(cloud.position[which]))
    if cloud.extinction is not None and cloud.radii is not None:
        return np.maximum(np.prod(frames(cloud, which)[2], axis=0), 1e-60)
    if cloud.radii is not None:
        r = cloud.radii[which].astype(np.float64)
        flat = cloud.axis is not None and r.shape[1] > 1
        weight = r[:, 0] * r[:, 1 if flat else 0]
    if cloud.opacity is not None:
        weight = weight * cloud.opacity[which]
    # Splats of no area or opacity still have a place: a weight that only counts among their like.
    return np.maximum(weight, 1e-60)


def basis(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with the unit vectors n (3, ...) (Duff et al. 2017)."""
    x, y, z = n
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), np.stack([b, sign + y * y * a, -y])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def outer(a: np.ndarray) -> np.ndarray:
    x, y, z = a
    return np.stack([x * x, x * y, x * z, y * y, y * z, z * z])


def frames(cloud: PointCloud, which: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal, major axis and three half-axes of points, (3, n) float64 each; balls get a fixed frame, and flat splats
    of a medium stand for a slab as thick as it is wide."""
    n = len(cloud.position[which])
    radii = np.zeros((3, n))
    given = cloud.radii[which].T if cloud.radii is not None else radii
    if cloud.normal is None:
        normal, axis = np.tile([[0.0], [0.0], [1.0]], n), np.tile([[1.0], [0.0], [0.0]], n)
        radii[:] = given[0]
        return normal, axis, radii
    normal = cloud.normal[which].T.astype(np.float64)
    if cloud.axis is None or len(given) < 2:
        axis = basis(normal)[0]
        radii[:2] = given[0]
    else:
        axis = cloud.axis[which].T.astype(np.float64)
        radii[: len(given)] = given
    if cloud.extinction is not None and len(given) < 3:
        radii[2] = np.sqrt(radii[0] * radii[1])
    return normal, axis, radii


def _point_rows(cloud: PointCloud, which: slice) -> _Rows:
    """Points as the rows below the leaves."""
    position = np.ascontiguousarray(cloud.position[which].T)
    normal, axis, radii = frames(cloud, which)
    weight = splat_weight(cloud, which)
    a, b, c = 0.25 * weight * radii**2
    second = a * outer(axis) + b * outer(_cross(normal, axis))
    if c.any():
        second += c * outer(normal)
    columns = [_rows(array, which) for name, array in cloud.arrays().items() if name in AVERAGED]
    return _Rows(
        weight, position.astype(np.float64), second,
        facing=np.empty((0, len(weight)), np.float32) if cloud.normal is None else normal.astype(np.float32),
        center=position, normal=normal.astype(np.float32), axis=axis.astype(np.float32),
        radii=radii.astype(np.float32), bound=radii.astype(np.float32),
        sphere=radii.max(axis=0).astype(np.float32), angle=np.zeros(len(weight), np.float32),
        smallest=np.full(len(weight), np.inf, np.float32),
        averages=np.concatenate(columns) if columns else np.empty((0, len(weight)), np.float32),
        sums=_sums(cloud, which, radii),
        material=np.empty((0, len(weight)), np.uint16) if cloud.material is None else cloud.material[None, which],
    )  # fmt: skip


def _sums(cloud: PointCloud, which: slice, radii: np.ndarray) -> np.ndarray:
    """Quantities (B, n) of points that add up, none for clouds that are simply opaque.

    Of media the optical mass squared over the volume, the mass and the cross-section of each channel, a weight and the
    colour times it, and the volume times the emission. Of shells the area, the optical mass and the cross-section.
    """
    if cloud.radii is None or (cloud.extinction is None and cloud.opacity is None):
        return np.empty((0, radii.shape[1]))
    area = _footprint(cloud, radii)
    if cloud.extinction is None:
        with np.errstate(divide="ignore"):
            depth = -np.log1p(-np.clip(_rows(cloud.opacity, which).astype(np.float64), 0, 1))  # type: ignore[arg-type]
        depth = np.minimum(depth, OPAQUE)
        return np.concatenate([area[None], area * depth, area * absorbed(depth)])
    volume = 4 / 3 * np.pi * np.prod(radii, axis=0)
    mass = volume * np.maximum(_rows(cloud.extinction, which), 0)
    mean = mass.mean(axis=0)
    rows = [(mean**2 / np.maximum(volume, 1e-150))[None], mass, area * absorbed(mass / area)]
    if cloud.color is not None:
        # What is not there has a colour, too: one that only counts among its like.
        weight = np.maximum(mean, 1e-60)
        rows += [weight[None], weight * _rows(cloud.color, which)]
    if cloud.emission is not None:
        rows.append(volume * _rows(cloud.emission, which))
    return np.concatenate(rows)


def _footprint(cloud: PointCloud, radii: np.ndarray) -> np.ndarray:
    """(n,) area of ellipsoids of half-axes (3, n): of media that of a disk as wide as the ball of the same volume; of
    shells half the surface, which is twice what is seen of it on average, and of flat ones their area."""
    if cloud.extinction is not None:
        return np.pi * np.cbrt(np.prod(np.maximum(radii.astype(np.float64), 1e-30), axis=0)) ** 2
    return half_surface(radii)


def half_surface(radii: np.ndarray) -> np.ndarray:
    """(n,) half the surface of ellipsoids of half-axes (3, n): the area of flat ones. Thomsen's approximation with the
    exponent that makes disks exact, as balls are anyway."""
    a, b, c = np.maximum(radii.astype(np.float64), 1e-30)
    power = np.log(3) / np.log(2)
    return 2 * np.pi * (((a * b) ** power + (a * c) ** power + (b * c) ** power) / 3) ** (1 / power)


def _drawn(cloud: PointCloud, radii: np.ndarray) -> np.ndarray:
    """Half-axes (3, n) by which nodes of these kernels are drawn: as they are where they are opaque."""
    if cloud.extinction is None and cloud.opacity is None:
        return radii
    if cloud.normal is None:
        radii = np.broadcast_to(np.sqrt((radii.astype(np.float64) ** 2).mean(axis=0)), radii.shape)
    return radii if cloud.extinction is None else WIDER * radii


def absorbed(depth: np.ndarray) -> np.ndarray:
    """The cross-section of a kernel, the integral of 1 - exp(-tau) over the plane, in areas of its ellipse (rim at
    2 sigma), float64. `depth` is its optical mass in the same unit: the mean depth of the ellipse."""
    x, y = _absorption()
    thin = np.asarray(depth, np.float64)
    return np.where(thin < x[0], thin, np.exp(np.interp(np.log(np.maximum(thin, x[0])), np.log(x), np.log(y))))


def even(depth: np.ndarray) -> np.ndarray:
    """The mean depth of the kernel that has the cross-section of an ellipse of an even depth: equal to it in the
    first two orders, and less than 2.2 where the ellipse is opaque."""
    x, y = _absorption()
    wanted = -np.expm1(-np.asarray(depth, np.float64))
    return np.where(wanted < y[0], depth, np.exp(np.interp(np.log(np.maximum(wanted, y[0])), np.log(y), np.log(x))))


@cache
def _absorption() -> tuple[np.ndarray, np.ndarray]:
    """Mean depths, evenly spaced in the logarithm, and `absorbed` of them, by Simpson's rule."""
    depth = np.geomspace(1e-5, 1e9, 2801)
    # With q = SUPPORT (1 - x^4), dx dy is pi a b dq / 4; the fourth power spreads the rim, where deep kernels end.
    x = np.linspace(0, 1, 513)
    simpson = np.r_[1, np.tile([4, 2], 255), 4, 1] * (x[1] - x[0]) / 3
    absorbs = -np.expm1(-2 * depth[:, None] * kernel(SUPPORT * (1 - x**4)))
    return depth, absorbs @ (simpson * SUPPORT * x**3)


def _merge(rows: _Rows, count: np.ndarray, cloud: PointCloud) -> _Rows:
    """Merge consecutive runs of `count` rows of a cloud into one row each."""
    begin = starts(count)
    owner = owners(count)

    # Moments about each parent's own mean.
    weight = np.add.reduceat(rows.weight, begin)
    mean = np.add.reduceat(rows.weight * rows.mean, begin, axis=1) / weight
    step = rows.mean - mean.take(owner, axis=1)
    second = np.add.reduceat(rows.second + rows.weight * outer(step), begin, axis=1)

    # The kernel, in the plane of the mean normal where there is one.
    facing = np.add.reduceat(rows.weight * rows.facing, begin, axis=1) / weight
    normal, axis, radii, flat = _kernel(second / weight, facing)

    # Bounds: about the rounded center and in the rounded frame that they will be used with.
    center = mean.astype(np.float32)
    bound, sphere = _bounds(rows, begin, owner, center, normal, axis, radii)
    angle = 2 * np.arcsin(np.minimum(_length(rows.normal - normal.take(owner, axis=1)) / 2, 1))
    angle = np.maximum.reduceat(angle + rows.angle, begin) + 1e-6
    smallest = np.minimum.reduceat(rows.smallest, begin)
    sums = np.add.reduceat(rows.sums, begin, axis=1)
    size = np.minimum(sphere, np.hypot(bound[0], bound[2]))
    single = (count == 1) & np.isinf(smallest)

    return _Rows(
        weight, mean, second, facing, center, normal, axis, radii, bound, sphere,
        angle=np.where(flat, np.minimum(angle, np.pi), np.pi),
        smallest=np.where(single, np.inf, np.minimum(smallest, size)),
        averages=np.add.reduceat(rows.weight * rows.averages, begin, axis=1) / weight,
        sums=_sheets(cloud, sums, radii) if len(sums) and cloud.extinction is None else sums,
        material=_heaviest(rows, begin, owner),
    )  # fmt: skip


def _kernel(covariance: np.ndarray, facing: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Normal, major axis and half-axes (3, n) float32 of covariances (6, n), and where a mean normal exists (n,).

    In the plane of the mean normal the eigenvalues are those of the projected covariance (Pajarola 2003,
    section 4, with the sign of equation 5 corrected); where normals cancel or are absent, of all three dimensions.
    """
    length = _length(facing)
    flat = length > 1e-3
    if not flat.any():
        return *principal(covariance), flat
    normal = np.where(flat, facing / np.maximum(length, 1e-3), [[0.0], [0.0], [1.0]]).astype(np.float32)
    u, v = basis(normal.astype(np.float64))
    uu, uv, vv = _form(covariance, u, u), _form(covariance, u, v), _form(covariance, v, v)

    # Half the angle whose cosine is (uu - vv) / 2 over the root of the discriminant.
    middle, difference = (uu + vv) / 2, (uu - vv) / 2
    root = np.hypot(difference, uv)
    cosine = difference / np.maximum(root, np.finfo(float).tiny)
    axis = np.sqrt(np.clip((1 + cosine) / 2, 0, 1)) * u + np.copysign(np.sqrt(np.clip((1 - cosine) / 2, 0, 1)), uv) * v
    variance = np.stack([middle + root, middle - root, _form(covariance, normal, normal)])
    axis, radii = axis.astype(np.float32), (2 * np.sqrt(np.maximum(variance, 0))).astype(np.float32)

    rest = np.flatnonzero(~flat)
    if len(rest):
        normal[:, rest], axis[:, rest], radii[:, rest] = principal(covariance[:, rest])
    return normal, axis, radii, flat


def principal(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Last and first principal axis and the half-axes (major, middle, minor) of covariances (6, n), float32."""
    matrix = covariance[[0, 1, 2, 1, 3, 4, 2, 4, 5]].T.reshape(-1, 3, 3)
    scale = np.maximum(np.abs(matrix).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
    variance, vectors = np.linalg.eigh(matrix / scale)
    radii = 2 * np.sqrt(np.maximum(variance[:, ::-1], 0) * scale[:, :, 0])
    normal, axis = vectors[:, :, 0], vectors[:, :, 2]
    return normal.T.astype(np.float32), axis.T.astype(np.float32), radii.T.astype(np.float32)


def _bounds(
    rows: _Rows,
    begin: np.ndarray,
    owner: np.ndarray,
    center: np.ndarray,
    normal: np.ndarray,
    axis: np.ndarray,
    radii: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Grow the kernel until its cylinder holds those of the rows: (3, n) half-axes; and the ball: (n,) radius."""
    binormal = _cross(normal, axis).astype(np.float64)
    major = np.maximum(radii[0].astype(np.float64), 1e-30)
    minor = np.maximum(radii[1], THIN * major)

    # Where the parent's ellipse is the unit circle, a row's base is an ellipse of known center and largest half-axis.
    a = (axis / major).take(owner, axis=1)
    b = (binormal / minor).take(owner, axis=1)
    n = normal.take(owner, axis=1).astype(np.float64)
    step = rows.center.astype(np.float64) - center.take(owner, axis=1)
    e0 = rows.axis * rows.bound[0].astype(np.float64)
    e1 = _cross(rows.normal, rows.axis) * rows.bound[1].astype(np.float64)
    e2 = rows.normal * rows.bound[2].astype(np.float64)
    a0, a1, a2, b0, b1, b2 = _dot(a, e0), _dot(a, e1), _dot(a, e2), _dot(b, e0), _dot(b, e1), _dot(b, e2)
    trace = a0 * a0 + a1 * a1 + b0 * b0 + b1 * b1
    determinant = a0 * b1 - a1 * b0
    largest = np.sqrt((trace + np.sqrt(np.maximum(trace * trace - 4 * determinant * determinant, 0))) / 2)
    reach = np.minimum(largest + np.hypot(a2, b2), rows.sphere / minor.take(owner))
    scale = np.maximum.reduceat(np.hypot(_dot(a, step), _dot(b, step)) + reach, begin)

    n0, n1, n2 = _dot(n, e0), _dot(n, e1), _dot(n, e2)
    height = np.abs(_dot(n, step)) + np.minimum(np.hypot(n0, n1) + np.abs(n2), rows.sphere)
    height = np.maximum.reduceat(height, begin)
    bound = np.stack([scale * major, scale * minor, height])

    sphere = np.maximum.reduceat(_length(step) + rows.sphere, begin)
    sphere = np.minimum(sphere, np.hypot(np.maximum(bound[0], bound[1]), bound[2]))
    return (bound * ROUNDING).astype(np.float32), (sphere * ROUNDING).astype(np.float32)


def _heaviest(rows: _Rows, begin: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """The material of the heaviest row of each run, the first of them where several are."""
    if len(rows.material) == 0:
        return np.empty((0, len(begin)), np.uint16)
    top = np.flatnonzero(rows.weight == np.maximum.reduceat(rows.weight, begin).take(owner))
    _, first = np.unique(owner[top], return_index=True)
    return rows.material[:, top[first]]


def _merge_all(cloud: PointCloud, tree: Tree) -> _Rows:
    """The rows of all nodes: leaves from their points, then level above level, in pieces that fit the cache."""
    nodes = _Rows.empty(_point_rows(cloud, slice(0, 0)), len(tree))
    leaves = _leaves_in_tree_order(tree, len(cloud))
    begin = np.append(tree.first_point[leaves], len(cloud))
    for a, b in batches(tree.point_count[leaves], CHUNK):
        rows = _point_rows(cloud, slice(begin[a], begin[b]))
        nodes.put(leaves[a:b], _merge(rows, tree.point_count[leaves[a:b]], cloud))
    for first, last in zip(tree.levels[-2::-1], tree.levels[:0:-1], strict=True):
        parents = first + np.flatnonzero(tree.child_count[first:last])
        count = tree.child_count[parents].astype(np.int64)
        for a, b in batches(count, CHUNK):
            begin = tree.first_child[parents[a]]
            end = tree.first_child[parents[b - 1]] + count[b - 1]
            nodes.put(parents[a:b], _merge(nodes.take(slice(begin, end)), count[a:b], cloud))
    return nodes


def sum_up(tree: Tree, points: int, columns: Callable[[slice], np.ndarray]) -> np.ndarray:
    """Sums (B, M) over nodes of what `columns` gives for a range of points in tree order, bottom up."""
    total = np.empty((len(columns(slice(0, 0))), len(tree)))
    leaves = _leaves_in_tree_order(tree, points)
    begin = np.append(tree.first_point[leaves], points)
    for a, b in batches(tree.point_count[leaves], CHUNK):
        total[:, leaves[a:b]] = np.add.reduceat(columns(slice(begin[a], begin[b])), begin[a:b] - begin[a], axis=1)
    for first, last in zip(tree.levels[-2::-1], tree.levels[:0:-1], strict=True):
        parents = first + np.flatnonzero(tree.child_count[first:last])
        if len(parents):
            begin, end = tree.first_child[parents], tree.first_child[parents[-1]] + tree.child_count[parents[-1]]
            total[:, parents] = np.add.reduceat(total[:, begin[0] : end], begin - begin[0], axis=1)
    return total


def _leaves_in_tree_order(tree: Tree, points: int) -> np.ndarray:
    """Indices (K,) of the leaves in the order of their points, which they tile."""
    at = np.full(points, -1, np.int32)
    leaves = np.flatnonzero(tree.child_count == 0)
    at[tree.first_point[leaves]] = leaves
    return at[at >= 0]


def _evaluate(cloud: PointCloud, order: np.ndarray, tree: Tree) -> Hierarchy:
    """Attributes of all nodes over points in tree order."""
    rows = _merge_all(cloud, tree)
    named = _averages(cloud, rows.averages)
    if len(rows.sums):
        named |= _optics(cloud, rows.radii, rows.sums)
    if cloud.apart is not None:
        named |= _gaps(cloud, tree, rows.radii)
    return Hierarchy(
        cloud, order, tree,
        center=_columns(rows.center), normal=_columns(rows.normal), axis=_columns(rows.axis),
        radii=_columns(rows.radii), bound=_columns(rows.bound), sphere=rows.sphere,
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
        named[name] = _columns(averages[at : at + width]).reshape(-1, *given.shape[1:])
        at += width
    return named


def _optics(cloud: PointCloud, radii: np.ndarray, sums: np.ndarray) -> dict[str, np.ndarray]:
    """Optical mass, filled fraction, and the attributes by which nodes of these kernels (3, n) are drawn."""
    drawn = _drawn(cloud, radii)
    area = _footprint(cloud, drawn)
    if cloud.extinction is None:
        covered = _tiled(sums[0], radii)
        depth = _mixed(sums[1] / area, sums[2] / area, covered)
        named = {"mass": sums[1], "opacity": -np.expm1(-depth), "covered": covered}
        return {name: array.astype(np.float32) for name, array in named.items()}
    shape = cloud.extinction.shape[1:]
    channels = int(np.prod(shape))
    volume = np.maximum(4 / 3 * np.pi * np.prod(drawn.astype(np.float64), axis=0), 1e-60)
    mass, section, rest = np.split(sums[1:], [channels, 2 * channels])
    mean = mass.mean(axis=0)
    covered = np.clip(mean**2 / np.maximum(sums[0] * volume, 1e-300), 0, 1)
    extinction = area / volume * _mixed(even(mass / area), section / area, covered)
    named = {"mass": _columns(mass).reshape(-1, *shape), "extinction": _columns(extinction).reshape(-1, *shape)}
    if cloud.color is not None:
        named["color"] = _columns(rest[1:4] / rest[0])
    if cloud.emission is not None:
        named["emission"] = _columns(rest[-3:] / volume)
    return named | {"covered": covered.astype(np.float32)}


def _gaps(cloud: PointCloud, tree: Tree, radii: np.ndarray) -> dict[str, np.ndarray]:
    """Hierarchy.apart and .section of nodes of these kernels (3, M), from points in tree order.

    Disks of area s that are strewn over a cell of surface 2 S hide S (1 - exp(-s / S)) as one disk does, more by
    s_i^2 / 2 S, in the second order, since none hides itself.
    """
    cell = CELL * half_surface(radii)

    def columns(which: slice) -> np.ndarray:
        _, _, axes = frames(cloud, which)
        area = np.pi * axes[0] * axes[1]
        return np.stack([area, area**2, area * cloud.apart[which]])  # type: ignore[index]

    area, square, strewn = sum_up(tree, len(cloud), columns)
    section = np.minimum(cell * -np.expm1(-area / cell) + square / (2 * cell), area)
    return {"apart": strewn > 0.5 * area, "section": section.astype(np.float32)}


def _mixed(filled: np.ndarray, strewn: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """The depth of nodes that are filled over a part of their area, by the mean of the transmittances."""
    filled, strewn = np.minimum(filled, OPAQUE), np.minimum(strewn, np.minimum(filled, OPAQUE))
    apart = strewn - filled
    # The first form keeps the digits of small differences, the second what is left of the largest.
    return strewn - np.where(
        apart > -1, np.log1p(covered * np.expm1(apart)), np.log((1 - covered) + covered * np.exp(apart))
    )


def _tiled(area: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(n,) how far sheets of this area close a plane, instead of lying far apart in it, or behind one another.

    With the cube, opaque ones that cover a fraction f of a plane without overlap stop f of the light, within 0.032.
    """
    a, b, c = np.maximum(radii.astype(np.float64), 1e-30)
    return np.minimum(area / (np.pi * a * b), 1) ** 3 * np.clip(1 - 2 * c / b, 0, 1)


def _sheets(cloud: PointCloud, sums: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Area, optical mass and cross-section of merged shells, whose parts count once where they overlap."""
    area, mass, section = sums
    ellipse = _footprint(cloud, _drawn(cloud, radii))
    covered = _tiled(area, radii)
    whole = ellipse * -np.expm1(-mass / ellipse)
    return np.stack([np.minimum(area, ellipse), mass, section + covered * np.minimum(whole - section, 0)])


def _length(a: np.ndarray) -> np.ndarray:
    return np.sqrt(_dot(a, a)) if len(a) else np.zeros(a.shape[1])


def _form(matrix: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a^T M b for symmetric matrices (6, n)."""
    xx, xy, xz, yy, yz, zz = matrix
    return (
        a[0] * (xx * b[0] + xy * b[1] + xz * b[2])
        + a[1] * (xy * b[0] + yy * b[1] + yz * b[2])
        + a[2] * (xz * b[0] + yz * b[1] + zz * b[2])
    )


def _rows(array: np.ndarray, which: slice) -> np.ndarray:
    """(n,) or (n, k) to (k, n)."""
    return array[which].reshape(-1, int(np.prod(array.shape[1:]))).T


def _gather(cloud: PointCloud, order: np.ndarray) -> PointCloud:
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


def _columns(rows: np.ndarray) -> np.ndarray:
    """(k, n) to (n, k) float32."""
    return np.ascontiguousarray(rows.T, np.float32)


def check(cloud: PointCloud) -> None:
    """Raise ValueError for attributes that are not finite, or negative radii. Extremes propagate NaN."""
    for name, array in cloud.arrays().items():
        if array.size and array.dtype.kind == "f" and not np.isfinite([array.min(), array.max()]).all():
            raise ValueError(f"PointCloud.{name} holds a NaN or an infinity")
    if cloud.radii is not None and cloud.radii.size and cloud.radii.min() < 0:
        raise ValueError("PointCloud.radii holds a negative half-axis")
