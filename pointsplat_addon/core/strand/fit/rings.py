"""Tubes from parts that are made of rings of vertices, with open ends, caps or a tip."""

from __future__ import annotations

import numpy as np

from ...numeric.segments import offsets, owners, starts
from .graph import connected_by_edges, edge_steps, mesh_edges
from .measures import area_vectors
from .result import PartStrands, no_strands
from .tubes import tubes_from_sections

LEAST_ELONGATION = 2.0  # closed tubes' deviation along their axis over that across it, at least
CAP_FLATNESS = 1e-3  # of a tube's length: how far its end may be from a plane


def cap_triangles(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int) -> np.ndarray:
    """(T,) bool: triangles that close a tube, namely walls within it and, in long closed parts, triangles in the planes
    of the two triangles that are farthest along the longest axis. Meaningless for parts that are not tubes."""
    _, number, row = mesh_edges(triangles)
    walls = (number[row] > 2).all(axis=1)
    closed = np.ones(count, bool)
    closed[part[(number[row] == 1).any(axis=1)]] = False
    corner = position[triangles]
    many = np.bincount(part, minlength=count)
    middle = np.stack([np.bincount(part, c, count) for c in corner.mean(axis=1).T], axis=1) / many[:, None]
    off = corner - middle[part][:, None]
    spread = np.einsum("tki,tkj->tij", off, off).reshape(-1, 9)
    spread = np.stack([np.bincount(part, c, count) for c in spread.T], axis=1).reshape(-1, 3, 3)
    extent, axes = np.linalg.eigh(spread)
    closed &= extent[:, 2] >= LEAST_ELONGATION**2 * extent[:, 1]
    along = axes[:, :, 2]
    height = np.einsum("tki,ti->tk", off, along[part]).mean(axis=1)
    order = np.lexsort((height, part))
    start = starts(many)
    caps = np.zeros(len(triangles), bool)
    for last in (order[start], order[start + many - 1]):
        facing = area_vectors(corner[last])
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
        away = np.einsum("tki,ti->tk", corner - corner[last, 0][part][:, None], facing[part])
        caps |= (np.abs(away) <= CAP_FLATNESS * np.sqrt(spread.trace(axis1=1, axis2=2) / many)[part][:, None]).all(
            axis=1
        )
    return walls | (caps & closed[part])


def fit_ring_tubes(
    position: np.ndarray, triangles: np.ndarray, label: np.ndarray, names: np.ndarray, part: np.ndarray
) -> PartStrands:
    """Tubes from parts made of rings of vertices. label (V,): part of each vertex, named by `names` (C,); part (T,):
    index into them of each triangle."""
    count = len(names)
    owner = np.searchsorted(names, label)  # of vertices; those without triangles are not looked at
    used = np.zeros(len(position), bool)
    used[triangles] = True
    edges, number, _ = mesh_edges(triangles)
    rim = edges[number == 1]
    fits = np.bincount(owner[edges[number > 2, 0]], minlength=count) == 0

    # Each part begins at its loop of open edges with the lowest vertex
    loop = connected_by_edges(rim, len(position))
    on_rim = np.zeros(len(position), bool)
    on_rim[rim] = True
    begin = np.full(count, len(position))
    np.minimum.at(begin, owner[on_rim], loop[on_rim])
    fits &= begin < len(position)
    # Rings are numbered by their distance along edges
    level = edge_steps(edges, on_rim & used & (loop == begin[np.minimum(owner, count - 1)]))
    fits &= np.bincount(owner[used & (level < 0)], minlength=count) == 0
    vertex = np.flatnonzero(used & (level >= 0) & fits[np.minimum(owner, count - 1)])
    if len(vertex) == 0:
        return no_strands()
    rings = np.zeros(count, np.int64)
    np.maximum.at(rings, owner[vertex], level[vertex] + 1)
    start = offsets(rings)
    ring = start[owner[vertex]] + level[vertex]
    size = np.bincount(ring, minlength=start[-1])
    strand = owners(rings)
    last = np.arange(start[-1]) == start[strand + 1] - 1
    first = np.arange(start[-1]) == start[strand]

    # Rings are closed by as many edges as they have vertices; a tip may end them
    within = level[edges[:, 0]] == level[edges[:, 1]]
    inner = edges[within & fits[owner[edges[:, 0]]] & (level[edges[:, 0]] >= 0)]
    closing = np.bincount(start[owner[inner[:, 0]]] + level[inner[:, 0]], minlength=start[-1])
    even = ((closing == size) & (size >= 3)) | ((size == 1) & last)
    fits &= (np.bincount(strand[~even], minlength=count) == 0) & (rings >= 2)
    # Nothing but the sides: a triangle for each edge of the rings at both of its sides
    beside = np.where(first | last, 1, 2) * closing
    fits &= np.bincount(part, minlength=count) == np.bincount(strand, beside, count)

    tips = vertex[fits[owner[vertex]]]
    tips = tips[size[start[owner[tips]] + level[tips]] == 1]
    section = start[owner[inner[:, 0]]] + level[inner[:, 0]]
    at = start[owner[tips]] + level[tips]
    return tubes_from_sections(position, triangles, part, start, position[inner], section, fits, position[tips], at)
