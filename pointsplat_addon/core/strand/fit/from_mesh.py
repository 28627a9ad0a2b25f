"""Meshes of leaves and branches as ribbons and tubes where they have that structure (Marroquim et al. 2008, section 5).

A part is what edges hold together. A tube is a part made of rings of vertices, open, closed or with a tip at its ends,
or any sleeve between two open rims whose sections are round enough. A ribbon is one of two to four triangles in a row,
or a flat one of some more, by its widths across its longest axis. Flat parts with lobes about a hub are several
ribbons. What fits none of these stays polygons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...numeric.segments import offsets, owners, ranges, starts

MOST_RINGS = 4096
FLAT = 0.02  # a section whose variances across and along are in a smaller ratio is none of a tube
AREA = 0.2  # by which a ribbon's area may differ from its triangles'
SLEEVE_AREA = 0.4  # the same for tubes, before they are widened to it
EXACT = 0.05  # and up to which they are as they are
ROUND = 0.06  # of a section's radius: how far its corners are from it in the mean; hexagons 0.05, squares 0.11
THICK = 1 / 1000  # of the mesh's longest side: sleeves of greater radii are tubes only where they are round
LEAF = 128  # triangles that a leaf has at most
LEAF_POINTS = 7  # of its ribbon
CURLED = 0.1  # a leaf's variance across its plane over that of its narrower axis, at most
FILLED = 0.5  # of a leaf's breadth, what lies between its lobes taken off, at least
BEYOND = 0.04  # of its length: how far from its ends a leaf is measured for them
LONG = 2.0  # closed tubes' deviation along their axis over that across it, at least
LEVEL = 1e-3  # of a tube's length: how far its end may be from a plane
DIRECTIONS = 128  # about a hub, in which lobes are looked for
LEVELS = np.linspace(0.3, 0.8, 11)  # of the farthest tip: distances at which lobes may stand apart
STEPS = 16  # along a lobe, to find where it is widest
PLACES = 4  # along an edge of a triangle whose area is shared out
NUDGE = 1e-6  # of a section's distance from the next, so that no cut goes through a vertex


@dataclass(frozen=True, eq=False)
class FittedStrands:
    """Strands of a mesh: P points in S strands, tubes and ribbons one after another."""

    position: np.ndarray  # (P, 3) float64
    radius: np.ndarray  # (P,) float64
    normal: np.ndarray  # (P, 3) float64, of ribbons; 0 on tubes
    start: np.ndarray  # (S + 1,) int64
    ribbon: np.ndarray  # (S,) bool
    triangle: np.ndarray  # (S,) int64: one of the strand's triangles, for its material and place
    left: np.ndarray  # (T,) bool: triangles that stay
    parts: int  # of the mesh
    stay: int  # parts that remain polygons

    def __len__(self) -> int:
        return len(self.start) - 1


def connected_parts(triangles: np.ndarray, vertices: int) -> np.ndarray:
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


def fit_strands(position: np.ndarray, triangles: np.ndarray) -> FittedStrands:
    """The strands of a mesh with vertices (V, 3) and triangles (T, 3)."""
    position, triangles = np.asarray(position, np.float64), np.asarray(triangles, np.int64)
    label = connected_parts(triangles, len(position))
    names, part = np.unique(label[triangles[:, 0]], return_inverse=True)
    open_ = ~_caps(position, triangles, part, len(names))
    tubes = _tubes(position, triangles[open_], label, names, part[open_])
    other = np.ones(len(names), bool)
    other[tubes[4]] = False
    sleeves = _sleeves(position, triangles, label, names, part, other)
    ribbons = _ribbons(position, triangles, part, len(names))
    other[np.concatenate([sleeves[4], ribbons[4]])] = False
    flat = _flat(position, triangles, part, other)
    lobes = _lobes(flat)
    blades = _blades(flat, lobes[4])
    both = [tubes, sleeves, ribbons, lobes, blades]
    count = np.concatenate([b[3] for b in both]).astype(np.int64)
    chosen = np.concatenate([b[4] for b in both])
    first = np.full(len(names), len(triangles))
    np.minimum.at(first, part, np.arange(len(triangles)))
    left = np.ones(len(names), bool)
    left[chosen] = False
    return FittedStrands(
        np.concatenate([b[0] for b in both]),
        np.concatenate([b[1] for b in both]),
        np.concatenate([b[2] for b in both]),
        offsets(count),
        np.repeat([False, False, True, True, True], [len(b[3]) for b in both]),
        first[chosen],
        left[part],
        len(names),
        int(left.sum()),
    )


Strands = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # points, radii, normals, counts, parts


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (E, 2) with their lower vertex first, how many triangles have each, and (T, 3) rows of the triangles'."""
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, row, number = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    return edges, number, row.reshape(-1, 3)


