"""Which rows of a page's splats may lie in a picture: tiles, maps of lights and views from near show few of them."""

from __future__ import annotations

import numpy as np

from ...device.packing import PAGE_WIDTH
from ..pages.point_page import PageDraw
from ..uniforms import SampleView

MARGIN = 2.0  # pixels around the picture
GAP = 2  # rows outside of the picture that are drawn with those around them: a dispatch takes longer


def splats_in_picture(draw: PageDraw, view: SampleView, wide: float = 0.0) -> list[tuple[int, int]]:
    """Returns runs of elements, first and last + 1, that hold all that a view shows of a page. `wide`: all of it that
    may be so many pixels wide."""
    bounds, widest = draw.page.bounds, draw.page.widest
    if draw.view_from_page is None or bounds is None or widest is None:
        return [(0, draw.elements)]
    shown = boxes_in_picture(bounds, draw.view_from_page, view)
    if wide > 0.0:
        shown &= widths_in_picture(bounds, widest, draw.view_from_page, view) >= wide
    ends = np.flatnonzero(np.diff(shown, prepend=False, append=False)).reshape(-1, 2)
    if len(ends) == 0:
        return []
    apart = np.flatnonzero(ends[1:, 0] - ends[:-1, 1] > GAP)
    first, last = ends[np.append(0, apart + 1), 0], ends[np.append(apart, len(ends) - 1), 1]
    last = np.minimum(last * PAGE_WIDTH, draw.splats)
    return list(zip((first * PAGE_WIDTH).tolist(), last.tolist(), strict=True))


def boxes_in_picture(bounds: np.ndarray, view_from_box: np.ndarray, view: SampleView) -> np.ndarray:
    """Returns (R,) bool, false for boxes that lie beyond a side of the picture, or of its nearest or farthest depth.

    bounds: (R, 2, 3), low and high corner. view_from_box: (4, 4).
    """
    fx, fy = view.camera.pixel_from_view()[:2]
    (cx, cy), (width, height) = view.principal_point, view.size
    # What is negative beyond each side, of view coordinates: depth is -z in a perspective, 1 in a parallel view.
    sides = np.array([
        [fx, 0.0, cx + MARGIN],
        [-fx, 0.0, width + MARGIN - cx],
        [0.0, fy, cy + MARGIN],
        [0.0, -fy, height + MARGIN - cy],
    ])  # fmt: skip
    planes = np.zeros((6, 4))
    planes[:4, :2] = sides[:, :2]
    if view.camera.perspective:
        planes[:4, 2] = -sides[:, 2]
    else:
        planes[:4, 3] = sides[:, 2]
    planes[4, 2:], planes[5, 2:] = (-1.0, -view.near), (1.0, view.far)
    with np.errstate(all="ignore"):
        planes = planes @ view_from_box
        middle, half = bounds.mean(axis=1, dtype=np.float64), (bounds[:, 1].astype(np.float64) - bounds[:, 0]) / 2
        farthest = middle @ planes[:, :3].T + half @ np.abs(planes[:, :3]).T + planes[:, 3]
        return ~(farthest < 0).any(axis=1)  # what is not finite is drawn


def widths_in_picture(
    bounds: np.ndarray, widest: np.ndarray, view_from_box: np.ndarray, view: SampleView
) -> np.ndarray:
    """Returns (R,) how many pixels wide, at most, an ellipsoid within each box may be where the picture shows some of
    it; inf where it may reach the eye.

    bounds: (R, 2, 3), low and high corner. widest: (R,) the largest half-axis. view_from_box: (4, 4).
    """
    focal = np.abs(view.camera.pixel_from_view()[:2])
    with np.errstate(all="ignore"):
        radius = widest.astype(np.float64) * np.linalg.norm(view_from_box[:3, :3], 2)
        if not view.camera.perspective:
            return np.nan_to_num(2 * radius * focal.max(), nan=np.inf)
        middle, half = bounds.mean(axis=1, dtype=np.float64), (bounds[:, 1].astype(np.float64) - bounds[:, 0]) / 2
        nearest = -(middle @ view_from_box[2, :3] + view_from_box[2, 3]) - half @ np.abs(view_from_box[2, :3])
        # A point at the slope s and the depth z moves by at most r sqrt(1 + s^2) / (z - r) where it moves by r.
        share = radius / nearest
        sides = np.maximum(view.principal_point, np.array(view.size) - view.principal_point) + MARGIN
        slope = np.hypot(*(sides / focal))
        slope = (slope + share) / (1 - share)  # of the middle of what reaches into the picture
        widths = 2 * share * np.sqrt(1 + slope * slope) * focal.max()
        return np.where((nearest > 0) & (share < 1) & np.isfinite(widths), widths, np.inf)
