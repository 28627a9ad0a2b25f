"""Points of strands as one view sees them: pixel positions, widths, areas, and which segments may be visible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.camera import Camera
from .levels import StrandLevels

SHORTEST_DIRECTED = 1e-3  # pixels: shorter segments have no direction on the screen
NEAREST = 1e-12  # units from the eye: what is nearer is drawn as if there, for squares of pixels to fit float32


@dataclass(frozen=True, eq=False)
class ProjectedStrands:
    """Points of strands as one view sees them."""

    place: np.ndarray  # (P, 2) float32, pixels; of what lies before the near plane as if it lay in it
    depth: np.ndarray  # (P,) float32
    reach: np.ndarray  # (P,) float32: radius in view space
    width: np.ndarray  # (P,) float32, pixels
    across: np.ndarray | None  # (P, 2) float32, pixels: from a ribbon's middle to its edge; None: tubes
    length: np.ndarray  # (P - 1,) float32: pixels from each point to the next


def project(strands: StrandLevels, view_from_object: np.ndarray, camera: Camera) -> ProjectedStrands:
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
            # How the picture of a ribbon's edge lies beside that of its middle.
            nearer = side[:, 2] * inverse if camera.perspective else np.zeros_like(depth)
            columns = [f * inverse * (side[:, i] + p[:, i] * nearer) for i, f in enumerate((fx, fy))]
            across = np.stack(columns, axis=1).astype(np.float32)
            width = 2 * np.sqrt(np.einsum("nc,nc->n", across, across))
        step = np.diff(q, axis=0)
        length = np.sqrt(np.einsum("nc,nc->n", step, step))
    return ProjectedStrands(q, depth, reach, width, across, length)


def _cumulative_area(strands: StrandLevels, picture: ProjectedStrands) -> np.ndarray:
    """(P,) float64: pixels^2 from the first point to each."""
    width, across = picture.width, picture.across
    if across is None:
        area = picture.length * (0.5 * (width[1:] + width[:-1]))
    else:
        x, y = np.diff(picture.place, axis=0).T
        area = np.abs(across[:-1, 0] * y - across[:-1, 1] * x) + np.abs(across[1:, 0] * y - across[1:, 1] * x)
    area[strands.start[1:-1] - 1] = 0  # between strands
    return np.concatenate([[0.0], np.cumsum(area, dtype=np.float64)])


def in_picture(picture: ProjectedStrands, first: np.ndarray, last: np.ndarray, camera: Camera) -> np.ndarray:
    """(K,) bool: segments from `first` to `last` that may be in the picture."""
    margin = 0.5 * np.maximum(picture.width[first], picture.width[last]) + 2
    seen = np.ones(len(first), bool)
    # Coordinate by coordinate: along a short axis NumPy takes many times as long.
    for place, most in zip(picture.place.T, camera.window[2:], strict=True):
        x, y = place[first], place[last]
        seen &= (np.minimum(x, y) < most + margin) & (np.maximum(x, y) > -margin)
    a, b = picture.depth[first], picture.depth[last]
    nearest, farthest = np.minimum(a, b), np.maximum(a, b)
    seen |= nearest < camera.near  # what is behind the eye has no picture
    reach = np.maximum(picture.reach[first], picture.reach[last])
    return seen & (farthest + reach > camera.near) & (nearest - reach < camera.far)


def line_shares(
    strands: StrandLevels, picture: ProjectedStrands, first: np.ndarray, last: np.ndarray, thinned: np.ndarray
) -> np.ndarray:
    """(K, 2) float32: widths at the ends of segments over that of the raster's line, which is one pixel along the
    nearer axis. Segments that stand for several (`thinned`) have the area of these."""
    chord = picture.place[last] - picture.place[first]
    size = np.sqrt(np.einsum("nc,nc->n", chord, chord))
    line = np.where(size > SHORTEST_DIRECTED, np.maximum(*np.abs(chord.T)) / np.maximum(size, SHORTEST_DIRECTED), 1)
    across = picture.across
    if across is None:
        wide = np.stack([picture.width[first], picture.width[last]], axis=1)
    else:
        x, y = (chord / np.maximum(size, SHORTEST_DIRECTED)[:, None]).T
        wide = 2 * np.stack([np.abs(across[i, 0] * y - across[i, 1] * x) for i in (first, last)], axis=1)
    if thinned.any():
        area = _cumulative_area(strands, picture)
        covers = (area[last] - area[first]).astype(np.float32)
        straight = 0.5 * (wide[:, 0] + wide[:, 1]) * size
        alike = thinned & (straight > 0.25 * covers)
        wide[alike] *= (covers[alike] / straight[alike])[:, None]
        other = thinned & ~alike
        wide[other] = (covers[other] / np.maximum(size[other], SHORTEST_DIRECTED))[:, None]
    return np.nan_to_num(wide / line[:, None], posinf=1e30).astype(np.float32)


def tube_radius_scale(view_from_object: np.ndarray) -> np.ndarray:
    """(I,) float64: by how much matrices (I, 4, 4) scale the radii of tubes; 0 where they are not finite."""
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.cbrt(np.abs(np.linalg.det(view_from_object[:, :3, :3]))), posinf=0.0)
