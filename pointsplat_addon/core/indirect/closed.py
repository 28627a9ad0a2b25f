"""Finds out whether a mesh is closed: whether its surface has an inside that nobody sees from outside, which side that
is, and what lies in it; and whether it is closed but for small gaps."""

from __future__ import annotations

import numpy as np

from ..scene.mesh import Mesh, triangle_corners

# Odd 64-bit constants of splitmix64 (Steele et al. 2014).
MULTIPLIERS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
ALONG = np.array([0.267, 0.535, 0.802]) / np.linalg.norm([0.267, 0.535, 0.802])  # aslant to all axes
FEWEST_RAYS, MOST_RAYS = 32, 128
MOST_TESTS = 1 << 25  # of rays and boxes around triangles
BLOCK = 1 << 16  # triangles that are looked at together
FLAT = 1e-3  # of the volume of a cube with the same surface: less of it is nothing, as between two sheets
SOLID = 0.8  # share of rays that have to leave at an inside; of leaves at random at most about a half do


def is_closed(mesh: Mesh) -> bool:
    """Tells whether each edge has as many triangles that run along it as there are against it.

    Vertices at one place count as one. Each edge adds a hash of its ends where it is run along one way, and takes it
    away where the other: the sum is 0 for closed, evenly oriented meshes, and for others with a probability of 2^-64.
    """
    if len(mesh.triangles) == 0:
        return False
    total = np.uint64(0)
    with np.errstate(over="ignore"):
        corners = _hashed_places(mesh.position)[mesh.triangles.T]
        for start, end in ((0, 1), (1, 2), (2, 0)):
            a, b = corners[start], corners[end]
            edge = scrambled(np.minimum(a, b) + MULTIPLIERS[0] * np.maximum(a, b))
            upwards = a < b
            total += edge[upwards].sum(dtype=np.uint64) - edge[~upwards & (a != b)].sum(dtype=np.uint64)
    return bool(total == 0)


def _hashed_places(position: np.ndarray) -> np.ndarray:
    """(V,) uint64: equal where positions (V, 3) float32 are."""
    bits = np.ascontiguousarray(position + np.float32(0)).view(np.uint32).astype(np.uint64)  # -0 is 0
    found = scrambled(bits[:, 0])
    for column in (1, 2):
        found = scrambled(found ^ bits[:, column])
    return found


def scrambled(x: np.ndarray) -> np.ndarray:
    x = (x ^ (x >> np.uint64(30))) * MULTIPLIERS[0]
    x = (x ^ (x >> np.uint64(27))) * MULTIPLIERS[1]
    return x ^ (x >> np.uint64(31))


def is_inside_out(mesh: Mesh) -> bool:
    """Tells whether the fronts of a closed mesh look inwards: whether its volume is negative (divergence theorem)."""
    volume, area = 0.0, 0.0
    middle = mesh.position.mean(axis=0, dtype=np.float64)
    for begin in range(0, len(mesh.triangles), BLOCK):
        a, b, c = triangle_corners(mesh, slice(begin, begin + BLOCK), middle)
        across = np.cross(b - a, c - a, axis=0)
        volume += float((a * across).sum()) / 6
        area += float(np.sqrt((across**2).sum(axis=0)).sum()) / 2
    return volume < -FLAT * (area / 6) ** 1.5


def winding_number(mesh: Mesh, places: np.ndarray) -> np.ndarray:
    """Returns how often a closed mesh runs around places (P, 3) in its space, (P,) float64: 1 inside, 0 outside, -1
    inside where its fronts look inwards. Solid angles of triangles (van Oosterom and Strackee 1983)."""
    found = np.zeros(len(places))
    for begin in range(0, len(mesh.triangles), BLOCK):
        corners = triangle_corners(mesh, slice(begin, begin + BLOCK))
        for row, place in enumerate(places):
            a, b, c = corners - place[:, None]
            la, lb, lc = (np.sqrt((side**2).sum(axis=0)) for side in (a, b, c))
            volume = (a * np.cross(b, c, axis=0)).sum(axis=0)
            beside = la * lb * lc + (a * b).sum(axis=0) * lc + (b * c).sum(axis=0) * la + (c * a).sum(axis=0) * lb
            found[row] += float(np.arctan2(volume, beside).sum()) / (2 * np.pi)
    return found


def is_solid(mesh: Mesh) -> bool:
    """Tells whether a mesh bounds bodies, though it may have gaps: whether rays that go in at its outside leave at its
    inside next.

    Rays run along one direction, either way, through places that are evenly spread over what it shows in that.
    """
    corners = triangle_corners(mesh, slice(None))
    first = np.cross(ALONG, (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    second = np.cross(ALONG, first)
    u, v, w = (np.tensordot(axis, corners, (0, 1)) for axis in (first, second, ALONG))  # (3 corners, T)
    picture = _twice_area(u, v)
    total = np.cumsum(np.abs(picture))
    if not (len(total) and 0 < total[-1] < np.inf):
        return False
    count = int(np.clip(MOST_TESTS // len(total), FEWEST_RAYS, MOST_RAYS))
    rows = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1])
    low, high = (np.stack([side(u, axis=0), side(v, axis=0)]) for side in (np.min, np.max))
    leaves = 0
    for row in rows.tolist():
        at = u[:, row].mean(), v[:, row].mean()
        near = np.flatnonzero((low[0] <= at[0]) & (high[0] >= at[0]) & (low[1] <= at[1]) & (high[1] >= at[1]))
        near = near[near != row]
        own, met = picture[row], picture[near]
        shares = [_twice_area(*(np.stack([np.full(len(near), place), of[(k + 1) % 3, near], of[(k + 2) % 3, near]])
                                for place, of in zip(at, (u, v), strict=True))) for k in range(3)]  # fmt: skip
        shares = np.stack(shares) / np.where(met == 0, np.inf, met)
        inside = (shares >= 0).all(axis=0) & (met != 0)
        # Its normal looks along the direction where its picture runs to the left.
        deep = -np.sign(own) * ((shares * w[:, near]).sum(axis=0) - w[:, row].mean())
        deep = np.where(inside & (deep > 0), deep, np.inf)
        nearest = int(deep.argmin()) if len(deep) else -1
        leaves += nearest >= 0 and deep[nearest] < np.inf and np.sign(met[nearest]) == -np.sign(own)
    return leaves >= SOLID * count


def _twice_area(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(N,): of flat triangles (3, N), > 0 where they run to the left."""
    return (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])
