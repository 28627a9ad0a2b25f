"""Meshes of leaves and branches as ribbons and tubes where they have that structure (Marroquim et al. 2008, section 5).

A part is what edges hold together. A tube is a part made of rings of vertices, open at both ends or with a tip, or any
sleeve between two open rims whose sections are round enough. A ribbon is one of two to four triangles in a row, or a
flat one of some more, by its widths across its longest axis. What fits none of these stays polygons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOST_RINGS = 4096
FLAT = 0.02  # a section whose variances across and along are in a smaller ratio is none of a tube
AREA = 0.2  # by which a ribbon's area may differ from its triangles'
SLEEVE_AREA = 0.4  # the same for tubes, before they are widened to it
EXACT = 0.05  # and up to which they are as they are
LEAF = 128  # triangles that a leaf has at most
LEAF_POINTS = 7  # of its ribbon
CURLED = 0.1  # a leaf's variance across its plane over that of its narrower axis, at most
FILLED = 0.5  # of a leaf's breadth, what lies between its lobes taken off, at least
BEYOND = 0.04  # of its length: how far from its ends a leaf is measured for them
NUDGE = 1e-6  # of a section's distance from the next, so that no cut goes through a vertex


@dataclass(frozen=True, eq=False)
class Found:
    """Strands of a mesh: P points in S strands, tubes and ribbons one after another."""

    position: np.ndarray  # (P, 3) float64
    radius: np.ndarray  # (P,) float64
    normal: np.ndarray  # (P, 3) float64, of ribbons; 0 on tubes
    start: np.ndarray  # (S + 1,) int64
    ribbon: np.ndarray  # (S,) bool
    triangle: np.ndarray  # (S,) int64: one of the strand's triangles, for its material and place
    left: np.ndarray  # (T,) bool: triangles that stay
    parts: int  # of the mesh

    def __len__(self) -> int:
        return len(self.start) - 1


def parts_of(triangles: np.ndarray, vertices: int) -> np.ndarray:
    """(V,) int64: the lowest vertex that triangles (T, 3) connect each one with."""
    label = np.arange(vertices)
    while True:
        lowest = label[triangles].min(axis=1)
        following = label.copy()
        np.minimum.at(following, triangles.ravel(), np.repeat(lowest, 3))
        following = following[following]
        if np.array_equal(following, label):
            return label
        label = following


def find(position: np.ndarray, triangles: np.ndarray) -> Found:
    """The strands of a mesh with vertices (V, 3) and triangles (T, 3)."""
    position, triangles = np.asarray(position, np.float64), np.asarray(triangles, np.int64)
    label = parts_of(triangles, len(position))
    names, part = np.unique(label[triangles[:, 0]], return_inverse=True)
    tubes = _tubes(position, triangles, label, names, part)
    other = np.ones(len(names), bool)
    other[tubes[4]] = False
    sleeves = _sleeves(position, triangles, label, names, part, other)
    ribbons = _ribbons(position, triangles, part, len(names))
    other[np.concatenate([sleeves[4], ribbons[4]])] = False
    leaves = _leaves(position, triangles, part, other)
    both = [tubes, sleeves, ribbons, leaves]
    count = np.concatenate([b[3] for b in both]).astype(np.int64)
    chosen = np.concatenate([b[4] for b in both])
    first = np.full(len(names), len(triangles))
    np.minimum.at(first, part, np.arange(len(triangles)))
    left = np.ones(len(names), bool)
    left[chosen] = False
    return Found(
        np.concatenate([b[0] for b in both]),
        np.concatenate([b[1] for b in both]),
        np.concatenate([b[2] for b in both]),
        np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
        np.repeat([False, False, True, True], [len(b[3]) for b in both]),
        first[chosen],
        left[part],
        len(names),
    )


Strands = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # points, radii, normals, counts, parts


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (E, 2) with their lower vertex first, how many triangles have each, and (T, 3) rows of the triangles'."""
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, row, number = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    return edges, number, row.reshape(-1, 3)


