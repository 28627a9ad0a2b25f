"""Ribbons from parts of two to four triangles in a row."""

from __future__ import annotations

import numpy as np

from ...numeric.segments import starts
from .measures import mean_normals, triangle_areas
from .result import AREA_ERROR, PartStrands, concatenate_strands, no_strands


def fit_ribbons(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int) -> PartStrands:
    """Ribbons from those of `count` parts that are two to four triangles in a row; part (T,): of each triangle."""
    number = np.bincount(part, minlength=count)
    order = np.argsort(part, kind="stable")
    first = starts(number)
    found = []
    for size, cuts in ((2, ((),)), (3, ((0,), (1,))), (4, ((1,),))):
        rows = np.flatnonzero(number == size)
        if len(rows):
            path, fits = _in_a_row(triangles[order[first[rows][:, None] + np.arange(size)]])
            rows, path = rows[fits], path[fits]
            options = [_ribbon(position, path, cut) for cut in cuts]
            area = triangle_areas(position[path]).sum(axis=1)
            off = np.stack([np.abs(o[3] - area) for o in options])
            best, good = off.argmin(axis=0), off.min(axis=0) <= AREA_ERROR * area
            for choice, (points, radius, normal, _) in enumerate(options):
                use = np.flatnonzero(good & (best == choice) & (area > 0))
                found.append(PartStrands(points[use].reshape(-1, 3), radius[use].ravel(), normal[use].reshape(-1, 3),
                                         np.full(len(use), points.shape[1]), rows[use]))  # fmt: skip
    return concatenate_strands(found) if found else no_strands()


def _in_a_row(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orders the triangles (n, k, 3) of parts such that each shares an edge with the next; (n,) bool where it can be
    done."""
    size = triangles.shape[1]
    common = (triangles[:, :, None, :, None] == triangles[:, None, :, None, :]).sum(axis=(3, 4))
    joined = (common == 2) & ~np.eye(size, dtype=bool)
    degree = joined.sum(axis=2)
    fits = (np.sort(degree, axis=1) == sorted([1, 1, *[2] * (size - 2)])).all(axis=1)
    at = degree.argmin(axis=1)
    path, row = [at], np.arange(len(triangles))
    free = np.ones((len(triangles), size), bool)
    for _ in range(size - 1):
        free[row, at] = False
        following = joined[row, at] & free
        fits &= following.any(axis=1)
        at = following.argmax(axis=1)
        path.append(at)
    return np.take_along_axis(triangles, np.stack(path, axis=1)[..., None], axis=1), fits


def _ribbon(
    position: np.ndarray, path: np.ndarray, cut: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, K, 3), half widths (n, K), normals (n, K, 3) and areas (n,) of triangles (n, k, 3) in a row.

    Two triangles are a quad between its two shorter sides' middles; of more, the edge after triangle `cut` crosses the
    ribbon, and both halves end with what they have besides it: another edge, or a tip.
    """
    if path.shape[1] == 2:
        shared = _shared_edge(path[:, 0], path[:, 1])
        a, b = (_opposite_vertex(path[:, k], shared) for k in (0, 1))
        one = np.stack([[a[:, 0], shared[:, 0]], [b[:, 0], shared[:, 1]]]).transpose(2, 0, 1)
        two = np.stack([[a[:, 0], shared[:, 1]], [b[:, 0], shared[:, 0]]]).transpose(2, 0, 1)
        lengths = [
            np.linalg.norm(position[s].mean(axis=2)[:, 0] - position[s].mean(axis=2)[:, 1], axis=1) for s in (one, two)
        ]
        ends = np.where((lengths[0] >= lengths[1])[:, None, None], one, two)
    else:
        shared = _shared_edge(path[:, cut[0]], path[:, cut[0] + 1])
        ends = [_far_end(path[:, : cut[0] + 1], shared), shared, _far_end(path[:, cut[0] + 1 :], shared)]
        ends = np.stack(ends, axis=1)
    corner = position[ends]
    points, radius = corner.mean(axis=2), np.linalg.norm(corner[:, :, 0] - corner[:, :, 1], axis=2) / 2
    normal = mean_normals(position[path])
    area = (np.linalg.norm(np.diff(points, axis=1), axis=2) * (radius[:, 1:] + radius[:, :-1])).sum(axis=1)
    return points, radius, np.repeat(normal[:, None], points.shape[1], axis=1), area


def _shared_edge(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 2) vertices that triangles (n, 3) have in common."""
    both = (a[:, :, None] == b[:, None, :]).any(axis=2)
    return np.take_along_axis(a, np.argsort(~both, axis=1, kind="stable")[:, :2], axis=1)


def _opposite_vertex(triangle: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """(n, 1) the vertex that is not of an edge (n, 2)."""
    other = ~(triangle[:, :, None] == edge[:, None, :]).any(axis=2)
    return np.take_along_axis(triangle, other.argmax(axis=1)[:, None], axis=1)


def _far_end(half: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """(n, 2) vertices of one or two triangles (n, k, 3) that are not of an edge; a tip twice."""
    corners = half.reshape(len(half), -1)
    other = ~(corners[:, :, None] == edge[:, None, :]).any(axis=2)
    lowest = np.where(other, corners, corners.max() + 1).min(axis=1)
    highest = np.where(other, corners, -1).max(axis=1)
    return np.stack([lowest, highest], axis=1)