def _caps(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int) -> np.ndarray:
    """(T,) bool: triangles that close a tube: walls within it, and of long closed parts what lies in the planes of the
    two triangles that are farthest along the longest axis. Where the part is no tube this means nothing."""
    _, number, row = _edges(triangles)
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
    closed &= extent[:, 2] >= LONG**2 * extent[:, 1]
    along = axes[:, :, 2]
    height = np.einsum("tki,ti->tk", off, along[part]).mean(axis=1)
    order = np.lexsort((height, part))
    start = starts(many)
    caps = np.zeros(len(triangles), bool)
    for last in (order[start], order[start + many - 1]):
        facing = _crossed(corner[last])
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
        away = np.einsum("tki,ti->tk", corner - corner[last, 0][part][:, None], facing[part])
        caps |= (np.abs(away) <= LEVEL * np.sqrt(spread.trace(axis1=1, axis2=2) / many)[part][:, None]).all(axis=1)
    return walls | (caps & closed[part])


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
    thick: float = np.inf,
) -> Strands:
    """The tubes among parts that `fits` (C,), from the edges (n, 2, 3) of their sections; `section` (n,) numbers those
    from start (C + 1,) on. Tips (m, 3) are sections `at` (m,) of one vertex. Those with mean radii beyond `thick` must
    be ROUND."""
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
    strand = owners(np.diff(start))
    fits = fits & (np.bincount(strand[bad], minlength=count) == 0)
    if np.isfinite(thick):
        off = np.abs(np.linalg.norm(away, axis=2).mean(axis=1) - radius[section])
        of = strand[section]
        outline, uneven = np.bincount(of, length, count), np.bincount(of, length * off, count)
        mean = np.bincount(strand, radius, count) / np.maximum(np.diff(start), 1)
        fits &= (mean <= thick) | (uneven <= ROUND * mean * outline)
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
    which, cut = owners(cuts), ranges(low, cuts)
    above = value[which] - ((cut + 0.5 + NUDGE) / whole[which])[:, None]
    corner = position[triangles[rows[which]]]
    ahead = np.roll(above, -1, axis=1)
    crossed = (above < 0) != (ahead < 0)
    t = above / np.where(crossed, above - ahead, 1)
    point = corner + t[..., None] * (np.roll(corner, -1, axis=1) - corner)
    ends = np.take_along_axis(point, np.argsort(~crossed, axis=1, kind="stable")[:, :2, None], axis=1)

    # The rims are the first and the last section
    start = offsets(np.where(fits, sections + 2, 0))
    own = rim[fits[owner[rim[:, 0]]]]
    last = loop[own[:, 0]] != begin[owner[own[:, 0]]]
    at = np.where(last, start[owner[own[:, 0]] + 1] - 1, start[owner[own[:, 0]]])
    section = np.concatenate([start[part[rows[which]]] + 1 + cut, at])
    ends = np.concatenate([ends, position[own]])
    none = np.zeros(0, np.int64)
    thick = THICK * np.ptp(position, axis=0).max()
    return _round(position, triangles, part, start, ends, section, fits, np.zeros((0, 3)), none, thick)


def _connected(edges: np.ndarray, vertices: int) -> np.ndarray:
    """(V,) the lowest vertex that edges (E, 2) connect each one with."""
    return connected_parts(np.column_stack([edges, edges[:, :1]]), vertices) if len(edges) else np.arange(vertices)


def _ribbons(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, count: int) -> Strands:
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