def _tubes(
    position: np.ndarray, triangles: np.ndarray, label: np.ndarray, names: np.ndarray, part: np.ndarray
) -> Strands:
    count = len(names)
    owner = np.searchsorted(names, label)  # of vertices; those without triangles are not looked at
    used = np.zeros(len(position), bool)
    used[triangles] = True
    edges, number, _ = _edges(triangles)
    rim = edges[number == 1]
    fits = np.bincount(owner[edges[number > 2, 0]], minlength=count) == 0

    # The loop of open edges with the lowest vertex is where each part begins
    loop = _connected(rim, len(position))
    on_rim = np.zeros(len(position), bool)
    on_rim[rim] = True
    begin = np.full(count, len(position))
    np.minimum.at(begin, owner[on_rim], loop[on_rim])
    fits &= begin < len(position)
    # Rings follow by their distance along edges
    level = _levels(edges, on_rim & used & (loop == begin[np.minimum(owner, count - 1)]))
    fits &= np.bincount(owner[used & (level < 0)], minlength=count) == 0
    vertex = np.flatnonzero(used & (level >= 0) & fits[np.minimum(owner, count - 1)])
    if len(vertex) == 0:
        return _none()
    rings = np.zeros(count, np.int64)
    np.maximum.at(rings, owner[vertex], level[vertex] + 1)
    start = np.concatenate([[0], np.cumsum(rings)])
    ring = start[owner[vertex]] + level[vertex]
    size = np.bincount(ring, minlength=start[-1])
    strand = np.repeat(np.arange(count), rings)
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
    return _round(position, triangles, part, start, position[inner], section, fits, position[tips], at)


def _round(
    position: np.ndarray,
    triangles: np.ndarray,
    part: np.ndarray,
    start: np.ndarray,
    ends: np.ndarray,
    section: np.ndarray,
    fits: np.ndarray,
    tips: np.ndarray,
    at: np.ndarray,
) -> Strands:
    """The tubes among parts that `fits` (C,), from the edges (n, 2, 3) of their sections; `section` (n,) numbers those
    from start (C + 1,) on. Tips (m, 3) are sections `at` (m,) of one vertex."""
    count, total = len(fits), int(start[-1])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    around = np.bincount(section, length, total)
    middle = ends.mean(axis=1)
    center = np.stack([np.bincount(section, length * middle[:, k], total) for k in range(3)], axis=1)
    center /= np.maximum(around, 1e-300)[:, None]
    center[at] = tips
    away = ends - center[section][:, None]
    spread = [
        np.bincount(section, length * (away[..., j] * away[..., k]).sum(axis=1), total) for j, k in np.ndindex(3, 3)
    ]
    _, short, long = np.sqrt(np.maximum(np.linalg.eigvalsh(np.stack(spread, axis=1).reshape(-1, 3, 3)), 0)).T
    # The mean width of a convex outline is its length over pi (Cauchy). A slanted cut is longer than a straight one,
    # but not across
    radius = around / (2 * np.pi) * (2 * short / np.maximum(long + short, 1e-300))
    point = np.zeros(total, bool)
    point[at] = True
    bad = ~point & ((short**2 < FLAT * long**2) | (around <= 0))
    strand = np.repeat(np.arange(count), np.diff(start))
    fits = fits & (np.bincount(strand[bad], minlength=count) == 0)
    step = np.linalg.norm(np.diff(center, axis=0), axis=1) * (radius[1:] + radius[:-1])
    inside = strand[1:] == strand[:-1]
    covered = np.pi * np.bincount(strand[1:][inside], step[inside], count)
    area = np.bincount(part, _area(position[triangles]), count)
    fits &= np.abs(covered - area) <= SLEEVE_AREA * area
    off = np.abs(covered - area) > EXACT * area
    radius = radius * np.where(off & fits, area / np.where(covered > 0, covered, 1), 1)[strand]
    kept, chosen = np.flatnonzero(fits[strand]), np.flatnonzero(fits)
    return center[kept], radius[kept], np.zeros((len(kept), 3)), np.diff(start)[chosen], chosen


