"""Depth maps seen from lights: from where each is seen, and how fine it is.

A sun sees what casts by one parallel view. So does a light that all casters lie within a cone about, or a spot, by one
perspective view; other lights by up to six, the faces of a cube. Each view is cut to what it sees, so that no texels
are spent on nothing. Lights with a size see what casts from several of their points (light_points.py): all by views
that differ only in where they are, side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...core.numeric.record import record
from ...core.scene.camera import Camera
from ...core.scene.lights import Light
from ...core.shadow.grid import rotation_to
from .light_points import LightShape, cell_points, grid_shifts, light_shape

WIDEST_CONE = 1.05  # radians from a single view's axis to the farthest that it sees
FINER = 2.0  # times as many texels as cells of a table lie across a view of everything
FINEST = 8.0  # the same, where small splats ask for it
TEXELS_OF_RADIUS = 2.0  # in the radius of a typical splat: with one, balls shade their neighbours by 5 % too much
MOST_TEXELS = 1 << 25  # of all maps together: 128 MiB
MOST_TEXELS_OF_SPLATS = 1 << 26  # the same, where many splats cast
TEXELS_OF_SPLAT = 6  # for each of these
FEWEST = 16  # texels along a view's longer side
MARGIN = 2  # texels around what a view sees, which nothing covers
NEAREST = 1e-5  # nearest depth that a perspective view sees, over the farthest
THINNEST = 1e-6  # least extent of a view, over that of what it may see
MOST_TEXELS_OF_LIGHT = 1 << 23  # with a size
BEYOND = 0.2  # of the bounds of a view from a light with a size, beyond those: where its other points see the same


@record
class Nested:
    """For which receivers a nested map stands in for that of the scene (nested.py)."""

    low: np.ndarray  # (2,) float64, places in the light's space between which they lie, and
    high: np.ndarray
    depths: tuple[float, float]  # their range of depths
    lift: float  # the height at which its views from all points of the light show the same place


@record
class MapView:
    """One view from a light. Its coordinates are right, up and the depth in front of the light, with `right` cross `up`
    = -`forward`; a place in it is (right, up), over the depth where the view is a perspective one."""

    axes: np.ndarray  # (3, 3) float64: right, up, forward in the world
    origin: np.ndarray  # (3,) float64, world: where depths count from
    parallel: bool
    low: np.ndarray  # (2,) float64: the place of the lower left corner
    step: float  # places from a texel to the next
    size: tuple[int, int]  # texels
    far: float
    corner: tuple[int, int] = (0, 0)  # of its texels in the texture of all maps
    across: np.ndarray | None = None  # (2, 2) float64: half-axes of a light with a size as columns, in its plane
    # (N, 3) float64, of the light, in these coordinates: each has such a view of its own; None: there is one.
    points: np.ndarray | None = None
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from which this one is seen
    finest: float = 0.0  # finer texels show gaps between splats
    nested: Nested | None = None

    @property
    def tiles(self) -> tuple[int, int]:
        """How many views lie side by side, and one above the other."""
        return (1, 1) if self.points is None else tile_grid(len(self.points))

    @property
    def block(self) -> tuple[int, int]:
        """Texels of the views from all points together."""
        return self.size[0] * self.tiles[0], self.size[1] * self.tiles[1]

    @property
    def each(self) -> list[MapView]:
        """The views from all points, each in its place."""
        if self.points is None:
            return [self]
        (x, y), columns = self.corner, self.tiles[0]
        return [
            replace(
                self,
                corner=(x + i % columns * self.size[0], y + i // columns * self.size[1]),
                low=self.low - self.step * moved - (0.0 if self.nested is None else self.nested.lift * point[:2]),
                points=None,
                point=(float(point[0]), float(point[1]), float(point[2])),
            )
            for i, (point, moved) in enumerate(zip(self.points, grid_shifts(len(self.points)), strict=True))
        ]

    @property
    def near(self) -> float:
        return 0.0 if self.parallel else NEAREST * self.far

    @property
    def camera(self) -> Camera:
        """The camera whose picture the view is."""
        view, clip = np.eye(4), np.zeros((4, 4))
        view[:3, :3] = self.axes * [[1], [1], [-1]]
        view[:3, 3] = -view[:3, :3] @ self.origin
        if self.parallel:
            view[:2] -= np.array(self.point)[:2, None] * view[2]  # rays from the point are upright
        else:
            view[:3, 3] -= self.point * np.array([1, 1, -1])
        extent = self.step * np.array(self.size)
        middle = (2 * self.low + extent) / extent
        clip[0, 0], clip[1, 1] = 2 / extent
        near, far = self.near, self.far
        if self.parallel:
            clip[:2, 3], clip[2, 2], clip[2, 3], clip[3, 3] = -middle, -2 / far, -1, 1
        else:
            clip[:2, 2] = middle
            clip[2, 2], clip[2, 3], clip[3, 2] = -(far + near) / (far - near), -2 * far * near / (far - near), -1
        return Camera(view, clip, self.size, near=near, far=far)


@record
class LightViews:
    """All views from one light."""

    kind: str  # PARALLEL, SINGLE or CUBE
    axes: np.ndarray  # (3, 3) float64 and
    origin: np.ndarray  # (3,) of the coordinates in which a cube's faces lie across the axes, or of the only view
    # Faces of a cube: toward +x, -x, +y, -y, +z, -z; None: nothing is there. The only view, and nested ones.
    views: tuple[MapView | None, ...]
    shape: LightShape | None = None  # of a light with a size


@record
class CastingBoxes:
    """What casts into maps: corners of boxes around instances, and how small their splats are."""

    corners: np.ndarray  # (I, 8, 3) float64, world
    radius: np.ndarray  # (I,) float64, world: of a typical splat; infinite: there are none


def tile_grid(count: int) -> tuple[int, int]:
    """Returns the columns and rows in which so many views of a light lie."""
    columns = 8 if count > 16 else 4
    return columns, count // columns


def angular_reach(light: Light, boxes: CastingBoxes) -> float | None:
    """Returns how far a light extends to each side, in radians, as the nearest of what casts may see it; None: it has
    no size."""
    shape = light_shape(light)
    if shape is None or light.kind == "SUN":
        return None if shape is None else float(np.arctan(shape.reach))
    low, high = boxes.corners.min(axis=1), boxes.corners.max(axis=1)
    apart = np.linalg.norm(np.maximum(np.maximum(low - light.position, light.position - high), 0), axis=1)
    return float(np.arctan2(shape.reach, apart.min()))


def light_views(light: Light, boxes: CastingBoxes, resolution: int, points: int = 0) -> LightViews:
    """Returns the views from a light. `resolution`: cells along a shadow table. `points`: from how many of its
    points, if it has a size."""
    shape = light_shape(light) if points else None
    if light.kind == "SUN":
        found = _parallel(light, boxes, resolution, shape)
    elif light.kind == "AREA":
        found = _from_area(light, boxes, resolution, shape)
    else:
        found = _from_point(light, boxes, resolution, shape)
    return found if shape is None else _of_points(replace(found, shape=shape), points)


def _from_point(light: Light, boxes: CastingBoxes, resolution: int, shape: LightShape | None) -> LightViews:
    offset = boxes.corners - light.position
    away = np.maximum(np.linalg.norm(offset, axis=2), 1e-30)
    far = float(away.max()) * (1 + 1e-4)
    axis, widest = _cone_of_corners(offset / away[..., None])
    lit = _spot_angle(light) if light.kind == "SPOT" else np.pi
    if lit <= WIDEST_CONE and (lit <= widest or widest > WIDEST_CONE):
        axis, widest = light.direction, lit
    if widest > WIDEST_CONE:
        return _cube(light, np.eye(3), boxes, offset, far, resolution, shape)
    bound = np.full(2, np.tan(lit)) if light.kind == "SPOT" and lit <= WIDEST_CONE else np.full(2, np.inf)
    return _single(light, axis, bound, boxes, offset, far, resolution, shape)


def _from_area(light: Light, boxes: CastingBoxes, resolution: int, shape: LightShape | None) -> LightViews:
    """Views of what lies in front of an area light, along its axis where that is enough."""
    offset = boxes.corners - light.position
    lit = (offset @ light.direction > 0).any(axis=1)
    boxes, offset = CastingBoxes(boxes.corners[lit], boxes.radius[lit]), offset[lit]
    away = np.maximum(np.linalg.norm(offset, axis=2), 1e-30)
    far = float(away.max(initial=0.0)) * (1 + 1e-4)
    forward, right, up = rotation_to(light.direction)
    cosine = float((offset @ light.direction / away).min(initial=1.0))
    if cosine >= np.cos(WIDEST_CONE):
        return _single(light, light.direction, np.full(2, np.inf), boxes, offset, far, resolution, shape)
    return _cube(light, np.stack([up, right, forward]), boxes, offset, far, resolution, shape)


def _single(
    light: Light,
    axis: np.ndarray,
    bound: np.ndarray,
    boxes: CastingBoxes,
    offset: np.ndarray,
    far: float,
    resolution: int,
    shape: LightShape | None,
) -> LightViews:
    """One view along an axis. `offset`: (I, 8, 3) of the corners from the light."""
    forward, right, up = rotation_to(axis)
    axes = np.stack([up, right, forward])
    texels = FINER * resolution, FINEST * resolution
    view = _perspective(axes, light.position, offset @ axes.T, boxes, bound, far, texels, shape)
    return LightViews("SINGLE", axes, light.position, (view,))


def _of_points(light: LightViews, points: int) -> LightViews:
    """Returns the views from so many points of a light with a size, with fewer texels where all have more than a
    budget."""
    shape = light.shape
    assert shape is not None
    middles, _ = cell_points(points, shape.rectangle)

    def seen(view: MapView) -> MapView:
        if view.across is None:
            return view
        if view.parallel or shape.facing:
            return replace(view, points=np.pad(middles @ view.across.T, ((0, 0), (0, 1))))
        return replace(view, points=middles @ shape.axes @ view.axes.T)

    found = _each_view(light, seen)
    assert found is not None
    total = sum(view.block[0] * view.block[1] for view in found.views if view is not None)
    share = (MOST_TEXELS_OF_LIGHT / max(total, 1)) ** 0.5
    return found if share >= 1 else replace(found, views=tuple(v and _coarser(v, share) for v in found.views))


def placed(
    lights: Sequence[LightViews | None], width: int, splats: int = 0, most: int = MOST_TEXELS
) -> tuple[list[LightViews | None], tuple[int, int]]:
    """Returns the views with places in one texture, and its (width, height): with fewer texels each, where all together
    have more than a budget. `width`: texels along a side that a texture may have. `splats`: how many cast. `most`:
    texels of the budget, where these are few."""
    fitting = [_each_view(one, lambda view: _limited(view, width)) for one in lights]
    total = sum(v.block[0] * v.block[1] for one in fitting if one is not None for v in one.views if v is not None)
    budget = min(max(TEXELS_OF_SPLAT * splats, most), MOST_TEXELS_OF_SPLATS)
    if total > budget:
        share = 0.95 * (budget / total) ** 0.5  # margins and rounding take the rest
        fitting = [_each_view(one, lambda view: _coarser(view, share)) for one in fitting]
    corners, size = arranged_blocks(
        [v.block for one in fitting if one is not None for v in one.views if v is not None], width
    )
    places = iter(corners)
    return [_each_view(one, lambda view: replace(view, corner=next(places))) for one in fitting], size


def _parallel(light: Light, boxes: CastingBoxes, resolution: int, shape: LightShape | None) -> LightViews:
    forward, right, up = rotation_to(light.direction)
    axes = np.stack([up, right, forward])
    middle = boxes.corners.reshape(-1, 3).mean(axis=0)
    local = (boxes.corners - middle) @ axes.T
    low, high = local.min(axis=(0, 1)), local.max(axis=(0, 1))
    size = float(max((high - low).max(), np.abs(middle).max() * 1e-7, 1e-30))
    before = low[2] - 1e-3 * size  # nothing lies at depth 0
    origin = middle + before * axes[2]
    across = None if shape is None else shape.across(axes, True, np.zeros(2))
    aside = 0.0 if shape is None or across is None else shape.bounds(across) * float(high[2] - before)
    finest = float(boxes.radius.min(initial=np.inf))
    view = _fitted(
        axes, origin, True, low[:2] - aside, high[:2] + aside, float(high[2] - before) * (1 + 1e-4) + THINNEST * size,
        finest, FINER * resolution, FINEST * resolution, size, across,
    )  # fmt: skip
    return LightViews("PARALLEL", axes, origin, (view,))


def _cube(
    light: Light,
    turned: np.ndarray,
    boxes: CastingBoxes,
    offset: np.ndarray,
    far: float,
    resolution: int,
    shape: LightShape | None,
) -> LightViews:
    """Views through the faces of a cube along the rows of `turned` (3, 3). `offset`: (I, 8, 3) of the corners from the
    light."""
    views = []
    bound = np.full(2, 1.0 if shape is None else 1 + BEYOND)
    for face in range(6):
        axis, side = divmod(face, 2)
        if shape is not None and not shape.facing and face == 5:
            views.append(None)  # a flat light does not shine backwards
            continue
        second, third = turned[(axis + 1) % 3], turned[(axis + 2) % 3]
        axes = np.stack([second, third, -turned[axis]] if side else [third, second, turned[axis]])
        texels = resolution, 2 * resolution
        views.append(_perspective(axes, light.position, offset @ axes.T, boxes, bound, far, texels, shape))
    return LightViews("CUBE", turned, light.position, tuple(views))


def _perspective(
    axes: np.ndarray,
    origin: np.ndarray,
    local: np.ndarray,
    boxes: CastingBoxes,
    bound: np.ndarray,
    far: float,
    resolution: tuple[float, float],
    shape: LightShape | None,
) -> MapView | None:
    """Returns the view of what lies within the slopes `bound` (2,) on either side of the axis; None if nothing does.

    local: (I, 8, 3), corners in the view's coordinates. `resolution`: texels along its longer side, and where small
    splats ask for more. `shape`: of the light: all of its points see what the view holds.
    """
    low, high, seen = _window(local, far, bound, np.zeros(2))
    across = None
    if shape is not None and seen.any():
        across = shape.across(axes, False, (low + high) / 2)
        low, high, seen = _window(local, far, bound, shape.bounds(across))
    if not seen.any():
        return None
    away = np.linalg.norm(local[seen], axis=2).mean(axis=1)
    finest = float((boxes.radius[seen] / np.maximum(away, 1e-30)).min(initial=np.inf))
    return _fitted(axes, origin, False, low, high, far, finest, resolution[0], resolution[1], 1.0, across)


def _window(
    local: np.ndarray, far: float, bound: np.ndarray, aside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the low and the high corner, (2,), of what boxes cover in a perspective view within a bound, and which
    boxes are seen, (I,) bool. `aside`: (2,) how far the points lie from which it is seen."""
    depth = local[..., 2]
    ahead = np.any(depth > 0, axis=1)
    beyond = np.any(depth <= NEAREST * far, axis=1) & ahead
    with np.errstate(all="ignore"):
        apart = np.maximum(local[..., 2], 1e-30)[..., None]
        low, high = ((local[..., :2] - aside) / apart).min(axis=1), ((local[..., :2] + aside) / apart).max(axis=1)
    low[beyond], high[beyond] = -np.inf, np.inf
    seen = ahead & (low < bound).all(axis=1) & (high > -bound).all(axis=1)
    if not seen.any():
        return -bound, bound, seen
    return np.maximum(low[seen].min(axis=0), -bound), np.minimum(high[seen].max(axis=0), bound), seen


