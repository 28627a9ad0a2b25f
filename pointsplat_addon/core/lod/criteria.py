"""The tests of level-of-detail selection: is a node in view, does it face away, is it small enough on the screen.

Pajarola 2003, section 6; Křivánek 2003, sections 3.4 and 3.5 (nodes out of focus).
"""

from __future__ import annotations

import math

import numpy as np

from ..numeric.linear import largest_singular_value
from ..numeric.record import value_record
from ..scene.camera import Camera
from ..splat.blur import Blur
from .node_table import NodeTable

NEIGHBOUR_EXTENT = 3.0  # radii from a splat's centre to the far rims of its neighbours
TRANSITION_BAND = 0.25  # octaves, see `transition_band`: costs a fifth more nodes on surfaces
SINGULAR = 1e-12  # determinant over scale^3 below which a transform has no inverse worth using


@value_record
class Criteria:
    """What a view asks of the nodes that are drawn in it."""

    planes: np.ndarray  # (6, 4) float64, view space: a ball is outside where plane . (p, 1) < -radius
    perspective: bool
    near: float  # world units
    limit: float  # tolerance over twice the focal length: projected half size over distance
    tolerance: float  # pixels
    band: float = 0.0  # octaves below `limit` over which nodes give way to their children, see `transition_band`
    blur: Blur | None = None  # None: everything is in focus
    wanted: str = "ALL"  # with a blur: ALL, BLURRED (what may be out of focus) or SHARP (what may be in focus)

    def circle_of_confusion(self, depth: np.ndarray) -> np.ndarray:
        """Radii in world units of the circles of confusion at these depths."""
        assert self.blur is not None
        per_pixel = 2 * self.limit / self.tolerance
        return self.blur.radius(depth) * per_pixel * (np.abs(depth) if self.perspective else 1.0)

    def depth_range(self, position: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest and the farthest depth of balls about `position` (3, n), not before the near plane."""
        depth = -position[2]
        if not self.perspective:
            return depth - radius, depth + radius
        return np.maximum(depth - radius, self.near), np.maximum(depth + radius, self.near)


@value_record
class InstanceViews:
    """How each of I instances is seen, in columns."""

    matrix: np.ndarray  # (3, 4, I) float64, view from points relative to the cloud's origin
    scale: np.ndarray  # (I,) float64: largest singular value
    culls: np.ndarray  # (I,) bool: whether what faces away may be left out
    eye: np.ndarray  # (3, I) float64, relative to the cloud's origin; only where `culls`
    forward: np.ndarray  # (3, I) float64, unit, in object space; only where `culls`

    def take(self, instance: np.ndarray) -> InstanceViews:
        """The views of nodes by their instance (n,); columns keep length one where there is but one instance."""
        if len(self.scale) == 1:
            return self
        culls = self.culls.take(instance)
        use = instance if culls.any() else instance[:0]
        return InstanceViews(
            self.matrix.take(instance, axis=2), self.scale.take(instance), culls,
            self.eye.take(use, axis=1), self.forward.take(use, axis=1),
        )  # fmt: skip


@value_record
class BlurExtent:
    """Circles of confusion of n balls."""

    beyond: np.ndarray | float  # world units: by how much blur extends the balls
    least: np.ndarray  # (n,) pixels: radius of the smallest circle in each ball; empty without a blur
    most: np.ndarray  # (n,) pixels: of the largest


def criteria_of(camera: Camera, tolerance: float, margin: float) -> Criteria:
    """The criteria of a camera. `tolerance` and `margin`, by which its window is widened, are in pixels.

    The planes follow from the rows of clip_from_view (Gribb and Hartmann 2001).
    """
    x, y, z, w = camera.clip_from_view
    (width, height), (x0, y0, across, up) = camera.resolution, camera.window
    planes = np.stack([
        x - (2 * (x0 - margin) / width - 1) * w,
        (2 * (x0 + across + margin) / width - 1) * w - x,
        y - (2 * (y0 - margin) / height - 1) * w,
        (2 * (y0 + up + margin) / height - 1) * w - y,
        z + w,
        w - z,
    ])  # fmt: skip
    length = np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    # A far plane at infinity has no direction and excludes nothing.
    planes = np.where(length > 1e-12, planes / np.maximum(length, 1e-300), [0.0, 0.0, 0.0, np.inf])
    fx, fy, _, _ = camera.pixel_from_view()
    return Criteria(
        planes, camera.perspective, max(camera.near, 0.0), tolerance / (2 * max(abs(fx), abs(fy))), tolerance
    )


def transition_band(tolerance: float) -> float:
    """Octaves of projected size over which the nodes of one level give way to their children, for a tolerance in
    pixels.

    On a surface that faces the camera all nodes would otherwise be refined in one frame, which shows where they are
    wider than a pixel. At a tolerance of a pixel or less nothing shows, and no node is refined early.
    """
    return TRANSITION_BAND * min(math.log2(max(tolerance, 1.0)), 1.0)


def instance_views(
    view_from_object: np.ndarray, origin: np.ndarray, cull: np.ndarray | None, use: np.ndarray
) -> InstanceViews:
    """The views of instances with matrices (I, 4, 4) and clouds' origins (I, 3).

    `cull` (I,) bool: where back faces may be left out (None: nowhere). Matrices that `use` (I,) excludes are ignored.
    """
    matrix = np.where(use[:, None, None], view_from_object[:, :3], 0.0)
    linear = matrix[:, :, :3]
    matrix[:, :, 3] += np.einsum("kij,kj->ki", linear, origin) if len(origin) else 0.0
    scale = largest_singular_value(linear)
    flat = np.abs(np.linalg.det(linear)) <= SINGULAR * scale**3
    culls = np.zeros(len(scale), bool) if cull is None else np.asarray(cull, bool) & ~flat
    eye, forward = np.zeros((3, len(scale))), np.zeros((3, len(scale)))
    if culls.any():
        inverse = np.linalg.inv(linear[culls])
        eye[:, culls] = -np.einsum("kij,kj->ik", inverse, matrix[culls, :, 3])
        backward = inverse[:, :, 2].T
        forward[:, culls] = -backward / np.linalg.norm(backward, axis=0)
    return InstanceViews(np.ascontiguousarray(matrix.transpose(1, 2, 0)), scale, culls, eye, forward)


def against_frustum(
    criteria: Criteria, position: np.ndarray, radius: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which balls about `position` (3, n) in view space lie outside one of the planes, and which inside all: (n,) bool.

    Those that are known to lie `inside` (n,) are not tested.
    """
    gone, inside = np.zeros(len(inside), bool), inside.copy()
    check = np.flatnonzero(~inside)
    if len(check):
        p, r = position.take(check, axis=1), radius.take(check)
        nearest = np.full(len(check), np.inf)
        for a, b, c, d in criteria.planes:
            np.minimum(nearest, a * p[0] + b * p[1] + c * p[2] + d, out=nearest)
        gone[check], inside[check] = nearest < -r, nearest >= r
    return gone, inside


def blur_extent(criteria: Criteria, position: np.ndarray, radius: np.ndarray) -> BlurExtent:
    """The circles of confusion of balls about `position` (3, n) in view space, `radius` (n,)."""
    if criteria.blur is None:
        return BlurExtent(0.0, np.empty(0), np.empty(0))
    # Surfaces are rebuilt from splats together with their neighbours: what is in focus needs neighbours that are not.
    sharp = criteria.wanted == "SHARP"
    near, far = criteria.depth_range(position, radius * (NEIGHBOUR_EXTENT if sharp else 1.0))
    least, most = criteria.blur.radius_range(near, far)
    if sharp:
        return BlurExtent(0.0, least, most)
    return BlurExtent(np.maximum(criteria.circle_of_confusion(near), criteria.circle_of_confusion(far)), least, most)


def against_cone(
    table: NodeTable, view: InstanceViews, criteria: Criteria, node: np.ndarray, center: np.ndarray, sphere: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes face away as a whole, and which face the eye as a whole (all, where nothing is culled): (n,) bool.

    Works in object space, since affine maps keep the sign of n . (eye - p). With phi the angle of the cone's axis to
    the ray, theta the cone's and beta the ball's half-angle, a node faces away if phi + theta + beta <= 90 degrees.
    """
    cosine, sine = table.cone.take(node, axis=1).astype(np.float64)
    normal = table.normal.take(node, axis=1)
    if criteria.perspective:
        ray = center - view.eye
        tangent = np.sqrt(np.maximum((ray**2).sum(axis=0) - sphere.astype(np.float64) ** 2, 0))
        along = (normal * ray).sum(axis=0)
        least = sine * tangent + cosine * sphere
        narrow = (tangent > 0) & (cosine * np.hypot(tangent, sphere) >= sphere)
    else:
        along, least, narrow = (normal * view.forward).sum(axis=0), sine, cosine >= 0
    return view.culls & narrow & (along >= least), ~view.culls | (narrow & (along <= -least))


def within_tolerance(
    table: NodeTable,
    criteria: Criteria,
    node: np.ndarray,
    position: np.ndarray,
    size: np.ndarray,
    radius: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes project to at most the tolerance, and which have only descendants that exceed it: (n,) bool.

    `position` (3, n) in view space, `size` and `radius` of the bounding ball (n,) in world units, `scale` (n,) of the
    instances. The image of a ball of radius r at depth z and distance D is longest along the direction from the image's
    centre: f (tan(theta + beta) - tan(theta - beta)) = 2 f r sqrt(D^2 - r^2) / (z^2 - r^2). Nodes that extend before
    the near plane have no size there and are refined.
    """
    smallest = table.smallest.take(node) * scale
    limit = criteria.limit
    if criteria.blur is not None and criteria.wanted != "SHARP":
        # Where the blur allows it, nodes of any size may be drawn.
        smallest = np.zeros(len(node))
        least, _ = criteria.blur.radius_range(*criteria.depth_range(position, size))
        limit = limit * (criteria.blur.largest_splat(least, criteria.tolerance) / criteria.tolerance)
    limit = limit * 2.0 ** (-criteria.band * table.jitter.take(node)) if criteria.band > 0 else limit
    if not criteria.perspective:
        return size <= limit, smallest > criteria.limit
    z = -position[2]
    squares = z * z - size * size
    distance = position[0] ** 2 + position[1] ** 2 + squares
    small = (z - size > criteria.near) & (size * np.sqrt(np.maximum(distance, 0)) <= limit * squares)
    # No descendant is deeper than the ball's far side, and none projects smaller than r / z.
    return small, smallest > criteria.limit * np.maximum(z + radius, 0)
