"""Packs a hierarchy for the disk: about 40 bytes per point with the nodes included.

Positions stay float32; `encoding.py` has the formats of normals, axes, lengths and colours. Of the links only the
number of children of each node and of points in each leaf is stored: breadth-first order gives the others. Bounds are
rounded outwards, far enough to hold the disks as they are unpacked.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..numeric.record import record, value_record
from ..scene.cloud import ATTRIBUTES, PointCloud
from .encoding import (
    LENGTH_ERROR,
    TILT,
    decode_axis,
    decode_length,
    decode_normal,
    decode_rgb,
    encode_axis,
    encode_length,
    encode_normal,
    encode_rgb,
)
from .hierarchy import GEOMETRY, NODE_ATTRIBUTES, Hierarchy, require_finite
from .nodes.tree import smallest_below, tree_from_counts

# All columns that points or nodes may have beside their geometry.
COLUMNS = {name: spec for name, spec in ATTRIBUTES.items() if name not in GEOMETRY} | NODE_ATTRIBUTES
# How a column is stored: "unorm" (2 bytes in [0, 1]), "byte" (1 byte in [0, 1]), "rgb" (RGB9E5), else in its own type.
CODES = {"color": "rgb", "emission": "rgb", "opacity": "unorm", "covered": "unorm", "surface": "byte"}
MAX_COLUMN_WIDTH = 64  # values of one column of one splat, where the table of attributes sets no shape


@value_record
class Layout:
    """Which attributes are present; the types of the records follow from it.

    Raises ValueError for attributes that neither points nor nodes have, and for shapes that they cannot have.
    """

    normal: bool  # whether points have one; nodes always do
    axis: bool
    radii: int  # half-axes of a point; 0: none
    attributes: tuple[tuple[str, tuple[int, ...]], ...]  # names in COLUMNS, and the shape of one value

    def __post_init__(self) -> None:
        for name, shape in self.attributes:
            if name not in COLUMNS:
                raise ValueError(f"unknown attribute {name!r}")
            expected = COLUMNS[name][0]
            fits = len(shape) <= 1 and all(type(n) is int and 0 < n <= MAX_COLUMN_WIDTH for n in shape)
            if not fits if expected is None else shape != expected:
                raise ValueError(f"impossible shape {shape} of {name}")
        if self.radii not in (0, 1, 2, 3) or len({name for name, _ in self.attributes}) < len(self.attributes):
            raise ValueError("impossible layout")

    def dtype(self, nodes: bool) -> np.dtype:
        """The record of a point or, with `nodes`, of a node; little-endian."""
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
        held = NODE_ATTRIBUTES if nodes else ATTRIBUTES
        record += [(name, *_stored(name, shape)) for name, shape in self.attributes if name in held]
        return np.dtype(record)


@record
class Packed:
    """A quantised hierarchy: N points in tree order and M nodes breadth first, as records of Layout.dtype."""

    layout: Layout
    points: np.ndarray  # (N,)
    nodes: np.ndarray  # (M,)
    order: np.ndarray  # (N,) int32
    origin: np.ndarray  # (3,) float64
    longest: float  # object units: the largest length that the codes of this hierarchy stand for

    @property
    def nbytes(self) -> int:
        """Bytes of the points, the nodes and the order."""
        return self.points.nbytes + self.nodes.nbytes + self.order.nbytes


def pack(hierarchy: Hierarchy) -> Packed:
    """Quantises a hierarchy. Colours and emission below 0 become 0; opacity, covered fraction and surface are clipped
    to [0, 1]."""
    cloud, tree = hierarchy.cloud, hierarchy.tree
    held = {name: getattr(hierarchy, name) for name in NODE_ATTRIBUTES if getattr(hierarchy, name) is not None}
    held |= {name: array for name, array in cloud.arrays().items() if name not in GEOMETRY}
    layout = Layout(
        normal=cloud.normal is not None,
        axis=cloud.normal is not None and cloud.axis is not None,
        radii=0 if cloud.radii is None else cloud.radii.shape[1],
        attributes=tuple((name, array.shape[1:]) for name, array in held.items()),
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
    for records, owner in ((points, cloud), (nodes, hierarchy)):
        for name in held.keys() & set(records.dtype.names or ()):
            records[name] = _encode(name, getattr(owner, name))
    return Packed(layout, points, nodes, hierarchy.order, cloud.origin, longest)


def unpack(packed: Packed) -> Hierarchy:
    """The hierarchy that was packed, up to quantisation.

    Raises ValueError where the links make no tree over the points, the order is no permutation, or a value is not
    finite: records may come from a damaged file.
    """
    points, nodes, layout = packed.points, packed.nodes, packed.layout
    tree = tree_from_counts(nodes["children"], nodes["points"], len(points))
    _check_order(packed.order)
    arrays: dict[str, np.ndarray] = {"position": _plain(points["position"])}
    if layout.normal:
        arrays["normal"] = decode_normal(points["normal"])
    if layout.axis:
        arrays["axis"] = decode_axis(points["normal"], points["angle"])
    if layout.radii:
        arrays["radii"] = decode_length(points["radii"], packed.longest)
    held = [name for name, _ in layout.attributes]
    arrays |= {name: _decode(name, points[name]) for name in held if name in ATTRIBUTES}
    columns = {name: _decode(name, nodes[name]) for name in held if name in NODE_ATTRIBUTES}
    center = _plain(nodes["position"])
    for array in (center, *columns.values()):
        if not np.isfinite(array).all():
            raise ValueError("a node holds a NaN or an infinity")
    cloud = PointCloud(origin=packed.origin, **arrays)
    require_finite(cloud)
    angle = nodes["cone"].astype(np.float64) * (np.pi / 65535)
    bound, sphere = decode_length(nodes["bound"], packed.longest), decode_length(nodes["sphere"], packed.longest)
    return Hierarchy(
        cloud, packed.order, tree, center=center, normal=decode_normal(nodes["normal"]),
        axis=decode_axis(nodes["normal"], nodes["angle"]), radii=decode_length(nodes["radii"], packed.longest),
        bound=bound, sphere=sphere, cone=np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32),
        smallest=smallest_below(tree, bound, sphere), **columns,
    )  # fmt: skip


def _check_order(order: np.ndarray) -> None:
    """Raises ValueError where `order` (N,) is no permutation of 0 to N - 1."""
    seen = np.zeros(len(order), bool)
    if len(order) and (order.min() < 0 or order.max() >= len(order)):
        raise ValueError("the order of points leaves their range")
    seen[order] = True
    if not seen.all():
        raise ValueError("the order of points is not a permutation")


def _rounded_bounds(hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray]:
    """The bounds (M, 3) and spheres (M,) grown by as much as quantisation may move rims of disks and frames of
    nodes."""
    bound, sphere = hierarchy.bound.astype(np.float64), hierarchy.sphere.astype(np.float64)
    moved = (np.maximum(bound[:, 0], bound[:, 1]) + bound[:, 2]) * (2 * TILT + LENGTH_ERROR)
    narrow = np.maximum(bound[:, :2].min(axis=1), np.finfo(float).tiny)
    bound[:, :2] *= (1 + moved / narrow)[:, None]
    bound[:, 2] += moved
    return bound, sphere * (1 + TILT + LENGTH_ERROR)


def _stored(name: str, shape: tuple[int, ...]) -> tuple[str, tuple[int, ...]]:
    """The type and shape of a column in a record."""
    kind = CODES.get(name)
    if kind == "rgb":
        return "<u4", ()
    plain = np.dtype(COLUMNS[name][1]).newbyteorder("<").str
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
    """A contiguous copy of a column of records, in native byte order."""
    return np.ascontiguousarray(column, column.dtype.newbyteorder("="))