def _fitted(
    axes: np.ndarray,
    origin: np.ndarray,
    parallel: bool,
    low: np.ndarray,
    high: np.ndarray,
    far: float,
    finest: float,
    texels: float,
    most: float,
    scale: float,
    across: np.ndarray | None,
) -> MapView:
    """Returns a view of the places between two corners (2,), with a margin.

    `finest`: the smallest radius of a typical splat, in places. `texels`, `most`: along the longer side, and where
    small splats ask for more. `scale`: of places. `across`: see MapView.
    """
    extent = np.maximum(high - low, THINNEST * scale)
    longest = float(extent.max())
    count = float(np.clip(TEXELS_OF_RADIUS * longest / max(finest, 1e-30), texels, most))
    step = longest / count
    size = np.maximum(np.ceil(extent / step), 1).astype(int) + 2 * MARGIN
    middle = (low + high) / 2
    return MapView(
        axes, origin, parallel, middle - step * size / 2, step, (int(size[0]), int(size[1])), far, across=across,
        finest=finest / TEXELS_OF_RADIUS if np.isfinite(finest) else 0.0,
    )  # fmt: skip


def _coarser(view: MapView, share: float) -> MapView:
    """Returns a view with `share` of the texels along each side."""
    inner = np.array(view.size) - 2 * MARGIN
    share = max(share, FEWEST / max(float(inner.max()), FEWEST))
    step = view.step / share
    size = np.maximum(np.ceil(inner * share), 1).astype(int) + 2 * MARGIN
    middle = view.low + view.step * np.array(view.size) / 2
    return replace(view, low=middle - step * size / 2, step=step, size=(int(size[0]), int(size[1])))


