"""Sorts splats back to front by a hierarchical bucket sort (Gunjee et al. 2007, section 4.2).

Splats are projected onto the view direction and fall into slices as thick as the smallest splat (of surfaces, a part
of it), counted from the farthest. Two tables of 65,536 buckets each, coarse and fine, number the slices; both are
filled in stable passes over 16-bit keys, fine before coarse, so that the cost is linear and splats of one slice keep
their order.

Translations of the camera shift all depths alike, and rotations about the view direction change none: neither calls for
another sort.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..numeric.linear import largest_singular_value
from ..numeric.record import record
from ..numeric.segments import ranges, starts
from ..scene.cloud import PointCloud
from .cut import Cut
from .hierarchy import Hierarchy

BUCKETS = 1 << 16  # of each table: the values of a 16-bit key
MAX_DEPTH = 1e300  # depths beyond it count as infinite, so that differences stay finite
OPAQUE_SLICES = 1 / 16  # of the smallest splat: of two opaque ones the right one has to hide the other
SHELL_SLICES = 1 / 1024  # of the smallest splat: panes of glass lie far closer to each other than their splats are wide
MIN_THICKNESS = 1e-300  # a slice: quotients by it keep their digits


@record
class Slices:
    """The K finite ones among some depths, back to front."""

    index: np.ndarray  # (K,) int64, rows of the depths
    slice: np.ndarray  # (K,) uint32, never decreasing: which slice each lies in, 0 the farthest
    thickness: float  # in the unit of the depths
    farthest: float  # of the depths


def back_to_front(depth: np.ndarray, smallest: float) -> Slices:
    """Sorts depths (N,) float32 or float64, which grow away from the eye, to slices of thickness `smallest`.

    Slices are thicker where more than 65,536^2 would be needed, and as thin as that allows where `smallest` is not
    positive. NaN and infinite depths are left out. Slice s holds the depths from which the farthest one is
    [s, s + 1) thicknesses away.
    """
    finite = np.abs(depth) <= min(MAX_DEPTH, float(np.finfo(depth.dtype).max))
    rows = None if finite.all() else np.flatnonzero(finite)
    if rows is not None:
        depth = depth.take(rows)
    if len(depth) == 0:
        return Slices(np.empty(0, np.int64), np.empty(0, np.uint32), MIN_THICKNESS, 0.0)
    number, thickness = _number(depth, smallest)
    index = np.argsort((number & (BUCKETS - 1)).astype(np.uint16), kind="stable")
    if int(number.max()) >= BUCKETS:
        coarse = (number >> 16).astype(np.uint16)
        index = index.take(np.argsort(coarse.take(index), kind="stable"))
    return Slices(index if rows is None else rows.take(index), number.take(index), thickness, float(depth.max()))


def _number(depth: np.ndarray, smallest: float) -> tuple[np.ndarray, float]:
    """The slice (N,) uint32 of finite depths, and the thickness of slices."""
    farthest = float(depth.max())
    extent = farthest - float(depth.min())
    thickness = max(extent / (BUCKETS**2 - 1), smallest if smallest > 0 else 0.0, MIN_THICKNESS)
    return (np.subtract(farthest, depth, dtype=np.float64) / thickness).astype(np.uint32), thickness


@record
class Order:
    """The splats of a cut back to front, for one view direction."""

    index: np.ndarray  # (K,) int64: rows of the cut's splats, counted range after range
    slice: np.ndarray  # (K,) uint32, 0 the farthest
    thickness: float  # of a slice, world units
    radius: float  # of a ball about all splats, world units
    direction: np.ndarray  # (3,) float64, unit, world space: where the camera looks
    farthest: float  # world units: distance of the farthest along the direction, from the world's origin
    cut: Cut

    @property
    def distance(self) -> np.ndarray:
        """(K,) float64: how far along the direction, from the world's origin, the slice of each splat lies."""
        return self.farthest - (self.slice + 0.5) * self.thickness

    def stale(self, view_from_world: np.ndarray, cut: Cut, exact: bool = False) -> bool:
        """Whether this view (4, 4) of this cut calls for another sort; `exact`: wherever it might change anything.

        It does for other splats, and for a camera turned so far that a splat may have moved by more than a slice
        relative to their common centre. Whether instances moved or geometry changed is for the caller to know.
        """
        turned = float(np.linalg.norm(_direction(view_from_world) - self.direction))
        return bool(turned * self.radius > (0.0 if exact else self.thickness)) or not _same(cut, self.cut)


