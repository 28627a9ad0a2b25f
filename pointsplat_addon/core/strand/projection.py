"""Points of strands as one view sees them: pixel positions, widths, areas, and which segments may be visible."""

from __future__ import annotations

import numpy as np

from ..numeric.lattice import Lattice
from ..numeric.record import record
from ..scene.camera import Camera
from .levels import StrandLevels
from .segments import OWN_WIDTH, THIN

SHORTEST_DIRECTED = 1e-3  # pixels: shorter segments have no direction on the screen
NEAREST = 1e-12  # units from the eye: points nearer are projected from there, so that squares of pixels fit float32


@record
class ProjectedStrands:
    """The P points of strands as one view sees them."""

    pixel: np.ndarray  # (P, 2) float32; points before the near plane are projected as if they lay in it
    depth: np.ndarray  # (P,) float32
    radius: np.ndarray  # (P,) float32, in view space
    width: np.ndarray  # (P,) float32: diameter in pixels
    across: np.ndarray | None  # (P, 2) float32, pixels: from a ribbon's middle to its edge; None: tubes
    length: np.ndarray  # (P - 1,) float32: pixels from each point to the next


def project(strands: StrandLevels, view_from_object: np.ndarray, camera: Camera) -> ProjectedStrands:
    """Projects the points of strands; view_from_object: (4, 4) float64."""
    linear = view_from_object[:3, :3]
    with np.errstate(all="ignore"):
        shift = (linear @ strands.origin + view_from_object[:3, 3]).astype(np.float32)
        p = strands.position @ linear.T.astype(np.float32) + shift
        scale = np.float32(tube_radius_scale(view_from_object[None])[0])
        fx, fy, cx, cy = camera.pixel_from_view()
        depth = -p[:, 2]
        inverse = np.ones_like(depth)
        if camera.perspective:
            inverse = 1 / np.maximum(depth, np.float32(max(camera.near, NEAREST)))
        q = np.stack([p[:, 0] * (inverse * fx) + cx, p[:, 1] * (inverse * fy) + cy], axis=1).astype(np.float32)
        reach, across = strands.radius * scale, None
        if strands.side is None:
            width = (2 * np.float32(np.sqrt(abs(fx * fy)))) * reach * inverse
        else:
            side = (strands.side * strands.radius[:, None]) @ linear.T.astype(np.float32)
            reach = np.sqrt(np.einsum("nc,nc->n", side, side))
            # The offset in the picture from a ribbon's middle to its edge.
            nearer = side[:, 2] * inverse if camera.perspective else np.zeros_like(depth)
            columns = [f * inverse * (side[:, i] + p[:, i] * nearer) for i, f in enumerate((fx, fy))]
            across = np.stack(columns, axis=1).astype(np.float32)
            width = 2 * np.sqrt(np.einsum("nc,nc->n", across, across))
        step = np.diff(q, axis=0)
        length = np.sqrt(np.einsum("nc,nc->n", step, step))
    return ProjectedStrands(q, depth, reach, width, across, length)


def _cumulative_area(strands: StrandLevels, picture: ProjectedStrands) -> np.ndarray:
    """(P,) float64: area in pixels^2 of all strands before each point."""
    width, across = picture.width, picture.across
    if across is None:
        area = picture.length * (0.5 * (width[1:] + width[:-1]))
    else:
        x, y = np.diff(picture.pixel, axis=0).T
        area = np.abs(across[:-1, 0] * y - across[:-1, 1] * x) + np.abs(across[1:, 0] * y - across[1:, 1] * x)
    area[strands.start[1:-1] - 1] = 0  # between strands
    return np.concatenate([[0.0], np.cumsum(area, dtype=np.float64)])


def in_picture(picture: ProjectedStrands, first: np.ndarray, last: np.ndarray, camera: Camera) -> np.ndarray:
    """(K,) bool: which segments, between points `first` (K,) and `last` (K,), may be in the picture."""
    margin = 0.5 * np.maximum(picture.width[first], picture.width[last]) + 2
    seen = np.ones(len(first), bool)
    # Coordinate by coordinate: along a short axis NumPy takes many times as long.
    for place, most in zip(picture.pixel.T, camera.window[2:], strict=True):
        x, y = place[first], place[last]
        seen &= (np.minimum(x, y) < most + margin) & (np.maximum(x, y) > -margin)
    a, b = picture.depth[first], picture.depth[last]
    nearest, farthest = np.minimum(a, b), np.maximum(a, b)
    seen |= nearest < camera.near  # what is behind the eye has no picture
    reach = np.maximum(picture.radius[first], picture.radius[last])
    return seen & (farthest + reach > camera.near) & (nearest - reach < camera.far)


