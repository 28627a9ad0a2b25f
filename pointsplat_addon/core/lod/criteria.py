"""TODO: say what this module is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..numeric.linear import largest_singular_value
from ..scene.camera import Camera
from ..splat.blur import Blur
from .node_table import NodeTable

NEIGHBOUR_EXTENT = 3.0  # radii from a splat's middle to the farthest ends of those beside it
TRANSITION_BAND = 0.25  # octaves, see `staggered`: a fifth more nodes in the mean, on surfaces
SINGULAR = 1e-12  # determinant over scale^3 below which a transform has no inverse worth using


@dataclass(frozen=True)
class Criteria:
    """The camera as the tests need it."""

    planes: np.ndarray  # (6, 4) float64, view space: a sphere is outside where plane . (p, 1) < -radius
    perspective: bool
    near: float
    limit: float  # tolerance over twice the focal length: projected half size over distance
    tolerance: float
    band: float = 0.0  # octaves by which nodes' limits lie below that, each by its own share of them
    blur: Blur | None = None
    wanted: str = "ALL"  # where there is a blur: ALL, BLURRED or SHARP

    def disk(self, depth: np.ndarray) -> np.ndarray:
        """World units: radius of the disks of confusion at these depths."""
        assert self.blur is not None
        per_pixel = 2 * self.limit / self.tolerance
        return self.blur.radius(depth) * per_pixel * (np.abs(depth) if self.perspective else 1.0)


@dataclass(frozen=True)
class InstanceViews:
    """Per instance, in columns."""

    matrix: np.ndarray  # (3, 4, I) float64, view from points relative to the cloud's origin
    scale: np.ndarray  # (I,) float64: largest singular value
    culls: np.ndarray  # (I,) bool
    eye: np.ndarray  # (3, I) float64, relative to the cloud's origin; only where `culls`
    forward: np.ndarray  # (3, I) float64, unit, in object space; only where `culls`


def criteria_of(camera: Camera, tolerance: float, margin: float) -> Criteria:
    """Frustum planes (Gribb and Hartmann 2001) of the window, from the rows of clip_from_view."""
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
    """Octaves of projected size over which the nodes of one level give way to their children. Of a surface that faces
    the camera all of them would otherwise do so in one frame, and be seen to where they are wider than a pixel; what is
    not changes unseen, and gets no more nodes than it needs."""
    return TRANSITION_BAND * min(math.log2(max(tolerance, 1.0)), 1.0)


def instance_views(
    view_from_object: np.ndarray, origin: np.ndarray, cull: np.ndarray | None, use: np.ndarray
) -> InstanceViews:
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


def _pick(views: InstanceViews, instance: np.ndarray) -> InstanceViews:
    """The views of a frontier's nodes; columns of length one where there is but one instance."""
    if len(views.scale) == 1:
        return views
    culls = views.culls.take(instance)
    use = instance if culls.any() else instance[:0]
    return InstanceViews(
        views.matrix.take(instance, axis=2), views.scale.take(instance), culls,
        views.eye.take(use, axis=1), views.forward.take(use, axis=1),
    )  # fmt: skip


def against_frustum(
    lens: Criteria, position: np.ndarray, reach: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which balls lie outside one of the planes, and which lie inside all of them."""
    gone, inside = np.zeros(len(inside), bool), inside.copy()
    check = np.flatnonzero(~inside)
    if len(check):
        p, r = position.take(check, axis=1), reach.take(check)
        nearest = np.full(len(check), np.inf)
        for a, b, c, d in lens.planes:
            np.minimum(nearest, a * p[0] + b * p[1] + c * p[2] + d, out=nearest)
        gone[check], inside[check] = nearest < -r, nearest >= r
    return gone, inside


def blur_extent(
    lens: Criteria, position: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray | float, np.ndarray, np.ndarray]:
    """How far balls reach beyond themselves where they are blurred, in world units, and the least and the greatest
    radius in pixels of their disks of confusion."""
    if lens.blur is None:
        return 0.0, np.empty(0), np.empty(0)
    # Surfaces are rebuilt from splats together with their neighbours: what is in focus needs those that are not.
    near, far = _depth_range(lens, position, reach * (NEIGHBOUR_EXTENT if lens.wanted == "SHARP" else 1.0))
    least, most = lens.blur.bounds(near, far)
    return np.maximum(lens.disk(near), lens.disk(far)) if lens.wanted != "SHARP" else 0.0, least, most


def _depth_range(lens: Criteria, position: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of balls, as far as they may be seen."""
    depth = -position[2]
    if not lens.perspective:
        return depth - reach, depth + reach
    return np.maximum(depth - reach, lens.near), np.maximum(depth + reach, lens.near)


def against_cone(
    forest: NodeTable, view: InstanceViews, lens: Criteria, node: np.ndarray, center: np.ndarray, sphere: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes face away as a whole, and which face the eye as a whole (all, where nothing is culled).

    In object space, since affine maps keep the sign of n . (eye - p). With phi the angle of the cone's axis
    to the ray, theta the cone's and beta the ball's half-angle: all of it faces away if
    phi + theta + beta <= 90 degrees.
    """
    cosine, sine = forest.cone.take(node, axis=1).astype(np.float64)
    normal = forest.normal.take(node, axis=1)
    if lens.perspective:
        ray = center - view.eye
        tangent = np.sqrt(np.maximum((ray**2).sum(axis=0) - sphere.astype(np.float64) ** 2, 0))
        along = (normal * ray).sum(axis=0)
        least = sine * tangent + cosine * sphere
        narrow = (tangent > 0) & (cosine * np.hypot(tangent, sphere) >= sphere)
    else:
        along, least, narrow = (normal * view.forward).sum(axis=0), sine, cosine >= 0
    return view.culls & narrow & (along >= least), ~view.culls | (narrow & (along <= -least))


def within_tolerance(
    forest: NodeTable,
    lens: Criteria,
    node: np.ndarray,
    position: np.ndarray,
    size: np.ndarray,
    reach: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes are at most as large as their share of the tolerance, and of which all descendants exceed all of it.

    The picture of a ball of radius r whose center has depth z and distance D is longest along the radius from
    the picture's center: f (tan(theta + beta) - tan(theta - beta)) = 2 f r sqrt(D^2 - r^2) / (z^2 - r^2).
    Nodes that reach before the near plane have no size there, and are refined.
    """
    smallest = forest.smallest.take(node) * scale
    limit = lens.limit
    if lens.blur is not None and lens.wanted != "SHARP":
        # Nodes of all sizes may be drawn, where the blur allows it.
        smallest = np.zeros(len(node))
        least, _ = lens.blur.bounds(*_depth_range(lens, position, size))
        limit = limit * (lens.blur.widest(least, lens.tolerance) / lens.tolerance)
    limit = limit * 2.0 ** (-lens.band * forest.lot.take(node)) if lens.band > 0 else limit
    if not lens.perspective:
        return size <= limit, smallest > lens.limit
    z = -position[2]
    squares = z * z - size * size
    distance = position[0] ** 2 + position[1] ** 2 + squares
    small = (z - size > lens.near) & (size * np.sqrt(np.maximum(distance, 0)) <= limit * squares)
    # No descendant is deeper than the ball's far side, and none projects smaller than r / z.
    return small, smallest > lens.limit * np.maximum(z + reach, 0)
