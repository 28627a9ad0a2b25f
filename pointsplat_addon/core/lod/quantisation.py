"""The packed form of a hierarchy, for disk and device: about 40 bytes per point with the nodes included.

Positions stay float32. Normals are octahedral (Meyer et al. 2010) in 2 x 16 bit, the major axis is an angle about
the normal, lengths are 16-bit logarithms, colours share an exponent (RGB9E5). Of the links only the number of
children and of a leaf's points is kept: breadth-first order gives the others. Bounds are rounded outwards, far
enough to hold the disks as they are unpacked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..numeric.segments import starts
from ..scene.cloud import ATTRIBUTES, PointCloud
from .hierarchy import AVERAGED, Hierarchy, basis, check
from .octree import MAX_DEPTH, Tree, link

OCTAVES = 40  # range of lengths below the longest one
STEPS = 65534 / OCTAVES  # code values per octave; 0 is length 0
LENGTH_ERROR = 2.2e-4  # relative: half a step
TILT = 1e-4  # radians by which quantised normals and axes are off at most

# How an attribute is kept: "unorm" (2 bytes in [0, 1]), "byte" (1 byte in [0, 1]), "rgb" (RGB9E5), or as it is.
CODES = {"color": "rgb", "emission": "rgb", "opacity": "unorm", "covered": "unorm", "surface": "byte"}


@dataclass(frozen=True)
class Layout:
    """Which attributes are there; the record types follow from it."""

    normal: bool
    axis: bool
    radii: int  # columns of the points' half-axes; 0: none
    attributes: tuple[tuple[str, tuple[int, ...]], ...]  # name and the shape of one value

    def dtype(self, nodes: bool) -> np.dtype:
        """Record of a point or of a node."""
        record: list[Any] = [("position", "<f4", (3,))]
        if self.normal or nodes:
            record.append(("normal", "<u2", (2,)))
        if self.axis or nodes:
            record.append(("angle", "<u2"))
        if self.radii or nodes:
            record.append(("radii", "<u2", (3 if nodes else self.radii,)))
        if nodes:
            record += [
                ("bound", "<u2", (3,)),
                ("sphere", "<u2"),
                ("cone", "<u2"),
                ("children", "u1"),
                ("points", "<u4"),
            ]
        for name, shape in self.attributes:
            if nodes or name not in ("mass", "covered", "section"):
                record.append((name, *_stored(name, shape)))
        return np.dtype(record)


@dataclass(frozen=True, eq=False)
class Packed:
    """N points in tree order and M nodes breadth first, as records of Layout.dtype."""

    layout: Layout
    points: np.ndarray  # (N,)
    nodes: np.ndarray  # (M,)
    order: np.ndarray  # (N,) int32
    origin: np.ndarray  # (3,) float64
    longest: float  # the length of the largest code

    @property
    def nbytes(self) -> int:
        return self.points.nbytes + self.nodes.nbytes + self.order.nbytes


def pack(hierarchy: Hierarchy) -> Packed:
    """Quantise. Colours and emission below 0 become 0, and unit-range attributes are clipped to [0, 1]."""
    cloud, tree = hierarchy.cloud, hierarchy.tree
    names = [
        name
        for name in (*AVERAGED, "material", "kernel", "mass", "covered", "apart", "section")
        if getattr(hierarchy, name) is not None
    ]
    layout = Layout(
        normal=cloud.normal is not None,
        axis=cloud.normal is not None and cloud.axis is not None,
        radii=0 if cloud.radii is None else cloud.radii.shape[1],
        attributes=tuple((name, getattr(hierarchy, name).shape[1:]) for name in names),
    )
    points, nodes = np.zeros(len(cloud), layout.dtype(False)), np.zeros(len(tree), layout.dtype(True))
    bound, sphere = _rounded_bounds(hierarchy)
    lengths = [a for a in (cloud.radii, hierarchy.radii, bound, sphere) if a is not None]
    longest = max(float(a.max(initial=0)) for a in lengths) or 1.0

    points["position"], nodes["position"] = cloud.position, hierarchy.center
    if cloud.normal is not None:
        points["normal"] = encode_normal(cloud.normal)
        if cloud.axis is not None:
            points["angle"] = encode_axis(points["normal"], cloud.axis)
    if cloud.radii is not None:
        points["radii"] = encode_length(cloud.radii, longest)
    nodes["normal"] = encode_normal(hierarchy.normal)
    nodes["angle"] = encode_axis(nodes["normal"], hierarchy.axis)
    nodes["radii"] = encode_length(hierarchy.radii, longest)
    nodes["bound"], nodes["sphere"] = encode_length(bound, longest, up=True), encode_length(sphere, longest, up=True)
    angle = np.arctan2(hierarchy.cone[:, 1], hierarchy.cone[:, 0]) % (2 * np.pi) + 2 * TILT
    nodes["cone"] = np.ceil(np.minimum(angle / np.pi, 1) * 65535)
    nodes["children"] = tree.child_count
    nodes["points"] = np.where(tree.child_count == 0, tree.point_count, 0)
    for name in names:
        nodes[name] = _encode(name, getattr(hierarchy, name))
        if name in (points.dtype.names or ()):
            points[name] = _encode(name, getattr(cloud, name))
    return Packed(layout, points, nodes, hierarchy.order, cloud.origin, longest)


def unpack(packed: Packed) -> Hierarchy:
    """The hierarchy again, but for quantisation. Raises ValueError where the links make no tree over the points,
    the order is no permutation, or a value is not finite."""
    points, nodes, layout = packed.points, packed.nodes, packed.layout
    tree = relink(nodes["children"], nodes["points"], len(points))
    _check_order(packed.order)
    arrays: dict[str, np.ndarray] = {"position": _plain(points["position"])}
    if layout.normal:
        arrays["normal"] = decode_normal(points["normal"])
    if layout.axis:
        arrays["axis"] = decode_axis(points["normal"], points["angle"])
    if layout.radii:
        arrays["radii"] = decode_length(points["radii"], packed.longest)
    averages: dict[str, np.ndarray] = {}
    for name, _ in layout.attributes:
        averages[name] = _decode(name, nodes[name])
        if name in (points.dtype.names or ()):
            arrays[name] = _decode(name, points[name])
    center = _plain(nodes["position"])
    for held in (center, *averages.values()):
        if not np.isfinite(held).all():
            raise ValueError("a node holds a NaN or an infinity")
    cloud = PointCloud(origin=packed.origin, **arrays)
    check(cloud)
    angle = nodes["cone"].astype(np.float64) * (np.pi / 65535)
    bound, sphere = decode_length(nodes["bound"], packed.longest), decode_length(nodes["sphere"], packed.longest)
    return Hierarchy(
        cloud, packed.order, tree, center=center, normal=decode_normal(nodes["normal"]),
        axis=decode_axis(nodes["normal"], nodes["angle"]), radii=decode_length(nodes["radii"], packed.longest),
        bound=bound, sphere=sphere, cone=np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32),
        smallest=_smallest(tree, bound, sphere), **averages,
    )  # fmt: skip


def relink(child_count: np.ndarray, leaf_points: np.ndarray, points: int) -> Tree:
    """All links from the number of children of every node and of points in every leaf.

    Raises ValueError where they do not make one breadth-first tree over `points` points.
    """
    child_count, nodes = np.ascontiguousarray(child_count), len(child_count)
    if nodes == 0 and points == 0:
        return link(child_count, np.empty(0, np.int32), np.empty(0, np.int32), np.zeros(1, np.int64))
    if nodes == 0 or int(child_count.sum(dtype=np.int64)) != nodes - 1:
        raise ValueError(f"{nodes} nodes have {int(child_count.sum(dtype=np.int64))} children in total")
    below = np.cumsum(child_count, dtype=np.int64)
    levels = [0, 1]
    while levels[-1] < nodes:
        levels.append(1 + int(below[levels[-1] - 1]))
        if levels[-1] == levels[-2] or len(levels) > MAX_DEPTH + 2:
            raise ValueError("nodes are not connected to the root, or in too many levels")

    # Points are counted upward, then every node hands ranges down to its children.
    count = np.where(child_count == 0, leaf_points, 0).astype(np.int64)
    if int(count.sum()) != points or (count[child_count == 0] == 0).any():
        raise ValueError(f"leaves hold {int(count.sum())} of {points} points, or none")
    first = np.zeros(nodes, np.int64)
    families = [_family(child_count, *levels[i : i + 3]) for i in range(len(levels) - 2)]
    for parents, children, begin in reversed(families):
        count[parents] = np.add.reduceat(count[children], begin)
    for parents, children, begin in families:
        before = starts(count[children])
        first[children] = np.repeat(first[parents] - before[begin], child_count[parents]) + before
    return link(child_count, first.astype(np.int32), count.astype(np.int32), np.array(levels))


def _check_order(order: np.ndarray) -> None:
    seen = np.zeros(len(order), bool)
    if len(order) and (order.min() < 0 or order.max() >= len(order)):
        raise ValueError("the order of points leaves their range")
    seen[order] = True
    if not seen.all():
        raise ValueError("the order of points is not a permutation")


def _family(child_count: np.ndarray, low: int, middle: int, high: int) -> tuple[np.ndarray, slice, np.ndarray]:
    """The parents in a level, the slice of all their children, and where in it each parent's begin."""
    parents = low + np.flatnonzero(child_count[low:middle])
    return parents, slice(middle, high), starts(child_count[parents])