def _levels(edges: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(V,) steps along edges (E, 2) from the vertices that are `first` (V,); -1 where none lead."""
    level, (a, b) = np.where(first, 0, -1), edges.T
    for ring in range(1, MOST_RINGS):
        reached = np.concatenate(
            [b[(level[a] == ring - 1) & (level[b] < 0)], a[(level[b] == ring - 1) & (level[a] < 0)]]
        )
        if len(reached) == 0:
            break
        level[reached] = ring
    return level


def _ways(position: np.ndarray, edges: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(V,) lengths of the shortest ways along edges from the vertices that are `first`; 0 where none lead."""
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


def _sleeves(
    position: np.ndarray,
    triangles: np.ndarray,
    label: np.ndarray,
    names: np.ndarray,
    part: np.ndarray,
    other: np.ndarray,
) -> Strands:
    """Tubes from parts with two rims, cut where the share of the way from one to the other is the same."""
    count = len(names)
    owner = np.minimum(np.searchsorted(names, label), count - 1)
    used = np.zeros(len(position), bool)
    used[triangles] = True
    edges, number, _ = _edges(triangles)
    rim = edges[number == 1]
    loop = _connected(rim, len(position))
    on_rim = np.zeros(len(position), bool)
    on_rim[rim] = True
    loops = np.unique(loop[on_rim])
    # A sphere with two holes: its characteristic is 0
    euler = np.bincount(owner[used], minlength=count) - np.bincount(owner[edges[:, 0]], minlength=count)
    euler += np.bincount(part, minlength=count)
    fits = other & (euler == 0) & (np.bincount(owner[loops], minlength=count) == 2)
    fits &= np.bincount(owner[edges[number > 2, 0]], minlength=count) == 0
    if not fits.any():
        return _none()
    begin = np.full(count, len(position))
    np.minimum.at(begin, owner[loops], loops)
    here = on_rim & fits[owner]
    near, far = (_ways(position, edges, here & ((loop == begin[owner]) == one)) for one in (True, False))
    whole = near + far
    share = np.where(fits[owner] & used & (whole > 0), near / np.where(whole > 0, whole, 1), 0.0)
    level = _levels(edges, here & (loop == begin[owner]))
    sections = np.zeros(count, np.int64)
    np.maximum.at(sections, owner[used], level[used])

    # Each triangle is cut by the sections between its least and its greatest share
    rows = np.flatnonzero(fits[part])
    value, whole = share[triangles[rows]], sections[part[rows]]
    low = np.ceil(value.min(axis=1) * whole - 0.5 - NUDGE).astype(np.int64)
    high = np.floor(value.max(axis=1) * whole - 0.5 - NUDGE).astype(np.int64)
    cuts = np.maximum(high - low + 1, 0)
    which = np.repeat(np.arange(len(rows)), cuts)
    cut = low[which] + np.arange(len(which)) - (np.cumsum(cuts) - cuts)[which]
    above = value[which] - ((cut + 0.5 + NUDGE) / whole[which])[:, None]
    corner = position[triangles[rows[which]]]
    ahead = np.roll(above, -1, axis=1)
    crossed = (above < 0) != (ahead < 0)
    t = above / np.where(crossed, above - ahead, 1)
    point = corner + t[..., None] * (np.roll(corner, -1, axis=1) - corner)
    ends = np.take_along_axis(point, np.argsort(~crossed, axis=1, kind="stable")[:, :2, None], axis=1)

    # The rims are the first and the last section
    start = np.concatenate([[0], np.cumsum(np.where(fits, sections + 2, 0))])
    own = rim[fits[owner[rim[:, 0]]]]
    last = loop[own[:, 0]] != begin[owner[own[:, 0]]]
    at = np.where(last, start[owner[own[:, 0]] + 1] - 1, start[owner[own[:, 0]]])
    section = np.concatenate([start[part[rows[which]]] + 1 + cut, at])
    ends = np.concatenate([ends, position[own]])
    none = np.zeros(0, np.int64)
    return _round(position, triangles, part, start, ends, section, fits, np.zeros((0, 3)), none)


def _connected(edges: np.ndarray, vertices: int) -> np.ndarray:
    """(V,) the lowest vertex that edges (E, 2) connect each one with."""
    return parts_of(np.column_stack([edges, edges[:, :1]]), vertices) if len(edges) else np.arange(vertices)


def _ribbons(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int) -> Strands:
    number = np.bincount(part, minlength=count)
    order = np.argsort(part, kind="stable")
    first = np.cumsum(number) - number
    found = []
    for size, cuts in ((2, ((),)), (3, ((0,), (1,))), (4, ((1,),))):
        rows = np.flatnonzero(number == size)
        if len(rows):
            path, fits = _in_a_row(triangles[order[first[rows][:, None] + np.arange(size)]])
            rows, path = rows[fits], path[fits]
            options = [_ribbon(position, path, cut) for cut in cuts]
            area = _area(position[path]).sum(axis=1)
            off = np.stack([np.abs(o[3] - area) for o in options])
            best, good = off.argmin(axis=0), off.min(axis=0) <= AREA * area
            for choice, (points, radius, normal, _) in enumerate(options):
                use = np.flatnonzero(good & (best == choice) & (area > 0))
                found.append((points[use].reshape(-1, 3), radius[use].ravel(), normal[use].reshape(-1, 3),
                              np.full(len(use), points.shape[1]), rows[use]))  # fmt: skip
    if not found:
        return _none()
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))  # pyright: ignore[reportReturnType]