def sort_cut(
    cut: Cut,
    geometries: Mapping[int, Hierarchy | PointCloud],
    geometry: np.ndarray,
    world_from_object: np.ndarray,
    view_from_world: np.ndarray,
) -> Order:
    """Sorts all splats of a cut that belong to `geometries`, those of all instances together.

    `geometry` (I,) holds the key into `geometries` of each instance, `world_from_object` is (I, 4, 4) float64;
    other instances' splats are left out, as are those of transforms that are not finite. Splats are counted as
    `node_splats.points_and_nodes` does.
    """
    direction, parts = _direction(view_from_world), []
    depth = np.full(int(cut.count.sum()), np.nan)
    begin, key = starts(cut.count), np.asarray(geometry)[cut.instance]
    known = np.isfinite(world_from_object[cut.instance]).all(axis=(1, 2))
    for which, entry in geometries.items():
        rows = np.flatnonzero((key == which) & known)
        if len(rows):
            part = _Part.of(entry, cut, rows, world_from_object[cut.instance[rows]])
            depth[_picked(begin[rows], cut.count[rows])] = part.depth(direction)
            parts.append(part)
    slices = back_to_front(depth, min((part.smallest for part in parts), default=0.0))
    corners = np.concatenate([np.empty((0, 3)), *(part.corners for part in parts)])
    radius = float(np.linalg.norm(np.ptp(corners, axis=0))) / 2 if len(corners) else 0.0
    return Order(slices.index, slices.slice, slices.thickness, radius, direction, slices.farthest, cut)


@record
class _Part:
    """The splats of one geometry in a cut, range after range."""

    position: np.ndarray  # (n, 3) float32, relative to the cloud's origin
    count: np.ndarray  # (r,) int64, splats of each range
    linear: np.ndarray  # (r, 3, 3) float64, world from object
    offset: np.ndarray  # (r, 3) float64, where the cloud's origin lies in the world
    smallest: float  # world units: a lower bound of all positive half-axes times the share that slices are of it

    @classmethod
    def of(cls, entry: Hierarchy | PointCloud, cut: Cut, rows: np.ndarray, matrix: np.ndarray) -> _Part:
        """The splats in the cut's ranges `rows`, whose transforms are `matrix` (r, 4, 4)."""
        cloud = entry if isinstance(entry, PointCloud) else entry.cloud
        position, size = cloud.position, _sizes(cloud)
        if isinstance(entry, Hierarchy):
            position = np.concatenate([position, entry.center])
            size = np.concatenate([size, entry.radii[:, 0 if cloud.normal is None else 1]])
        picked, linear = _picked(cut.first[rows], cut.count[rows]), matrix[:, :3, :3]
        size = size[picked]
        smallest = float(size.min(where=size > 0, initial=np.inf)) * _least_scale(linear)
        smallest *= _slices(cloud)
        return cls(position[picked], cut.count[rows], linear, linear @ cloud.origin + matrix[:, :3, 3], smallest)

    def depth(self, direction: np.ndarray) -> np.ndarray:
        """(n,) float64: distance along a world direction from the world's origin."""
        row, shift = np.einsum("i,rij->rj", direction, self.linear), self.offset @ direction
        if bool((row == row[:1]).all()) and bool((shift == shift[:1]).all()):
            return self.position @ row[0] + shift[0]
        return (self.position * np.repeat(row, self.count, axis=0)).sum(axis=1) + np.repeat(shift, self.count)

    @property
    def corners(self) -> np.ndarray:
        """The corners (8 r, 3) float64 in world space of a box around the positions, under each transform."""
        # Column by column: many times faster than along the first axis.
        box = np.stack(np.meshgrid(*((c.min(), c.max()) for c in self.position.T)), axis=-1).reshape(-1, 3)
        return (box @ self.linear.swapaxes(1, 2) + self.offset[:, None]).reshape(-1, 3)


def _sizes(cloud: PointCloud) -> np.ndarray:
    """The shorter half-axis in each splat's plane, or the radius of a ball; 0 without radii; (N,) float32."""
    if cloud.radii is None:
        return np.zeros(len(cloud), np.float32)
    return cloud.radii[:, 0] if cloud.normal is None else cloud.radii[:, :2].min(axis=1)


def _slices(cloud: PointCloud) -> float:
    """How thick slices are, over the smallest splat."""
    if cloud.extinction is not None:
        return 1.0
    return OPAQUE_SLICES if cloud.opacity is None else SHELL_SLICES


def _least_scale(linear: np.ndarray) -> float:
    """A lower bound of the least singular value of all matrices (r, 3, 3): determinants over the largest's square."""
    largest = np.maximum(largest_singular_value(linear), 1e-150)
    return float((np.abs(np.linalg.det(linear)) / largest**2).min())


def _picked(first: np.ndarray, count: np.ndarray) -> np.ndarray | slice:
    """The index of all elements of the ranges, one range after the other; a slice if there is only one range."""
    return slice(first[0], first[0] + count[0]) if len(first) == 1 else ranges(first, count)


def _direction(view_from_world: np.ndarray) -> np.ndarray:
    """(3,) float64, unit: where a camera that looks along -Z of its view space looks in the world."""
    forward = -np.asarray(view_from_world, np.float64)[2, :3]
    return forward / np.linalg.norm(forward)


def _same(a: Cut, b: Cut) -> bool:
    return a is b or all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("instance", "first", "count"))
