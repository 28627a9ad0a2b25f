"""A mesh as a graph: edges, connected parts, and distances along edges."""

from __future__ import annotations

import numpy as np

MOST_RINGS = 4096


def connected_parts(triangles: np.ndarray, vertices: int) -> np.ndarray:
    """(V,) int64: for each vertex, the lowest vertex of the part that triangles (T, 3) connect it to."""
    label = np.arange(vertices)
    while True:
        lowest = label[triangles].min(axis=1)
        following = label.copy()
        np.minimum.at(following, triangles.ravel(), np.repeat(lowest, 3))
        following = following[following]
        if np.array_equal(following, label):
            return label
        label = following


def mesh_edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (E, 2), lower vertex first; (E,) the number of triangles at each; (T, 3) the edges of each triangle."""
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, row, number = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    return edges, number, row.reshape(-1, 3)


def edge_steps(edges: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(V,) int64: fewest steps along edges (E, 2) from the vertices `first` (V,) bool; -1 for unreachable ones."""
    level, (a, b) = np.where(first, 0, -1), edges.T
    for ring in range(1, MOST_RINGS):
        reached = np.concatenate(
            [b[(level[a] == ring - 1) & (level[b] < 0)], a[(level[b] == ring - 1) & (level[a] < 0)]]
        )
        if len(reached) == 0:
            break
        level[reached] = ring
    return level


def path_lengths(position: np.ndarray, edges: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(V,) float64: lengths of the shortest paths along edges (E, 2) from the vertices `first` (V,) bool; 0 for
    unreachable ones."""
    length = np.linalg.norm(position[edges[:, 0]] - position[edges[:, 1]], axis=1)
    way = np.where(first, 0.0, np.inf)
    for _ in range(MOST_RINGS):
        shorter = way.copy()
        np.minimum.at(shorter, edges[:, 1], way[edges[:, 0]] + length)
        np.minimum.at(shorter, edges[:, 0], way[edges[:, 1]] + length)
        if np.array_equal(shorter, way):
            break
        way = shorter
    return np.where(np.isfinite(way), way, 0.0)


def connected_by_edges(edges: np.ndarray, vertices: int) -> np.ndarray:
    """(V,) int64: for each vertex, the lowest vertex that edges (E, 2) connect it to."""
    return connected_parts(np.column_stack([edges, edges[:, :1]]), vertices) if len(edges) else np.arange(vertices)