@dataclass(frozen=True, eq=False)
class _Flat:
    """Flat parts, C of them, and the T triangles of the side of each that counts."""

    part: np.ndarray  # (C,) int64: the mesh's
    own: np.ndarray  # (T,) int64: rows of parts
    vertex: np.ndarray  # (T, 3) int64
    corner: np.ndarray  # (T, 3, 3) float64
    height: np.ndarray  # (T, 3) float64: of corners along the longest axis, from the part's middle
    sideways: np.ndarray  # (T, 3) float64: along the second one
    axes: np.ndarray  # (C, 3, 3) float64, orthonormal: the longest axis, the next, and what is across both
    middle: np.ndarray  # (C, 3) float64
    area: np.ndarray  # (C,) float64, of the projection along the third axis
    facing: np.ndarray  # (T, 3) float64, unit normals
    vertices: np.ndarray  # (C,) int64: how many the part has, those of the other side as well

    def total(self, values: np.ndarray) -> np.ndarray:
        """(C, ...) sums over each part of what its triangles (T, ...) have."""
        return _sums(self.own, values, len(self.part))

    def only(self, rows: np.ndarray) -> _Flat:
        """Those parts that `rows` (C,) bool chooses."""
        new, kept = np.cumsum(rows) - 1, rows[self.own]
        return _Flat(
            self.part[rows], new[self.own[kept]], self.vertex[kept], self.corner[kept], self.height[kept],
            self.sideways[kept], self.axes[rows], self.middle[rows], self.area[rows], self.facing[kept],
            self.vertices[rows],
        )  # fmt: skip


