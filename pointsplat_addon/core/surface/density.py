"""How densely a view needs a mesh sampled: the object-space length that nowhere projects to more than a pixel."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..numeric.linear import all_finite, largest_singular_value
from ..numeric.record import record
from ..numeric.vectors import blocks, clip, cross, dot, each_block
from ..scene.bounds import bounding_box
from ..scene.camera import Camera
from ..scene.mesh import Mesh
from .spacing import MAX_SAMPLES, limit_spacing

EXACT_INSTANCES = 64  # beyond these the next instance's bounding box speaks for all others: finer, never coarser
PART = 128  # triangles
JUDGED = 256  # parts that tell whether a mesh's order jumps about
SMALL = 8 * PART  # triangles: looking takes longer than drawing them in any order
SCATTERED = 0.4  # of a mesh's size: where its parts are larger, on average, another order is worth its time
_CORNERS = np.array(np.meshgrid([False, True], [False, True], [False, True], indexing="ij")).reshape(3, 8)


@record
class Parts:
    """Valid triangles in parts that lie together, and their boxes: most parts then need no closer look."""

    triangles: np.ndarray  # (M, 3) int32, rows of Mesh.position
    low: np.ndarray  # (B, 3) float64, lower corner of the box around each PART triangles
    high: np.ndarray  # (B, 3) float64
    order: np.ndarray | None = None  # (M,) which of the valid triangles each is; None: as they come

    def __len__(self) -> int:
        return len(self.low)

    @property
    def nbytes(self) -> int:
        arrays = (self.triangles, self.low, self.high, self.order)
        return sum(a.nbytes for a in arrays if a is not None)

    @property
    def counts(self) -> np.ndarray:
        """(B,) int64: triangles of each part."""
        return np.minimum(PART, len(self.triangles) - PART * np.arange(len(self)))

    def number(self) -> np.ndarray:
        """(M,) int32: the part of each valid triangle, in the mesh's own order."""
        number = np.arange(len(self.triangles), dtype=np.int32) // PART
        if self.order is None:
            return number
        result = np.empty_like(number)
        result[self.order] = number
        return result


def make_parts(mesh: Mesh) -> Parts:
    """Triangles in the mesh's own order, or in Morton order where that one jumps about."""
    triangles = mesh.triangles
    low, high = _boxes(mesh.position, triangles)
    if not _scattered(low, high):
        return Parts(triangles, low, high)
    order = _morton_order(mesh.position, triangles)
    triangles = triangles.take(order, axis=0)
    return Parts(triangles, *_boxes(mesh.position, triangles), order)