def _smallest(tree: Tree, bound: np.ndarray, sphere: np.ndarray) -> np.ndarray:
    """Hierarchy.smallest, from the bounds."""
    size = np.minimum(sphere, np.hypot(bound[:, 0], bound[:, 2]))
    smallest = np.where(tree.point_count > 1, size, np.float32(np.inf))
    for i in range(len(tree.levels) - 3, -1, -1):
        parents, children, begin = _family(tree.child_count, *tree.levels[i : i + 3])
        smallest[parents] = np.minimum(smallest[parents], np.minimum.reduceat(smallest[children], begin))
    return smallest


def _rounded_bounds(hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (M, 3) and (M,) grown by how far quantisation moves the rims of disks and the frame of the node."""
    bound, sphere = hierarchy.bound.astype(np.float64), hierarchy.sphere.astype(np.float64)
    moved = (np.maximum(bound[:, 0], bound[:, 1]) + bound[:, 2]) * (2 * TILT + LENGTH_ERROR)
    narrow = np.maximum(bound[:, :2].min(axis=1), np.finfo(float).tiny)
    bound[:, :2] *= (1 + moved / narrow)[:, None]
    bound[:, 2] += moved
    return bound, sphere * (1 + TILT + LENGTH_ERROR)


def encode_normal(normal: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) to octahedral coordinates (n, 2) uint16."""
    n = normal.astype(np.float64)
    n /= np.maximum(np.abs(n).sum(axis=1, keepdims=True), 1e-30)
    folded = (1 - np.abs(n[:, 1::-1])) * np.copysign(1.0, n[:, :2])
    square = np.where(n[:, 2:] < 0, folded, n[:, :2])
    return np.round(np.clip(square * 0.5 + 0.5, 0, 1) * 65535).astype(np.uint16)


def decode_normal(code: np.ndarray) -> np.ndarray:
    """Octahedral coordinates (n, 2) uint16 to unit vectors (n, 3) float32."""
    x, y = (code.astype(np.float64) * (2 / 65535) - 1).T
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    n = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    return (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)


def encode_axis(normal_code: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Axes (n, 3), whose sign does not matter, as (n,) uint16: the angle from the first vector of `basis`, over pi."""
    u, v = basis(decode_normal(normal_code).T.astype(np.float64))
    angle = np.arctan2((v * axis.T).sum(axis=0), (u * axis.T).sum(axis=0))
    return (np.round(angle * (65536 / np.pi)).astype(np.int64) & 65535).astype(np.uint16)


def decode_axis(normal_code: np.ndarray, code: np.ndarray) -> np.ndarray:
    """Axes (n, 3) float32, perpendicular to the decoded normals."""
    u, v = basis(decode_normal(normal_code).T.astype(np.float64))
    angle = code.astype(np.float64) * (np.pi / 65536)
    return np.ascontiguousarray((np.cos(angle) * u + np.sin(angle) * v).T, np.float32)


def encode_length(length: np.ndarray, longest: float, up: bool = False) -> np.ndarray:
    """Lengths in [0, longest] as uint16 logarithms, nearest or rounded up; what is too short for the range becomes 0,
    or the shortest length where rounded up."""
    with np.errstate(divide="ignore"):
        code = 65535 + STEPS * np.log2(length.astype(np.float64) / longest)
    code = np.ceil(code) if up else np.round(code)
    code = np.where(length > 0, np.clip(code, 1 if up else 0, 65535), 0)
    return code.astype(np.uint16)


def decode_length(code: np.ndarray, longest: float) -> np.ndarray:
    """float32, of any shape."""
    length = longest * np.exp2((code.astype(np.float64) - 65535) / STEPS)
    return np.where(code > 0, length * (1 + 1e-7), 0).astype(np.float32)


def encode_rgb(color: np.ndarray) -> np.ndarray:
    """(n, 3) of at least 0 to (n,) uint32 RGB9E5 (OpenGL's GL_UNSIGNED_INT_5_9_9_9_REV)."""
    c = np.clip(color.astype(np.float64), 0, 65408)
    exponent = np.maximum(np.frexp(c.max(axis=1))[1], -15)
    # Rounding may carry the largest mantissa to 512.
    exponent += np.round(np.ldexp(c.max(axis=1), 9 - exponent)) >= 512
    mantissa = np.round(np.ldexp(c, (9 - exponent)[:, None])).astype(np.uint32)
    shared = (exponent + 15).astype(np.uint32)
    return mantissa[:, 0] | mantissa[:, 1] << 9 | mantissa[:, 2] << 18 | shared << 27


def decode_rgb(code: np.ndarray) -> np.ndarray:
    """(n,) uint32 RGB9E5 to (n, 3) float32."""
    mantissa = np.stack([code & 511, code >> 9 & 511, code >> 18 & 511], axis=1).astype(np.float32)
    return np.ldexp(mantissa, (code >> 27).astype(np.int32)[:, None] - 24)


def _stored(name: str, shape: tuple[int, ...]) -> tuple[str, tuple[int, ...]]:
    """Type and shape of an attribute in a record."""
    kind = CODES.get(name)
    if kind == "rgb":
        return "<u4", ()
    plain = np.dtype(ATTRIBUTES[name][1] if name in ATTRIBUTES else np.float32).newbyteorder("<").str
    return {"unorm": "<u2", "byte": "u1"}.get(kind or "", plain), shape


def _encode(name: str, array: np.ndarray) -> np.ndarray:
    kind = CODES.get(name)
    if kind == "rgb":
        return encode_rgb(array)
    top = {"unorm": 65535, "byte": 255}.get(kind or "")
    return array if top is None else np.round(np.clip(array, 0, 1) * np.float64(top))


def _decode(name: str, code: np.ndarray) -> np.ndarray:
    kind = CODES.get(name)
    if kind == "rgb":
        return decode_rgb(code)
    top = {"unorm": 65535, "byte": 255}.get(kind or "")
    return _plain(code) if top is None else (code / np.float64(top)).astype(np.float32)


def _plain(column: np.ndarray) -> np.ndarray:
    """A column of records on its own, in native byte order."""
    return np.ascontiguousarray(column, column.dtype.newbyteorder("="))
