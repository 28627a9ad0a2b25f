"""Where boxes lie in the picture, and how far away, whatever the device rounds."""

from __future__ import annotations

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.bounds import box_corners
from ...passes.uniforms import SampleView

# Of the terms of a sum, by which the device may bring a point elsewhere: float32 rounds by 6e-8, and rounds corners,
# matrices, three products and three sums.
ROUNDING = 1e-6
# Of pixel coordinates and of depth, that the device divides, clips and interpolates.
ROUNDING_IN_PICTURE = 1e-5
# Pairs of the corners that box_corners returns.
BOX_EDGES = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit])


def places_in_picture(box: np.ndarray, view_from_object: np.ndarray, view: SampleView) -> tuple[np.ndarray, np.ndarray]:
    """Returns rectangles, (I, 4) float64, that hold what the device draws of a box for each transform: low and high
    corner, from 0 to 1 over the picture; where all of it lies outside, the high corner is not above the low one. And
    its nearest and farthest depth, (I, 2) float64, the nearest at most what the device may write.

    box: (2, 3) or (I, 2, 3), low and high corner in object space. view_from_object: (I, 4, 4).
    """
    rectangle, depth = np.empty((len(view_from_object), 4)), np.empty((len(view_from_object), 2))

    def place(some: slice) -> None:
        with np.errstate(all="ignore"):
            found = _places(box if box.ndim == 2 else box[some], view_from_object[some], view)
        rectangle[some], depth[some] = found

    each_block(len(view_from_object), place)
    return rectangle, depth


def _places(box: np.ndarray, view_from_object: np.ndarray, view: SampleView) -> tuple[np.ndarray, np.ndarray]:
    linear, moved = view_from_object[:, :3, :3], view_from_object[:, :3, 3]
    p = box_corners(box[..., 0, :], box[..., 1, :]) @ linear.swapaxes(1, 2) + moved[:, None]
    reach = np.abs(box).max(axis=-2)
    error = ROUNDING * ((np.abs(linear) @ reach[..., None])[..., 0] + np.abs(moved))  # (I, 3)
    depth = -p[..., 2]
    nearest, farthest = depth.min(axis=1), depth.max(axis=1)
    found = _rectangles_around(p, error, view)
    # All that the device may not take to lie before the near plane.
    near, far = view.near - error[:, 2], view.far + error[:, 2]
    outside = (farthest < near) | (nearest > far)
    across = np.flatnonzero((nearest < near) & (farthest >= near))
    if len(across) and view.camera.perspective:
        found[across] = _rectangles_around(_beyond(p[across], near[across]), error[across], view)
        nearest[across] = -np.inf
    unknown = ~(np.isfinite(found).all(axis=1) & np.isfinite(depth).all(axis=1))
    found[unknown], nearest[unknown], farthest[unknown] = (0.0, 0.0, 1.0, 1.0), -np.inf, np.inf
    found[outside] = 0.0
    nearest -= error[:, 2] + ROUNDING_IN_PICTURE * np.maximum(np.abs(nearest), np.abs(farthest))
    return np.clip(found, 0.0, 1.0), np.stack([nearest, farthest], axis=1)


def _rectangles_around(p: np.ndarray, error: np.ndarray, view: SampleView) -> np.ndarray:
    """Returns the rectangles, (I, 4), around points (I, K, 3) in view space that are known but for errors (I, 3), and
    around these a pixel; see `places_in_picture`."""
    focal = np.array(view.camera.pixel_from_view()[:2])
    error = error[:, None]
    pixels, moved = p[..., :2] * focal, error[..., :2] * focal
    if view.camera.perspective:
        depth = -p[..., 2:]
        pixels = pixels / depth
        # A point before the eye may be anywhere.
        moved = (moved + np.abs(pixels) * error[..., 2:]) / np.maximum(depth - error[..., 2:], 0.0)
    moved = moved + ROUNDING_IN_PICTURE * np.abs(pixels)
    low, high = (pixels - moved).min(axis=1), (pixels + moved).max(axis=1)
    place = np.array(view.principal_point)
    return np.concatenate([(place + low - 1) / view.size, (place + high + 1) / view.size], axis=1)


def _beyond(p: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Returns points (I, 24, 3) around what lies beyond the near planes, (I,), of boxes whose corners, (I, 8, 3), lie
    on both sides: the ends of their edges, or where these meet the plane."""
    ends = p[:, BOX_EDGES]  # (I, 12, 2, 3)
    short = np.maximum(near[:, None, None] + ends[..., 2], 0.0)  # what an end lacks in depth
    share = np.where(short > 0, short / np.abs(ends[..., 0, 2] - ends[..., 1, 2])[..., None], 0.0)
    moved = ends + share[..., None] * (ends[:, :, ::-1] - ends)
    gone = (short > 0).all(axis=2)  # edges before the plane
    # What is found twice does not matter.
    some = moved[np.arange(len(p)), np.argmin(gone, axis=1), 0]
    return np.where(gone[..., None, None], some[:, None, None], moved).reshape(len(p), -1, 3)