def _sums(own: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    columns = values.reshape(len(own), int(np.prod(values.shape[1:]))).T
    return np.stack([np.bincount(own, c, count) for c in columns], axis=1).reshape(-1, *values.shape[1:])


def _flat(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, other: np.ndarray) -> _Flat:
    """Parts of 5 to LEAF triangles among `other` (B,) that are thin. Of parts with two sides, as thin closed ones have,
    one counts."""
    count = len(other)
    many = np.bincount(part, minlength=count)
    chosen = np.flatnonzero(other & (many > 4) & (many <= LEAF))
    row = np.full(count, -1)
    row[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(row[part] >= 0)
    part_of = np.zeros(len(position), np.int64)
    part_of[triangles] = part[:, None]
    own, corner = row[part[rows]], position[triangles[rows]]
    vertices = np.bincount(row[part_of[np.unique(triangles[rows])]], minlength=len(chosen))

    area = _area(corner)
    whole = np.maximum(_sums(own, area, len(chosen)), 1e-300)
    middle = _sums(own, area[:, None] * corner.mean(axis=1), len(chosen)) / whole[:, None]
    off = corner - middle[own][:, None]
    # Of a triangle's second moments, from its corners and their mean
    spread = np.einsum("tki,tkj->tij", off, off) + 9 * np.einsum("ti,tj->tij", off.mean(axis=1), off.mean(axis=1))
    spread = _sums(own, area[:, None, None] * spread, len(chosen))
    variance, axes = np.linalg.eigh(spread / (12 * whole[:, None, None]))
    facing = _crossed(corner)
    sense = np.einsum("ti,ti->t", facing, axes[own, :, 0])
    sides = np.stack([np.bincount(own, np.maximum(s * sense, 0) / 2, len(chosen)) for s in (1, -1)])
    upper = sides[0] >= sides[1]
    counts = (sense > 0) == upper[own]
    whole, hidden = sides.max(axis=0), sides.min(axis=0)
    two_sided = hidden > AREA * whole
    thin = variance[:, 0] <= np.where(two_sided, FLAT, CURLED) * variance[:, 1]
    thin &= (variance[:, 1] > 0) & (~two_sided | (whole - hidden <= AREA * whole))
    # What is kept, renumbered
    kept = np.flatnonzero(thin)
    new = np.full(len(chosen), -1)
    new[kept] = np.arange(len(kept))
    vertex = triangles[rows]
    rows = np.flatnonzero(counts & thin[own])
    axes = np.stack([axes[:, :, 2], axes[:, :, 1], np.cross(axes[:, :, 2], axes[:, :, 1])], axis=1)
    height, sideways = (np.einsum("tki,ti->tk", off[rows], axes[own[rows], k]) for k in (0, 1))
    length = np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
    # The area along the plane falls short of that of what is curled
    whole = np.bincount(own[rows], area[rows], len(chosen))
    return _Flat(
        chosen[kept], new[own[rows]], vertex[rows], corner[rows],
        height, sideways, axes[kept], middle[kept], whole[kept], (facing / length)[rows], vertices[kept],
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Places:
    """N places all over flat parts. Coordinates are along the parts' two axes and across them, from the hubs."""

    own: np.ndarray  # (N,) int64: rows of parts
    place: np.ndarray  # (N, 3) float64
    area: np.ndarray  # (N,) float64: each one's share
    facing: np.ndarray  # (N, 3) float64, unit normals

    def at(self, rows: np.ndarray) -> _Places:
        return _Places(self.own[rows], self.place[rows], self.area[rows], self.facing[rows])


def _lobes(flat: _Flat) -> Strands:
    """Ribbons of two points for parts whose lobes stand out from a hub: one for each lobe, and one for all between
    them. They are taken where they need fewer points than the part has vertices."""
    if len(flat.part) == 0:
        return _none()
    hub = _hubs(flat)
    outline = _outlines(flat, hub)
    lobe, number = _sectors(outline)
    fits = (number > 2) & (2 * number + 2 < flat.vertices)
    fits &= np.abs((outline**2).sum(axis=1) * np.pi / DIRECTIONS - flat.area) <= AREA * flat.area
    if not fits.any():
        return _none()
    flat, hub, lobe, number = (flat.only(fits), *(a[fits] for a in (hub, lobe, number)))
    count, most = len(number), int(number.max())
    places = _spread(flat, hub)
    ends, radius, normal, beyond = _tips(places, _farthest(flat, hub, lobe, most), lobe)
    middle = _between(places.at(~beyond), count)

    # Lobe by lobe, what lies between them last
    kept = np.arange(most + 1) < number[:, None]
    kept[:, most] = True
    points, radius, normal = (
        np.concatenate([a.reshape(count, most, *a.shape[1:]), b[:, None]], axis=1)[kept]
        for a, b in zip((ends, radius, normal), middle, strict=True)
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    row = owners(number + 1)
    points[..., :2] += hub[row][:, None]
    points = flat.middle[row][:, None] + np.einsum("nki,nij->nkj", points, flat.axes[row])
    return points.reshape(-1, 3), radius.ravel(), np.repeat(normal, 2, axis=0), np.full(len(row), 2), flat.part[row]


def _spread(flat: _Flat, hub: np.ndarray) -> _Places:
    weights = _barycentric(PLACES)
    corner = np.einsum("tki,tji->tkj", flat.corner - flat.middle[flat.own][:, None], flat.axes[flat.own])
    corner[..., :2] -= hub[flat.own][:, None]
    return _Places(
        np.repeat(flat.own, len(weights)),
        np.einsum("pk,tki->tpi", weights, corner).reshape(-1, 3),
        np.repeat(_area(flat.corner) / len(weights), len(weights)),
        np.repeat(flat.facing, len(weights), axis=0),
    )


def _direction(place: np.ndarray) -> np.ndarray:
    """(...) int64: which direction places (..., 2) lie in."""
    turn = np.arctan2(place[..., 1], place[..., 0]) * DIRECTIONS / (2 * np.pi)
    return np.floor(turn).astype(np.int64) % DIRECTIONS


def _farthest(flat: _Flat, hub: np.ndarray, lobe: np.ndarray, most: int) -> np.ndarray:
    """(C most, 2) from the hub, the corner of each lobe that is farthest from it; (1, 0) of lobes that are none."""
    own = np.repeat(flat.own, 3)
    corner = np.stack([flat.height.ravel(), flat.sideways.ravel()], axis=1) - hub[own]
    group = own * most + lobe[own, _direction(corner)]
    order = np.lexsort((-np.einsum("ni,ni->n", corner, corner), group))
    first = order[np.concatenate([[True], np.diff(group[order]) > 0])]
    tip = np.tile([1.0, 0.0], (len(hub) * most, 1))
    tip[group[first]] = corner[first]
    return tip


def _tips(places: _Places, tip: np.ndarray, lobe: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of L lobes of each of C parts a triangle from where it is widest, which is where most of its area lies, to its
    tip (C L, 2): of the area that lies beyond, and beside the middle of that. Points (C L, 2, 3), half widths (C L, 2),
    normals (C L, 3) of any length, and which places (N,) bool lie beyond."""
    lobes = len(tip)
    group = places.own * (lobes // len(lobe)) + lobe[places.own, _direction(places.place)]
    reach = np.linalg.norm(tip, axis=1)
    ahead = tip / reach[:, None]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    along = np.einsum("ni,ni->n", places.place[:, :2], ahead[group])
    step = np.floor(STEPS * along / reach[group]).astype(np.int64)
    inner = (step >= 0) & (step < STEPS - 1)
    profile = np.bincount((group * STEPS + step)[inner], places.area[inner], lobes * STEPS).reshape(-1, STEPS)
    base = profile.argmax(axis=1) * reach / STEPS
    beyond = along >= base[group]

    own, along, there = group[beyond], along[beyond], places.at(beyond)
    total = np.bincount(own, there.area, lobes)
    rise, slope = _line(own, along, there.place[:, 2], there.area, lobes)
    off = np.einsum("ni,ni->n", there.place[:, :2], aside[own])
    # The middle of a triangle lies a third of the way from its base to its tip
    off = 1.5 * np.bincount(own, there.area * off, lobes) / np.maximum(total, 1e-300)
    ends = np.zeros((lobes, 2, 3))
    ends[:, 0, :2] = base[:, None] * ahead + off[:, None] * aside
    ends[:, 1, :2] = tip
    ends[:, :, 2] = rise[:, None] + slope[:, None] * np.stack([base, reach], axis=1)
    radius = np.stack([total / (reach - base), np.zeros(lobes)], axis=1)
    return ends, radius, _sums(own, there.area[:, None] * there.facing, lobes), beyond


def _between(places: _Places, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each part's places a rectangle of their area, and of their variance along their longer axis: points
    (C, 2, 3), half widths (C, 2) and normals (C, 3) of any length."""
    own, area = places.own, places.area
    whole = np.maximum(np.bincount(own, area, count), 1e-300)
    middle = _sums(own, area[:, None] * places.place, count) / whole[:, None]
    off = (places.place - middle[own])[:, :2]
    moments = _sums(own, area[:, None, None] * off[:, :, None] * off[:, None], count) / whole[:, None, None]
    variance, axes = np.linalg.eigh(moments)
    half = np.sqrt(3 * np.maximum(variance[:, 1], 1e-300))
    rise, slope = _line(own, np.einsum("ni,ni->n", off, axes[own, :, 1]), places.place[:, 2], area, count)
    to = half[:, None] * np.array([-1.0, 1.0])
    flat = middle[:, None, :2] + to[..., None] * axes[:, None, :, 1]
    ends = np.concatenate([flat, (rise[:, None] + slope[:, None] * to)[..., None]], axis=2)
    radius = np.repeat((whole / (4 * half))[:, None], 2, axis=1)
    return ends, radius, _sums(own, area[:, None] * places.facing, count)


def _hubs(flat: _Flat) -> np.ndarray:
    """(C, 2) where each part has the vertex at which most of its triangles meet, along its two axes."""
    _, index, many = np.unique(flat.vertex, return_index=True, return_counts=True)
    part = flat.own[index // 3]
    order = np.lexsort((-many, part))
    first = np.concatenate([[True], np.diff(part[order]) > 0])
    return np.stack([flat.height.ravel(), flat.sideways.ravel()], axis=1)[index[order[first]]]


def _outlines(flat: _Flat, hub: np.ndarray) -> np.ndarray:
    """(C, DIRECTIONS) how far the parts reach from their hubs (C, 2) that way; 0 where nothing is."""
    found = np.zeros((DIRECTIONS, len(hub)))
    place = np.stack([flat.height, flat.sideways], axis=2) - hub[flat.own][:, None]
    following = np.roll(place, -1, axis=1)
    for k, angle in enumerate((np.arange(DIRECTIONS) + 0.5) * 2 * np.pi / DIRECTIONS):
        c, s = np.cos(angle), np.sin(angle)
        a, b = (c * p[..., 1] - s * p[..., 0] for p in (place, following))
        crosses = (a < 0) != (b < 0)
        t = np.where(crosses, a / np.where(crosses, a - b, 1), 0)
        reached = c * place[..., 0] + s * place[..., 1]
        reached += t * (c * following[..., 0] + s * following[..., 1] - reached)
        np.maximum.at(found[k], flat.own, (reached * crosses).max(axis=1))
    return found.T.copy()


def _sectors(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lobes of outlines (C, DIRECTIONS), at the distance at which most stand apart: which one each direction
    belongs to (C, DIRECTIONS), and how many there are (C,)."""
    levels = LEVELS[:, None, None] * outline.max(axis=1)[:, None]
    above = outline > levels
    begins = above & ~np.roll(above, 1, axis=2)
    best = begins.sum(axis=2).argmax(axis=0)
    row = np.arange(len(outline))
    above, begins = above[best, row], begins[best, row]
    number = begins.sum(axis=1)
    run = (np.cumsum(begins, axis=1) - 1) % np.maximum(number, 1)[:, None]
    # Directions between two lobes belong to the nearer one
    index = np.arange(3 * DIRECTIONS)
    there = np.tile(above, 3)
    before = np.maximum.accumulate(np.where(there, index, -DIRECTIONS), axis=1)
    after = np.minimum.accumulate(np.where(there, index, 4 * DIRECTIONS)[:, ::-1], axis=1)[:, ::-1]
    middle = slice(DIRECTIONS, 2 * DIRECTIONS)
    nearer = np.where(index - before <= after - index, before, after)[:, middle] % DIRECTIONS
    return np.take_along_axis(run, nearer, axis=1), number


def _barycentric(steps: int) -> np.ndarray:
    """(steps^2, 3) barycentric coordinates of the middles of as many equal parts of a triangle."""
    i, j, upper = np.meshgrid(np.arange(steps), np.arange(steps), (0, 1), indexing="ij")
    inside = i + j + upper < steps
    a, b = ((k[inside] + (1 + upper[inside]) / 3) / steps for k in (i, j))
    return np.stack([a, b, 1 - a - b], axis=1)


def _line(
    own: np.ndarray, x: np.ndarray, y: np.ndarray, weight: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """(count,) heights at 0 and slopes of the lines that are nearest to places (N,) of each row by least squares."""
    w, wx, wy, wxx, wxy = (np.bincount(own, weight * v, count) for v in (np.ones_like(x), x, y, x * x, x * y))
    w = np.maximum(w, 1e-300)
    variance = wxx / w - (wx / w) ** 2
    slope = np.where(variance > 0, (wxy / w - wx * wy / w**2) / np.where(variance > 0, variance, 1), 0.0)
    return wy / w - slope * wx / w, slope


def _blades(flat: _Flat, taken: np.ndarray) -> Strands:
    """Ribbons of flat parts that are not `taken`: at each of LEAF_POINTS places along the longest axis as wide as what
    a plane across it cuts, through the middle of that, and widened to the part's area."""
    flat = flat.only(~np.isin(flat.part, taken))
    count = len(flat.part)
    if count == 0:
        return _none()
    own, corner, height, sideways = flat.own, flat.corner, flat.height, flat.sideways
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, own, height.min(axis=1))
    np.maximum.at(high, own, height.max(axis=1))

    points, radius, normal = (np.zeros((count, LEAF_POINTS, *more)) for more in ((3,), (), (3,)))
    filled = np.zeros((2, count))
    for k, place in enumerate(np.linspace(0, 1, LEAF_POINTS)):
        measured = np.clip(place, BEYOND, 1 - BEYOND) + NUDGE
        above = height - (low + measured * (high - low))[own][:, None]
        ahead = np.roll(above, -1, axis=1)
        crosses = (above < 0) != (ahead < 0)
        t = np.where(crosses, above / np.where(crosses, above - ahead, 1), 0)
        two = np.argsort(~crosses, axis=1, kind="stable")[:, :2]
        cut = crosses.any(axis=1)
        point, side = (
            np.take_along_axis(v + t.reshape(*t.shape, *[1] * (v.ndim - 2)) * (np.roll(v, -1, axis=1) - v),
                               two.reshape(*two.shape, *[1] * (v.ndim - 2)), axis=1)
            for v in (corner, sideways)
        )  # fmt: skip
        length = np.linalg.norm(point[:, 0] - point[:, 1], axis=1) * cut
        width = flat.total(length)
        weight = (length / np.maximum(width[own], 1e-300))[:, None]
        points[:, k] = flat.total(weight * point.mean(axis=1))
        normal[:, k] = flat.total(weight * flat.facing)
        radius[:, k] = width / 2
        # To the very ends, along the axis
        if measured - NUDGE != place:
            points[:, k] += (place - measured + NUDGE) * (high - low)[:, None] * flat.axes[:, 0]
        least, most = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(least, own[cut], side.min(axis=1)[cut])
        np.maximum.at(most, own[cut], side.max(axis=1)[cut])
        filled += np.stack([width, np.where(width > 0, most - least, 0)])
    covered = (np.linalg.norm(np.diff(points, axis=1), axis=2) * (radius[:, 1:] + radius[:, :-1])).sum(axis=1)
    whole = flat.area
    fits = (np.abs(covered - whole) <= AREA * whole) & (filled[0] >= FILLED * filled[1]) & (radius > 0).any(axis=1)
    radius *= (whole / np.maximum(covered, 1e-300))[:, None]
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-300)
    return (points[fits].reshape(-1, 3), radius[fits].ravel(), normal[fits].reshape(-1, 3),
            np.full(int(fits.sum()), LEAF_POINTS), flat.part[fits])  # fmt: skip


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