def _leaves(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, other: np.ndarray) -> Strands:
    """Ribbons of flat parts among `other` (B,): at each of LEAF_POINTS places along the longest axis as wide as what a
    plane across it cuts, through the middle of that, and widened to the part's area. Of parts with two sides, as thin
    closed ones have, one counts."""
    count = len(other)
    many = np.bincount(part, minlength=count)
    fits = other & (many > 4) & (many <= LEAF)
    chosen = np.flatnonzero(fits)
    if len(chosen) == 0:
        return _none()
    row = np.full(count, -1)
    row[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(fits[part])
    own, corner = row[part[rows]], position[triangles[rows]]

    def total(values: np.ndarray) -> np.ndarray:
        columns = values.reshape(len(own), -1).T
        return np.stack([np.bincount(own, c, len(chosen)) for c in columns], axis=1).reshape(-1, *values.shape[1:])

    area = _area(corner)
    whole = np.maximum(total(area), 1e-300)
    middle = total(area[:, None] * corner.mean(axis=1)) / whole[:, None]
    off = corner - middle[own][:, None]
    # Of a triangle's second moments, from its corners and their mean
    spread = np.einsum("tki,tkj->tij", off, off) + 9 * np.einsum("ti,tj->tij", off.mean(axis=1), off.mean(axis=1))
    variance, axes = np.linalg.eigh(total(area[:, None, None] * spread) / (12 * whole[:, None, None]))
    facing = _crossed(corner)
    sense = np.einsum("ti,ti->t", facing, axes[own, :, 0])
    sides = np.stack([np.bincount(own, np.maximum(s * sense, 0) / 2, len(chosen)) for s in (1, -1)])
    upper = sides[0] >= sides[1]
    used = (sense > 0) == upper[own]
    whole, hidden = sides.max(axis=0), sides.min(axis=0)
    two_sided = hidden > AREA * whole
    flat = variance[:, 0] <= np.where(two_sided, FLAT, CURLED) * variance[:, 1]
    flat &= (variance[:, 1] > 0) & (~two_sided | (whole - hidden <= AREA * whole))
    # The area along the plane falls short of that of what is curled
    whole = np.bincount(own, area * used, len(chosen))
    along, beside = axes[:, :, 2], axes[:, :, 1]
    height = np.einsum("tki,ti->tk", off, along[own])
    sideways = np.einsum("tki,ti->tk", off, beside[own])
    low, high = np.full(len(chosen), np.inf), np.full(len(chosen), -np.inf)
    np.minimum.at(low, own, height.min(axis=1))
    np.maximum.at(high, own, height.max(axis=1))

    points, radius, normal = (np.zeros((len(chosen), LEAF_POINTS, *more)) for more in ((3,), (), (3,)))
    filled = np.zeros((2, len(chosen)))
    for k, place in enumerate(np.linspace(0, 1, LEAF_POINTS)):
        measured = np.clip(place, BEYOND, 1 - BEYOND) + NUDGE
        above = height - (low + measured * (high - low))[own][:, None]
        ahead = np.roll(above, -1, axis=1)
        crosses = (above < 0) != (ahead < 0)
        t = np.where(crosses, above / np.where(crosses, above - ahead, 1), 0)
        two = np.argsort(~crosses, axis=1, kind="stable")[:, :2]
        cut = crosses.any(axis=1) & used
        point, side = (
            np.take_along_axis(v + t.reshape(*t.shape, *[1] * (v.ndim - 2)) * (np.roll(v, -1, axis=1) - v),
                               two.reshape(*two.shape, *[1] * (v.ndim - 2)), axis=1)
            for v in (corner, sideways)
        )  # fmt: skip
        length = np.linalg.norm(point[:, 0] - point[:, 1], axis=1) * cut
        width = total(length)
        weight = (length / np.maximum(width[own], 1e-300))[:, None]
        points[:, k] = total(weight * point.mean(axis=1))
        normal[:, k] = total(weight * facing / np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300))
        radius[:, k] = width / 2
        # To the very ends, along the axis
        if measured - NUDGE != place:
            points[:, k] += (place - measured + NUDGE) * (high - low)[:, None] * along
        least, most = np.full(len(chosen), np.inf), np.full(len(chosen), -np.inf)
        np.minimum.at(least, own[cut], side.min(axis=1)[cut])
        np.maximum.at(most, own[cut], side.max(axis=1)[cut])
        filled += np.stack([width, np.where(width > 0, most - least, 0)])
    covered = (np.linalg.norm(np.diff(points, axis=1), axis=2) * (radius[:, 1:] + radius[:, :-1])).sum(axis=1)
    flat &= (np.abs(covered - whole) <= AREA * whole) & (filled[0] >= FILLED * filled[1]) & (radius > 0).any(axis=1)
    radius *= (whole / np.maximum(covered, 1e-300))[:, None]
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-300)
    return (points[flat].reshape(-1, 3), radius[flat].ravel(), normal[flat].reshape(-1, 3),
            np.full(int(flat.sum()), LEAF_POINTS), chosen[flat])  # fmt: skip


