"""Ellipses that close a sampling: each holds the cell of the plane that is nearer to its point than to any other.

Disks that hold the Voronoi cells of their points leave no hole between them, however regular the sampling is; smaller
ones do (of random points, disks of the radius r leave the share exp(-density pi r^2) open). Where a cell has no end,
the surface has an edge, and the ellipse goes no farther than half the spacing.
"""

from __future__ import annotations

import numpy as np

from ...numeric.vectors import basis, dot

DIRECTIONS = 16
MARGIN = 1.05  # cells end between directions, and neighbours' planes are not one plane
OPEN = 1.7  # cells that reach farther than so many spacings are open: of random points, one in 9,000 is
EDGE = 0.25  # spacings to which ellipses reach where their cells are open
TINY = 1e-30
FITTING = 0.25  # weight of neighbours that lie on the surface, and bound the cell


def closing_ellipses(
    offset: np.ndarray, squared: np.ndarray, normal: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns major axes (3, n), half-axes (2, n) (major, minor) and offsets (3, n) of the centres from the points,
    float32, of n ellipses.

    Neighbours as in `planes.fit_planes`; normals (3, n); weights (k, n) of how well each neighbour fits the plane.
    """
    u, v = (axis.astype(np.float32) for axis in basis(normal.astype(np.float64)))
    fits = weight > FITTING
    known = np.isfinite(squared)
    offset = np.where(known, offset, 0)
    x, y = dot(u[:, None], offset), dot(v[:, None], offset)
    plane = x * x + y * y
    plane[~fits] = np.inf
    # n points lie within the farthest of them, and half of that one.
    count = fits.sum(axis=0)
    reach = np.where(fits, plane, 0).max(axis=0)
    spacing = np.sqrt(np.pi * reach / np.maximum(count + 0.5, 1))
    ends = np.empty((DIRECTIONS, x.shape[1]), np.float32)
    half = plane / 2
    turn = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    turns = np.stack([np.cos(turn), np.sin(turn)]).astype(np.float32)
    limit = OPEN * spacing
    for end, cosine, sine in zip(ends, *turns, strict=True):
        along = cosine * x + sine * y
        np.maximum(along, np.float32(TINY), out=along)
        with np.errstate(over="ignore"):
            np.min(half / along, axis=0, out=end)
    ends = np.where(ends <= limit, ends, EDGE * spacing)
    # The ellipse about the cell's middle that has the second moments of its ends, as large as holds them all. About the
    # point itself it would reach as far beyond an edge as it reaches inwards.
    px, py = turns[0][:, None] * ends, turns[1][:, None] * ends
    middle = [2 * p.mean(axis=0) for p in (px, py)]
    px -= middle[0]
    py -= middle[1]
    xx, xy, yy = (np.einsum("dn,dn->n", a, b) for a, b in ((px, px), (px, py), (py, py)))
    mean, difference = (xx + yy) / 2, (xx - yy) / 2
    deviation = np.sqrt(difference * difference + xy * xy)
    angle = 0.5 * np.arctan2(xy, difference)
    a2, b2 = mean + deviation, np.maximum(mean - deviation, 1e-4 * mean)
    cosine, sine = np.cos(angle), np.sin(angle)
    major, minor = cosine * px + sine * py, cosine * py - sine * px
    share = (major * major * (1 / np.maximum(a2, TINY)) + minor * minor * (1 / np.maximum(b2, TINY))).max(axis=0)
    scale = MARGIN * np.sqrt(share)
    radii = np.stack([np.sqrt(a2), np.sqrt(b2)]) * scale
    return u * cosine + v * sine, radii, u * middle[0] + v * middle[1]
