"""The thin lens: circles of confusion (Křivánek 2003, section 5.1, equations 6 to 8), sample points on its aperture,
and the camera as seen from one of them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..numeric.sequences import centred_pairs
from ..scene.camera import Aperture, Camera
from ..scene.settings import Settings

# The third and fourth constant of the rank-one sequence in four dimensions (Roberts 2018): 1 / p^3 and 1 / p^4 with
# p^5 = p + 1. Together with the two dimensions that positions in a pixel use, they fill four dimensions evenly.
R4 = np.array([0.6287067210378087, 0.5385972572236101])


def circle_of_confusion(camera: Camera, depth: np.ndarray | float) -> np.ndarray:
    """(...) float64: radius in pixels of the circle of confusion of points at `depth` (...) along the view.

    A point is seen through all of the aperture, of radius r, and each point of the aperture sees it elsewhere in the
    picture unless it lies at the depth of focus f. With the focal length in pixels F, its images fill a disk of radius
    F r |1/f - 1/d| (equations 6 to 8; perspective) or F r |1 - d/f| (parallel, as Cycles has it). Nothing is blurred
    without an aperture; at depth 0 of a perspective camera everything infinitely.
    """
    depth = np.asarray(depth, np.float64)
    aperture = camera.aperture
    if aperture is None or aperture.radius <= 0.0:
        return np.zeros_like(depth)
    with np.errstate(divide="ignore"):
        apart = 1 / aperture.focus - 1 / depth if camera.perspective else 1 - depth / aperture.focus
    return abs(camera.pixel_from_view()[0]) * aperture.radius * np.abs(apart)


@lru_cache(maxsize=16)
def lens_points(samples: int, aperture: Aperture) -> np.ndarray:
    """(samples, 2) float64: sample points on the aperture, of equal weight, in world units to the right and upwards.

    The first is its centre; then come pairs that face each other across it, as positions in a pixel do. Every beginning
    of the sequence fills the aperture evenly, and together with those of a pixel fill all four dimensions. Where the
    aperture is no disk, its angles and radii are stretched to the polygon's, which keeps shares of the area."""
    disk = _disk((0.5 + np.arange(samples // 2 + 1)[:, None] * R4) % 1.0)
    result = centred_pairs(disk, -disk, samples)
    result /= np.maximum(np.hypot(*result.T), 1.0)[:, None]  # points that were shifted out of the disk to keep the mean
    if aperture.blades >= 3:
        # Polygons with an odd number of sides are not their own mirror image: points are paired on the disk instead.
        result = _polygon(result, aperture.blades, aperture.rotation)
    result = result * aperture.radius * [1 / aperture.ratio, 1.0]
    result.setflags(write=False)
    return result


def _disk(square: np.ndarray) -> np.ndarray:
    """Maps points (N, 2) of the unit square to the unit disk, keeping neighbours and areas (Shirley and Chiu 1997)."""
    x, y = (2 * square - 1).T
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    share = np.where(wide, y, x) / np.where(radius == 0, 1.0, radius)
    angle = np.where(wide, np.pi / 4 * share, np.pi / 2 - np.pi / 4 * share)
    return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _polygon(disk: np.ndarray, sides: int, rotation: float) -> np.ndarray:
    """Maps points (N, 2) of the unit disk to the regular polygon inscribed in it, with one side's centre at `rotation`.

    A sector of the disk becomes the triangle over its side: equal parts of the angle, equal parts of the side.
    """
    radius, sector = np.hypot(*disk.T), 2 * np.pi / sides
    turn = np.arctan2(disk[:, 1], disk[:, 0]) / sector
    side = np.round(turn)
    across = 2 * (turn - side) * np.sin(sector / 2)
    angle = side * sector + rotation
    x, y = radius * np.cos(sector / 2), radius * across
    return np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y], axis=1)


def uses_lens_samples(camera: Camera, settings: Settings) -> bool:
    """Whether the samples of a picture are drawn through different points on the lens."""
    aperture = camera.aperture
    return aperture is not None and aperture.radius > 0.0 and settings.dof_method == "LENS_SAMPLES"


def camera_through(camera: Camera, point: np.ndarray) -> Camera:
    """The camera as seen from a point (2,) of the aperture, in world units: everything is in focus.

    What lies at the depth of focus keeps its position in the picture. A perspective camera moves, and its principal
    point with it. A parallel one looks along another direction; how the plane across that falls onto the picture's is a
    stretch, which `clip_from_view` takes, and a skew of at most a fourth of the squared angle, which `view_from_world`
    takes: in that much it is not rigid. Clipping planes stand across the new direction."""
    x, y = (float(v) for v in point)
    aperture = camera.aperture
    if aperture is None or (x == 0.0 and y == 0.0):
        return replace(camera, aperture=None)
    view, clip = np.eye(4), camera.clip_from_view.copy()
    view[:2, 3] = -x, -y
    if camera.perspective:
        clip[:2, 2] -= np.diag(clip)[:2] * (x, y) / aperture.focus
    else:
        turn = _towards(np.array([x, y]) / aperture.focus)
        spread = np.linalg.inv(turn[:2, :2])
        stretch = np.diag(spread)
        clip[:2, :2] *= stretch
        skewed = turn.copy()
        skewed[:2] = (spread / stretch[:, None]) @ turn[:2]
        view[:3] = skewed @ view[:3]
    return replace(camera, view_from_world=view @ camera.view_from_world, clip_from_view=clip, aperture=None)


def _towards(slope: np.ndarray) -> np.ndarray:
    """(3, 3): the smallest rotation that takes the direction (-slope, -1) to (0, 0, -1)."""
    tangent = float(np.hypot(*slope))
    if tangent == 0.0:
        return np.eye(3)
    cosine = 1 / np.hypot(1.0, tangent)
    sine = tangent * cosine
    u, v = slope / tangent
    # About the axis (-v, u, 0), by the angle between them.
    return np.array([
        [cosine * u * u + v * v, (cosine - 1) * u * v, -sine * u],
        [(cosine - 1) * u * v, cosine * v * v + u * u, -sine * v],
        [sine * u, sine * v, cosine],
    ])  # fmt: skip


def widened_camera(camera: Camera, nearest: float, farthest: float) -> Camera:
    """The camera with a larger picture around the same centre: of what lies between these depths it shows
    everything that any point on the aperture sees. Pixels keep their size.

    Bounded by the picture's larger side: where circles of confusion are wider, what lies farther outside is missing.
    """
    aperture = camera.aperture
    if aperture is None:
        return camera
    side = max(camera.resolution)
    fx, fy = np.abs(camera.pixel_from_view()[:2])
    blur = circle_of_confusion(camera, np.array([nearest, farthest])) * max(1 / aperture.ratio, fy / fx)
    margin = int(np.ceil(min(np.nan_to_num(blur, nan=0.0, posinf=side).max(), side)))
    size = np.array(camera.resolution)
    larger = size + 2 * margin
    clip = camera.clip_from_view.copy()
    # Nothing but the scale of x and y: shifts, in pixels, stay what they are.
    clip[:2] *= (size / larger)[:, None]
    x0, y0, width, height = camera.window
    region = (x0, y0, width + 2 * margin, height + 2 * margin)
    return replace(camera, clip_from_view=clip, resolution=(int(larger[0]), int(larger[1])), region=region)