def _in_a_row(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (n, k, 3) of parts in the order in which each shares an edge with the next, and whether they do so."""
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
        shared = _shared(path[:, 0], path[:, 1])
        a, b = (_besides(path[:, k], shared) for k in (0, 1))
        one = np.stack([[a[:, 0], shared[:, 0]], [b[:, 0], shared[:, 1]]]).transpose(2, 0, 1)
        two = np.stack([[a[:, 0], shared[:, 1]], [b[:, 0], shared[:, 0]]]).transpose(2, 0, 1)
        lengths = [
            np.linalg.norm(position[s].mean(axis=2)[:, 0] - position[s].mean(axis=2)[:, 1], axis=1) for s in (one, two)
        ]
        ends = np.where((lengths[0] >= lengths[1])[:, None, None], one, two)
    else:
        shared = _shared(path[:, cut[0]], path[:, cut[0] + 1])
        ends = [_beyond(path[:, : cut[0] + 1], shared), shared, _beyond(path[:, cut[0] + 1 :], shared)]
        ends = np.stack(ends, axis=1)
    corner = position[ends]
    points, radius = corner.mean(axis=2), np.linalg.norm(corner[:, :, 0] - corner[:, :, 1], axis=2) / 2
    normal = _normals(position[path])
    area = (np.linalg.norm(np.diff(points, axis=1), axis=2) * (radius[:, 1:] + radius[:, :-1])).sum(axis=1)
    return points, radius, np.repeat(normal[:, None], points.shape[1], axis=1), area


def _shared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 2) vertices that triangles (n, 3) have in common."""
    both = (a[:, :, None] == b[:, None, :]).any(axis=2)
    return np.take_along_axis(a, np.argsort(~both, axis=1, kind="stable")[:, :2], axis=1)


def _besides(triangle: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """(n, 1) the vertex that is not of an edge (n, 2)."""
    other = ~(triangle[:, :, None] == edge[:, None, :]).any(axis=2)
    return np.take_along_axis(triangle, other.argmax(axis=1)[:, None], axis=1)


def _beyond(half: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """(n, 2) vertices of one or two triangles (n, k, 3) that are not of an edge; a tip twice."""
    corners = half.reshape(len(half), -1)
    other = ~(corners[:, :, None] == edge[:, None, :]).any(axis=2)
    lowest = np.where(other, corners, corners.max() + 1).min(axis=1)
    highest = np.where(other, corners, -1).max(axis=1)
    return np.stack([lowest, highest], axis=1)


def _area(corners: np.ndarray) -> np.ndarray:
    """(...) areas of triangles (..., 3, 3)."""
    return 0.5 * np.linalg.norm(_crossed(corners), axis=-1)


def _crossed(corners: np.ndarray) -> np.ndarray:
    return np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])


def _normals(corners: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals of triangles (n, k, 3, 3) together, by their areas."""
    total = _crossed(corners).sum(axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), [0.0, 0, 1])


def _none() -> Strands:
    empty = np.zeros(0, np.int64)
    return np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), empty, empty