def _limited(view: MapView, width: int) -> MapView:
    """Returns a view that a texture of `width` texels holds."""
    tiles = max(view.tiles)
    return _coarser(view, (width / tiles - 2 * MARGIN - 1) / max(view.size)) if max(view.block) > width else view


def _each_view(light: LightViews | None, change: Callable[[MapView], MapView]) -> LightViews | None:
    """Returns a light's views, each of them changed."""
    if light is None:
        return None
    return replace(light, views=tuple(None if view is None else change(view) for view in light.views))


def arranged_blocks(sizes: list[tuple[int, int]], width: int) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Places rectangles on shelves, the highest first. Returns the lower left corner of each, and what holds all."""
    total = sum(w * h for w, h in sizes)
    width = min(width, max([1 << int(np.ceil(np.log2(max(total, 1) ** 0.5))), *(w for w, _ in sizes)]))
    corners, x, y, top, used = [(0, 0)] * len(sizes), 0, 0, 0, 1
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i][1]):
        w, h = sizes[i]
        if x + w > width:
            x, y = 0, top
        corners[i] = x, y
        x, top, used = x + w, max(top, y + h), max(used, x + w)
    return corners, (used, max(top, 1))


def _cone_of_corners(toward: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns the axis of a cone that holds unit vectors (I, 8, 3), and its angle."""
    axis = toward.reshape(-1, 3).mean(axis=0)
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        return np.array([0.0, 0.0, -1.0]), float(np.pi)
    axis = axis / length
    return axis, float(np.arccos(np.clip((toward @ axis).min(), -1, 1)))


def _spot_angle(light: Light) -> float:
    """Returns the angle of the narrowest round cone that holds that of a spot, in radians."""
    angle = float(np.arccos(np.clip(light.spot_cos, -1, 1)))
    if light.axis_u is None or light.axis_v is None or angle >= np.pi / 2:
        return angle
    least = float(np.linalg.svd(np.stack([light.axis_u, light.axis_v]), compute_uv=False).min())
    return float(np.arctan(np.tan(angle) / max(least, 1e-9)))