def coherent_order(mesh: Mesh) -> np.ndarray | None:
    """(T,) order of valid triangles in which those that follow one another lie together; None: the mesh's own.

    It is that of `make_parts`, but only some of the parts are looked at, and the few triangles of a small mesh lie
    together in any order.
    """
    if len(mesh.triangles) < SMALL:
        return None
    some = np.linspace(0, len(mesh.triangles) // PART, JUDGED, endpoint=False).astype(np.int64)
    rows = (PART * np.unique(some)[:, None] + np.arange(PART)).reshape(-1)
    found = _boxes(mesh.position, mesh.triangles[rows[rows < len(mesh.triangles)]])
    return _morton_order(mesh.position, mesh.triangles) if _scattered(*found) else None


def _scattered(low: np.ndarray, high: np.ndarray) -> bool:
    """Whether the boxes (B, 3) of parts are large for a mesh as large as all of them."""
    if len(low) == 0:
        return False
    whole = np.linalg.norm(high.max(axis=0) - low.min(axis=0))
    return bool(np.linalg.norm(high - low, axis=1).mean() > SCATTERED * whole)


def _boxes(position: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner, (B, 3) float64, of the boxes around each PART triangles (M, 3)."""
    count = -(-len(triangles) // PART)
    low, high = np.empty((count, 3)), np.empty((count, 3))

    def look(block: slice) -> None:
        corners = position.take(triangles[block].ravel(), axis=0)
        first, whole = block.start // PART, len(corners) // (3 * PART)
        for axis in range(3):
            # Contiguous rows are reduced many times faster than along the first axis.
            column = corners[:, axis].copy()
            rows = column[: whole * 3 * PART].reshape(whole, 3 * PART)
            low[first : first + whole, axis], high[first : first + whole, axis] = rows.min(axis=1), rows.max(axis=1)
            if rest := len(column) - rows.size:
                low[first + whole, axis], high[first + whole, axis] = column[-rest:].min(), column[-rest:].max()

    each_block(len(triangles), look, 64 * PART)
    return low, high


def _morton_order(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(M,) order of triangles by their first corners, on a grid of 1,024 to each side."""
    first = position.take(triangles[:, 0], axis=0)
    low, high = bounding_box(first)
    side = max(float((high - low).max()), 1e-30)
    key = np.zeros(len(first), np.uint32)
    for axis in range(3):
        cell = ((first[:, axis] - np.float32(low[axis])) * np.float32(1023.9 / side)).astype(np.uint32)
        for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
            cell = (cell | cell << np.uint32(shift)) & np.uint32(mask)
        key |= cell << np.uint32(axis)
    return np.argsort(key, kind="stable")


def required_spacing(
    mesh: Mesh,
    view_from_object: np.ndarray,
    camera: Camera,
    pixels: float = 1.0,
    max_samples: int | None = MAX_SAMPLES,
    parts: Parts | None = None,
) -> float:
    """The object-space distance that nowhere on the visible mesh projects to more than `pixels`; inf: not visible.

    view_from_object is (4, 4) float64, or (I, 4, 4) for instances that share the mesh's samples; they may mirror
    or flatten, and count as invisible where they have no extent or are not finite.

    Visible is what of the triangles lies in the full frame between the clip distances; occlusion is ignored.
    A length l at depth d and angle a off the axis spans at most f l / (d cos a) pixels of a perspective camera,
    f l of a parallel one, and an object-space length at most as many view-space units as the transform's
    largest singular value. On each triangle the least depth is taken together with the greatest angle.

    A camera inside or close to a mesh would ask for very many samples: `limit_spacing` then has the last word,
    unless max_samples is None (for a caller that only asks whether the samples it has are fine enough).
    The result is not quantised otherwise. `parts` is what `make_parts` returned, where many views ask: the result is
    the same, and only the triangles near the eye are looked at.
    """
    matrices = np.reshape(view_from_object, (-1, 4, 4))
    matrices = matrices[all_finite(matrices)]
    stretch = largest_singular_value(matrices[:, :3, :3])
    matrices, stretch = matrices[stretch > 1e-30], stretch[stretch > 1e-30]
    if len(matrices) == 0 or len(mesh.triangles) == 0:
        return math.inf
    if parts is None:
        look = _whole(mesh, camera)
        low, high = bounding_box(mesh.position)
    else:
        look = _by_parts(mesh, parts, camera)
        low, high = parts.low.min(axis=0), parts.high.max(axis=0)

    # Nearest boxes first: once a box promises no finer spacing than was found, neither do those behind it.
    at_least = _box_spacing(low, high, matrices, camera) / stretch
    spacing = math.inf
    for tried, i in enumerate(np.argsort(at_least, kind="stable")):
        if at_least[i] >= spacing:
            break
        if tried == EXACT_INSTANCES:
            spacing = float(at_least[i])
            break
        spacing = min(spacing, look(matrices[i]) / stretch[i])
    spacing = float(pixels * spacing)
    return spacing if math.isinf(spacing) or max_samples is None else limit_spacing(mesh, spacing, max_samples)


def part_spacings(parts: Parts, view_from_object: np.ndarray, camera: Camera, pixels: float = 1.0) -> np.ndarray:
    """(B,) at most what `required_spacing` is of each part, for one instance (4, 4) float64; inf: it is not visible."""
    stretch = float(largest_singular_value(view_from_object[None, :3, :3])[0]) if len(parts) else 0.0
    if not stretch > 1e-30 or not np.isfinite(view_from_object).all():
        return np.full(len(parts), np.inf)
    return pixels * _box_spacing(parts.low, parts.high, view_from_object, camera) / stretch


def _whole(mesh: Mesh, camera: Camera) -> Callable[[np.ndarray], float]:
    """`_view_spacing` of all triangles at once."""
    position = mesh.position.T.astype(np.float64, order="C")
    triangles = mesh.triangles.T.astype(np.intp, order="C")
    return lambda view_from_object: _view_spacing(position, triangles, view_from_object, camera)


def _by_parts(mesh: Mesh, parts: Parts, camera: Camera) -> Callable[[np.ndarray], float]:
    """The same: parts in the order of what their boxes promise, twice as many in each turn."""

    def look(view_from_object: np.ndarray) -> float:
        at_least = _box_spacing(parts.low, parts.high, view_from_object, camera)
        order = np.argsort(at_least, kind="stable")
        least, tried, turn = math.inf, 0, 8
        while tried < len(order) and at_least[order[tried]] < least:
            some = order[tried : tried + turn]
            rows = (some[:, None] * PART + np.arange(PART)).ravel()
            chosen = parts.triangles.take(rows[rows < len(parts.triangles)], axis=0).T
            position = mesh.position.take(chosen.ravel(), axis=0).T.astype(np.float64, order="C")
            triangles = np.arange(chosen.size).reshape(chosen.shape)
            least = min(least, _view_spacing(position, triangles, view_from_object, camera))
            tried, turn = tried + turn, 2 * turn
        return least

    return look


def _focal(camera: Camera) -> float:
    """Pixels for a view-space unit, at unit depth in a perspective view; of the larger direction."""
    return max(abs(f) for f in camera.pixel_from_view()[:2])


def _box_spacing(low: np.ndarray, high: np.ndarray, view_from_object: np.ndarray, camera: Camera) -> np.ndarray:
    """At most `_view_spacing` of any mesh within a box; inf where the box is certainly invisible.

    One box (3,) and matrices (I, 4, 4), or boxes (B, 3) and one matrix (4, 4): (I,) or (B,).
    """
    # Coordinates and corners come first, so that what is reduced over them lies in whole rows.
    corners = np.where(_CORNERS[..., None], high.T.reshape(3, 1, -1), low.T.reshape(3, 1, -1))  # (3, 8, B)
    linear, shift = view_from_object[..., :3, :3], view_from_object[..., :3, 3]
    if view_from_object.ndim == 2:
        view = (linear @ corners.reshape(3, -1)).reshape(3, 8, -1) + shift[:, None, None]
    else:
        seen = (linear.reshape(-1, 3) @ corners[..., 0]).reshape(-1, 3, 8)
        view = np.ascontiguousarray(seen.transpose(1, 2, 0)) + shift.T[:, None]
    planes = _frustum_planes(camera)
    distance = (planes[:, :3] @ view.reshape(3, -1)).reshape(6, 8, -1) + planes[:, 3, None, None]
    outside = (distance.max(axis=1) < 0).any(axis=0)
    if not camera.perspective:
        return np.where(outside, np.inf, 1 / _focal(camera))
    rim = _frustum_edges(camera)[0]
    with np.errstate(invalid="ignore"):
        cosine = (-rim[:, 2] / np.linalg.norm(rim, axis=1)).min()
    # A cone around the axis is convex: one that holds the corners holds the box.
    nearest = -view[2].max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        corner = (-view[2] / np.sqrt((view * view).sum(axis=0))).min(axis=0)
    cosine = np.where(nearest > 0, np.fmax(corner, cosine), cosine)
    return np.where(outside, np.inf, np.maximum(nearest, camera.near) * cosine / _focal(camera))


def _view_spacing(position: np.ndarray, triangles: np.ndarray, view_from_object: np.ndarray, camera: Camera) -> float:
    """The least view-space length that projects to one pixel on the visible part of the triangles; inf: none.

    position (3, V) float64, triangles (3, M), view_from_object (4, 4).
    """
    with np.errstate(invalid="ignore"):  # positions that no sound triangle has
        view = view_from_object[:3, :3] @ position + view_from_object[:3, 3:]
        planes = _frustum_planes(camera)
        outside = planes[:, :3] @ view + planes[:, 3:] < 0
    # One bit for each plane (Cohen and Sutherland): a triangle is whole, cut, or on the far side of some plane.
    a, b, c = np.packbits(outside, axis=0)[0].take(triangles)
    whole = (a | b | c) == 0
    cut = np.flatnonzero(~whole & ((a & b & c) == 0))
    least = math.inf
    if whole.any():
        if not camera.perspective:
            return 1 / _focal(camera)
        depth = -view[2]
        distance = np.sqrt(dot(view, view))
        cosine = np.divide(depth, distance, out=np.ones_like(depth), where=distance > 0)
        inside = triangles if whole.all() else triangles[:, whole]
        least = float((depth.take(inside).min(axis=0) * cosine.take(inside).min(axis=0)).min())
    edges = _frustum_edges(camera)
    for block in blocks(len(cut)):
        corners = view[:, triangles[:, cut[block]]].swapaxes(0, 1)  # (3 corners, 3, n)
        points = _cut_points(corners, planes[:, :3] @ corners + planes[:, 3:], edges)
        least = min(least, _nearest(points, camera.perspective))
    return least / _focal(camera)


def _nearest(points: np.ndarray, perspective: bool) -> float:
    """Of point sets (K, 3, n) in view space, the least product of least depth and least cosine off the axis.

    NaN points are absent, and a set without points counts as infinitely far. In a parallel view both are 1.
    """
    absent = np.isnan(points[:, 0])
    if not perspective:
        return math.inf if absent.all() else 1.0
    depth = -points[:, 2]
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.sqrt(dot(points.swapaxes(0, 1), points.swapaxes(0, 1)))
    absent |= ~(distance > 0)  # by rounding, of what is far too large
    cosine = np.divide(depth, distance, out=np.ones_like(depth), where=~absent)
    return float((np.where(absent, np.inf, depth).min(axis=0) * np.where(absent, 1.0, cosine).min(axis=0)).min())


def _frustum_planes(camera: Camera) -> np.ndarray:
    """(6, 4): view space points p with planes @ (p, 1) >= 0 are visible."""
    x, y, _, w = camera.clip_from_view
    depth = np.array([0.0, 0.0, -1.0, 0.0])
    one = np.array([0.0, 0.0, 0.0, 1.0])
    return np.stack([w + x, w - x, w + y, w - y, depth - camera.near * one, camera.far * one - depth])


def _frustum_edges(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Start and stop, (8, 3) each, of the frustum's four edges in depth and the four around its near side."""
    m = camera.clip_from_view
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = np.empty((2, 4, 3))
    for side, depth in zip(corners, (camera.near, camera.far), strict=True):
        # clip = scale * xy + m[2] z + m[3], over depth in a perspective view.
        xy = (signs + m[:2, 2]) * depth if camera.perspective else signs - m[:2, 3] + m[:2, 2] * depth
        side[:] = np.column_stack([xy / m[[0, 1], [0, 1]], np.full(4, -depth)])
    near, far = corners
    return np.concatenate([near, near]), np.concatenate([far, np.roll(near, -1, axis=0)])


def _cut_points(view: np.ndarray, distance: np.ndarray, edges: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Corners of triangles cut by the frustum, (K, 3, n), NaN where absent; those on the far side are left out.

    They are where the triangles' edges enter and leave the frustum, and where the frustum's edges pierce the
    triangles. view (3 corners, 3, n); distance (3 corners, 6, n) of them from the frustum's planes.
    """
    distance = distance.swapaxes(0, 1)
    enter, leave = clip(distance, np.roll(distance, -1, axis=1))
    step = np.roll(view, -1, axis=0) - view
    on_edges = [np.where((enter <= leave)[:, None], view + t[:, None] * step, np.nan) for t in (enter, leave)]

    a, u, v = view[0], view[1] - view[0], view[2] - view[0]
    normal = cross(u, v)
    area = dot(normal, normal)
    pierced = []
    for start, stop in zip(*edges, strict=True):
        along = (stop - start)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = dot(a - start[:, None], normal) / dot(along, normal)
            point = start[:, None] + t * along
            first = dot(cross(point - a, v), normal) / area
            second = dot(cross(u, point - a), normal) / area
            hit = (t >= 0) & (t <= 1) & (first >= 0) & (second >= 0) & (first + second <= 1)
        pierced.append(np.where(hit, point, np.nan))
    return np.concatenate([*on_edges, np.stack(pierced)])
