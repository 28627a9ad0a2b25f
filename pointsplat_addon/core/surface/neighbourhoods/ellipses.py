"""Ellipses that close a sampling: each holds the cell of the plane that is nearer to its point than to any other.

Disks that hold the Voronoi cells of their points leave no hole between them, however regular the sampling is; smaller
ones do (of random points, disks of the radius r leave the share exp(-density pi r^2) open). Where a cell has no end,
the surface has an edge, and the ellipse goes no farther than half the spacing.
"""

from __future__ import annotations

import numpy as np

from ...numeric.vectors import basis, dot

DIRECTIONS = 16
MARGIN = 1.1  # cells end between directions, and neighbours' planes are not one plane
OPEN = 1.7  # cells that reach farther than so many spacings are open: of random points, one in 9,000 is
EDGE = 0.5  # spacings to which ellipses reach where their cells are open
FITTING = 0.25  # weight of neighbours that lie on the surface, and bound the cell


def closing_ellipses(
    offset: np.ndarray, squared: np.ndarray, normal: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns major axes (3, n) and half-axes (2, n) (major, minor), float32, of the ellipses of n points.

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
        np.maximum(along, np.float32(1e-30), out=along)
        with np.errstate(over="ignore"):
            np.min(half / along, axis=0, out=end)
    ends = np.where(ends <= limit, ends, EDGE * spacing)
    # The ellipse with the second moments of the ends, as large as holds them all.
    square = ends * ends
    cc, cs, ss = (np.tensordot(w, square, 1) for w in (turns[0] * turns[0], turns[0] * turns[1], turns[1] * turns[1]))
    mean, difference = (cc + ss) / 2, (cc - ss) / 2
    deviation = np.sqrt(difference * difference + cs * cs)
    angle = 0.5 * np.arctan2(cs, difference)
    a2, b2 = mean + deviation, np.maximum(mean - deviation, 1e-4 * mean)
    cosine, sine = np.cos(angle), np.sin(angle)
    along = turns[0][:, None] * cosine + turns[1][:, None] * sine
    share = (
        square * (along * along * (1 / np.maximum(a2, 1e-30)) + (1 - along * along) * (1 / np.maximum(b2, 1e-30)))
    ).max(axis=0)
    scale = MARGIN * np.sqrt(share)
    radii = np.stack([np.sqrt(a2), np.sqrt(b2)]) * scale
    return u * cosine + v * sine, radii