def line_shares(
    strands: StrandLevels, picture: ProjectedStrands, first: np.ndarray, last: np.ndarray, simplified: np.ndarray
) -> np.ndarray:
    """(K, 2) float32: the share of a raster line that a segment covers at either end; may exceed 1.

    It is the segment's width over that of the line, which is one pixel along its minor axis. Segments that replace
    several (`simplified`, (K,) bool) keep the area of those.
    """
    direction, size = _directions(picture, first, last)
    line = np.where(size > SHORTEST_DIRECTED, np.maximum(*np.abs(direction.T)), 1)
    wide = _widths(strands, picture, first, last, simplified, direction, size)
    return np.nan_to_num(wide / line[:, None], posinf=1e30).astype(np.float32)


def cell_shares(
    strands: StrandLevels,
    picture: ProjectedStrands,
    first: np.ndarray,
    last: np.ndarray,
    simplified: np.ndarray,
    camera: Camera,
    lattice: Lattice,
) -> np.ndarray:
    """(K, 2) float32: as `line_shares`, of lines that are one cell of a lattice wide along their minor axis.

    OWN_WIDTH of narrow segments of which an end lies before the near plane.
    """
    direction, size = _directions(picture, first, last)
    sides = np.abs(lattice.cells(direction).T) / lattice.count
    line = np.where(size > SHORTEST_DIRECTED, np.maximum(*sides), lattice.spacing)
    wide = _widths(strands, picture, first, last, simplified, direction, size)
    if picture.across is None and camera.perspective:
        # Planes through the eye touch tubes: their outlines are farther apart away from the principal point.
        fx, fy, cx, cy = camera.pixel_from_view()
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        away = np.einsum("nc,nc->n", picture.pixel[first] - np.array([cx, cy], np.float32), normal)
        stretch = np.square(normal * np.array([fx, fy], np.float32)).sum(axis=1) + np.square(away)
        wide *= np.sqrt(stretch / np.float32(abs(fx * fy)))[:, None]
    share = np.nan_to_num(wide / line[:, None], posinf=1e30).astype(np.float32)
    if camera.perspective:
        cut = np.minimum(picture.depth[first], picture.depth[last]) < camera.near
        share[cut & (np.maximum(*share.T) < THIN)] = OWN_WIDTH
    return share


def _directions(picture: ProjectedStrands, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The directions of segments, (K, 2) float32, no longer than 1, and their lengths in pixels, (K,) float32."""
    chord = picture.pixel[last] - picture.pixel[first]
    size = np.sqrt(np.einsum("nc,nc->n", chord, chord))
    return chord / np.maximum(size, SHORTEST_DIRECTED)[:, None], size


def _widths(
    strands: StrandLevels,
    picture: ProjectedStrands,
    first: np.ndarray,
    last: np.ndarray,
    simplified: np.ndarray,
    direction: np.ndarray,
    size: np.ndarray,
) -> np.ndarray:
    """(K, 2) float32: the widths of segments at both ends in pixels, across them."""
    across = picture.across
    if across is None:
        wide = np.stack([picture.width[first], picture.width[last]], axis=1)
    else:
        x, y = direction.T
        wide = 2 * np.stack([np.abs(across[i, 0] * y - across[i, 1] * x) for i in (first, last)], axis=1)
    if simplified.any():
        area = _cumulative_area(strands, picture)
        covers = (area[last] - area[first]).astype(np.float32)
        straight = 0.5 * (wide[:, 0] + wide[:, 1]) * size
        alike = simplified & (straight > 0.25 * covers)
        wide[alike] *= (covers[alike] / straight[alike])[:, None]
        other = simplified & ~alike
        wide[other] = (covers[other] / np.maximum(size[other], SHORTEST_DIRECTED))[:, None]
    return wide


def tube_radius_scale(view_from_object: np.ndarray) -> np.ndarray:
    """(I,) float64: factors by which matrices (I, 4, 4) scale the radii of tubes, the cube roots of their determinants;
    0 where a matrix is not finite."""
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.cbrt(np.abs(np.linalg.det(view_from_object[:, :3, :3]))), posinf=0.0)
