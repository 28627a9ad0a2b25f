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
from .hierarchy import Hierarchy, require_finite
from .nodes.rows import AVERAGED
from .nodes.tree import smallest_below, tree_from_counts

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
    tree = tree_from_counts(nodes["children"], nodes["points"], len(points))
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
    require_finite(cloud)
    angle = nodes["cone"].astype(np.float64) * (np.pi / 65535)
    bound, sphere = decode_length(nodes["bound"], packed.longest), decode_length(nodes["sphere"], packed.longest)
    return Hierarchy(
        cloud, packed.order, tree, center=center, normal=decode_normal(nodes["normal"]),
        axis=decode_axis(nodes["normal"], nodes["angle"]), radii=decode_length(nodes["radii"], packed.longest),
        bound=bound, sphere=sphere, cone=np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32),
        smallest=smallest_below(tree, bound, sphere), **averages,
    )  # fmt: skip


def _check_order(order: np.ndarray) -> None:
    seen = np.zeros(len(order), bool)
    if len(order) and (order.min() < 0 or order.max() >= len(order)):
        raise ValueError("the order of points leaves their range")
    seen[order] = True
    if not seen.all():
        raise ValueError("the order of points is not a permutation")


def _rounded_bounds(hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (M, 3) and (M,) grown by how far quantisation moves the rims of disks and the frame of the node."""
    bound, sphere = hierarchy.bound.astype(np.float64), hierarchy.sphere.astype(np.float64)
    moved = (np.maximum(bound[:, 0], bound[:, 1]) + bound[:, 2]) * (2 * TILT + LENGTH_ERROR)
    narrow = np.maximum(bound[:, :2].min(axis=1), np.finfo(float).tiny)
    bound[:, :2] *= (1 + moved / narrow)[:, None]
    bound[:, 2] += moved
    return bound, sphere * (1 + TILT + LENGTH_ERROR)


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
