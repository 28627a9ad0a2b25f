"""Which rows of a page's splats may lie in a picture: tiles, maps of lights and views from near show few of them."""

from __future__ import annotations

import numpy as np

from ...device.packing import PAGE_WIDTH
from ..pages.point_page import PageDraw
from ..uniforms import SampleView

MARGIN = 2.0  # pixels around the picture
GAP = 2  # rows outside of the picture that are drawn with those around them: a dispatch takes longer


def splats_in_picture(draw: PageDraw, view: SampleView) -> list[tuple[int, int]]:
    """Returns runs of elements, first and last + 1, that hold all that a view shows of a page."""
    bounds = draw.page.bounds
    if draw.view_from_page is None or bounds is None:
        return [(0, draw.elements)]
    shown = boxes_in_picture(bounds, draw.view_from_page, view)
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
