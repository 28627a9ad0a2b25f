"""Blender's curves as polylines: Catmull-Rom, poly, Bezier and NURBS curves at the points that Blender evaluates.

Control points stay where they are in memory; what each evaluated point takes of them is a few indices and weights, with
which positions, radii and attributes are interpolated alike. Cyclic curves end with the point that they begin with.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..numeric.segments import offsets, owners, ranges, ranks, starts

CATMULL_ROM, POLY, BEZIER, NURBS = range(4)  # Blender's numbers for kinds of curves
MINIMUM_TWIST, Z_UP, FREE = range(3)  # and for normals
AUTO = 0  # as a resolution of Catmull-Rom curves: as many steps as the radius asks for
MOST_STEPS = 12  # that AUTO takes in a segment, Blender's default resolution
CHORD = 0.25  # how far AUTO lets a chord lie from its curve, in radii
SAG = 0.01  # the same in lengths of the segment: what is thick has no corners either
UPRIGHT = 1e-4  # tangents whose |x| + |y| is below this are vertical (Blender's number)


@dataclass(frozen=True, eq=False)
class Curves:
    """C curves of P control points, one curve after another, none of them empty.

    What is None is not needed by the kinds in use. Knots follow Blender's modes: 0 uniform, 1 endpoint, 2 Bezier,
    3 both. Orders and numbers of points that fit no knots make a curve the polyline of its control points, as in
    Blender.
    """

    position: np.ndarray  # (P, 3)
    start: np.ndarray  # (C + 1,) int64: the points of curve c are start[c] .. start[c + 1] - 1
    kind: np.ndarray  # (C,) uint8: CATMULL_ROM, POLY, BEZIER or NURBS
    cyclic: np.ndarray  # (C,) bool
    resolution: np.ndarray  # (C,) int: evaluated points in a segment or span; AUTO
    radius: np.ndarray | None = None  # (P,): what AUTO measures by
    handle_left: np.ndarray | None = None  # (P, 3)
    handle_right: np.ndarray | None = None  # (P, 3)
    vector_left: np.ndarray | None = None  # (P,) bool: handles of type VECTOR, between which a segment is straight
    vector_right: np.ndarray | None = None  # (P,) bool
    order: np.ndarray | None = None  # (C,) int
    knots: np.ndarray | None = None  # (C,) int, modes
    weight: np.ndarray | None = None  # (P,)

    @cached_property
    def count(self) -> np.ndarray:
        """(C,) int64 control points of each curve."""
        return np.diff(self.start)


@dataclass(frozen=True, eq=False)
class Evaluated:
    """E points on C curves."""

    start: np.ndarray  # (C + 1,) int64
    position: np.ndarray  # (E, 3) float64
    parts: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]  # rows (e,), control points (e, K), weights (e, K)
    rows: np.ndarray | None  # (E,) int64: which of the points before closing each one is; None: itself
    open: np.ndarray  # (C + 1,) int64: `start` before closing

    def __len__(self) -> int:
        return int(self.start[-1])

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """(E, ...) float64 of an attribute (P, ...) of the control points, as Blender interpolates it."""
        values = np.asarray(values)
        out = np.empty((int(self.open[-1]), *values.shape[1:]))
        for rows, index, weight in self.parts:
            found = values[index[:, 0]] * _like(weight[:, 0], values)
            for column in range(1, index.shape[1]):
                found += values[index[:, column]] * _like(weight[:, column], values)
            out[rows] = found
        return out if self.rows is None else out[self.rows]

    @cached_property
    def curve(self) -> np.ndarray:
        """(E,) int64 curve of each point."""
        return owners(np.diff(self.start))


def _like(weight: np.ndarray, values: np.ndarray) -> np.ndarray:
    return weight.reshape(-1, *[1] * (values.ndim - 1))


def evaluate(curves: Curves) -> Evaluated:
    """The points of curves (Blender 5.2's numbers; 4.5 spaces those of NURBS curves otherwise, on the same curve)."""
    count, start = curves.count, np.asarray(curves.start, np.int64)
    spans = _Spans(curves)
    kind = np.where(spans.fits | (curves.kind != NURBS), curves.kind, POLY)
    owner = owners(count)
    inside = np.arange(start[-1]) - start[owner]

    # How many points each control point gives, the last one of an open curve itself alone
    steps = np.where(kind == POLY, 1, np.maximum(curves.resolution, 1))[owner]
    last = inside == count[owner] - 1
    following = np.where(last, start[owner], np.arange(start[-1]) + 1)
    if (automatic := (kind == CATMULL_ROM) & (curves.resolution == AUTO)).any():
        steps = np.where(automatic[owner], _steps(curves, owner, inside, following), steps)
    if curves.vector_left is not None and curves.vector_right is not None:
        straight = curves.vector_right & curves.vector_left[following]
        steps = np.where(straight & (kind == BEZIER)[owner], 1, steps)
    steps[last & ~(curves.cyclic & (count > 1))[owner]] = 1
    steps[spans.fits[owner]] = 0
    total = np.add.reduceat(steps, start[:-1]) if len(count) else np.zeros(0, np.int64)
    total = np.where(spans.fits, spans.total, total)
    opened = offsets(total)

    # Points of segments: where they lie between their control points
    point, along, before = owners(steps), ranks(steps), starts(steps)
    t = along / steps[point]
    rows = opened[owner[point]] + (before - before[start[owner]])[point] + along
    parts = []
    linear = kind[owner[point]] != CATMULL_ROM
    part = np.flatnonzero(linear)
    whole = not t[part].any()
    index = np.stack([point[part], following[point[part]]], axis=1)
    weight = np.stack([1 - t[part], t[part]], axis=1)
    parts.append((rows[part], index[:, :1], weight[:, :1]) if whole else (rows[part], index, weight))
    part = np.flatnonzero(~linear)
    parts.append((rows[part], *_catmull_rom(point[part], t[part], start, owner, inside, following, curves.cyclic)))
    parts += spans.parts(opened)

    # The same for all curves: their ends
    repeated = None
    start_closed = opened
    if (closed := curves.cyclic & (total > 1)).any():
        start_closed = opened + offsets(closed)
        repeated = ranges(opened[:-1], np.diff(start_closed))
        repeated[start_closed[1:][closed] - 1] = opened[:-1][closed]
    result = Evaluated(start_closed, np.empty(0), tuple(p for p in parts if len(p[0])), repeated, opened)
    position = _positions(result, curves, kind, owner, point, following, rows, t)
    return Evaluated(start_closed, position, result.parts, repeated, opened)


def _positions(
    found: Evaluated,
    curves: Curves,
    kind: np.ndarray,
    owner: np.ndarray,
    point: np.ndarray,
    following: np.ndarray,
    rows: np.ndarray,
    t: np.ndarray,
) -> np.ndarray:
    """(E, 3) float64: interpolated, those of Bezier curves by their handles."""
    position = found.interpolate(np.asarray(curves.position, np.float64))
    bent = np.flatnonzero((kind == BEZIER)[owner[point]] & (t > 0))
    if len(bent) == 0 or curves.handle_left is None or curves.handle_right is None:
        return position
    p, q, u = point[bent], following[point[bent]], t[bent, None]
    a, b = np.asarray(curves.position, np.float64)[p], np.asarray(curves.handle_right, np.float64)[p]
    c, d = np.asarray(curves.handle_left, np.float64)[q], np.asarray(curves.position, np.float64)[q]
    value = (1 - u) ** 3 * a + 3 * u * (1 - u) ** 2 * b + 3 * u**2 * (1 - u) * c + u**3 * d
    # Closing repeats first points only, which are control points
    target = rows[bent]
    if found.rows is not None:
        target = target + (found.start - found.open)[owner[p]]
    position[target] = value
    return position


def _catmull_rom(
    point: np.ndarray,
    t: np.ndarray,
    start: np.ndarray,
    owner: np.ndarray,
    inside: np.ndarray,
    following: np.ndarray,
    cyclic: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Control points (e, 4) and weights (e, 4)."""
    index = np.stack(_neighbours(point, start, owner, inside, following, cyclic), axis=1)
    s = 1 - t
    weight = 0.5 * np.stack(
        [-t * s * s, 2 + t * t * (3 * t - 5), 2 + s * s * (3 * s - 5), -s * t * t],
        axis=1,
    )
    return index, weight


def _neighbours(
    point: np.ndarray,
    start: np.ndarray,
    owner: np.ndarray,
    inside: np.ndarray,
    following: np.ndarray,
    cyclic: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The four control points of the segments that begin at `point`; ends of open curves count twice, and so do both
    points of a cyclic curve of two."""
    curve = owner[point]
    end = start[curve + 1] - 1
    around = cyclic[curve] & (start[curve + 1] - start[curve] > 2)
    previous = np.where(inside[point] > 0, point - 1, np.where(around, end, point))
    two = cyclic[curve] & (start[curve + 1] - start[curve] == 2)
    previous = np.where(two, point, previous)
    after = np.where((point == end) & ~cyclic[curve], end, following[point])
    beyond = np.where((after == end) & ~around, after, following[after])
    beyond = np.where(two, after, beyond)
    return previous, point, after, beyond


def _steps(curves: Curves, owner: np.ndarray, inside: np.ndarray, following: np.ndarray) -> np.ndarray:
    """(P,) steps of each segment whose chords lie within CHORD radii of the curve, and within SAG of its length: they
    are off by |p''| / 8 n^2 at most."""
    every = np.arange(len(owner))
    a, b, c, d = _neighbours(every, curves.start, owner, inside, following, curves.cyclic)
    p = np.asarray(curves.position, np.float64)
    across = p[c] - p[b]
    chord = _unit(across)
    # Only what leads away from the chord; along it points merely lie unevenly
    bends = (2 * p[a] - 5 * p[b] + 4 * p[c] - p[d], -p[a] + 4 * p[b] - 5 * p[c] + 2 * p[d])
    first, second = (np.linalg.norm(v - np.einsum("ij,ij->i", v, chord)[:, None] * chord, axis=1) for v in bends)
    radius = np.zeros(len(p)) if curves.radius is None else np.maximum(curves.radius[b], curves.radius[c])
    bend = np.maximum(first, second) / 8
    allowed = np.minimum(CHORD * radius, SAG * np.linalg.norm(across, axis=1))
    with np.errstate(all="ignore"):
        found = np.ceil(np.sqrt(bend / allowed) - 1e-6)
    return np.clip(np.nan_to_num(found, nan=1, posinf=MOST_STEPS), 1, MOST_STEPS).astype(np.int64)


class _Spans:
    """Knots of the NURBS curves among C curves, all in one array."""

    def __init__(self, curves: Curves) -> None:
        none = np.zeros(len(curves.count), np.int64)
        self.curves, count = curves, curves.count
        self.order = order = none + 4 if curves.order is None else np.asarray(curves.order, np.int64)
        mode = none if curves.knots is None else np.asarray(curves.knots, np.int64)
        bezier, ends = (mode == 2) | (mode == 3), (mode == 1) | (mode == 3)
        fits = (curves.kind == NURBS) & (count >= order) & (order > 1)
        fits &= ~((mode == 2) & (count <= order))
        fits &= ~(bezier & curves.cyclic & (count % np.maximum(order - 1, 1) != 0))
        self.fits, self.total = fits, none
        self.row = row = np.flatnonzero(fits)
        if len(row) == 0:
            return

        # Blender's knots: `head` equal ones, then each `inner` times, then a tail that repeats the head's steps
        order, count, cyclic, ends, bezier = order[row], count[row], curves.cyclic[row], ends[row], bezier[row]
        self.last = count + np.where(cyclic, order - 1, 0)  # control points, those that come again included
        size = self.last + order
        inner = np.where(bezier, order - 1, 1)
        head = np.where(ends, order - cyclic, np.where(bezier, np.minimum(2, inner), 1))
        tail = np.where(cyclic, 2 * order - 1, np.where(ends, order, 0))
        offset = (ends & cyclic).astype(np.int64)
        self.first = offsets(size)
        owner, at = owners(size), ranks(size)

        def body(i: np.ndarray) -> np.ndarray:
            j = i - offset[owner]
            grown = np.where(j < head[owner], 0, 1 + (j - head[owner]) // inner[owner])
            return np.where(j < 0, 0, offset[owner] + grown)

        length = size - tail
        passed = length - offset
        turn = (offset + np.where(passed < head, 0, 1 + (passed - head) // inner))[owner]
        beyond = at - length[owner]
        again = beyond - length[owner]
        repeated = np.where(again >= 0, turn + body(again), body(beyond))
        self.knots = np.where(beyond < 0, body(at), turn + repeated).astype(np.float64)

        # Spans that are not empty, between the degree-th knot and the one after the last control point
        following = np.minimum(np.arange(len(at)) + 1, len(at) - 1)
        used = (at >= (order - 1)[owner]) & (at < self.last[owner]) & (self.knots[following] > self.knots)
        self.span, self.owner = np.flatnonzero(used), owner[used]
        number = np.bincount(self.owner, minlength=len(row))
        self.number = number
        self.resolution = np.maximum(curves.resolution[row], 1)
        self.total = none.copy()
        self.total[row] = number * self.resolution + ~cyclic

    def parts(self, opened: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """For each order in use: rows, control points and weights of its evaluated points."""
        if len(self.row) == 0:
            return []
        total, first_span = self.total[self.row], starts(self.number)
        owner, along = owners(total), ranks(total)
        number = np.minimum(along // self.resolution[owner], self.number[owner] - 1)
        span = self.span[first_span[owner] + number]
        share = (along - number * self.resolution[owner]) / self.resolution[owner]
        u = self.knots[span] + share * (self.knots[span + 1] - self.knots[span])
        rows = opened[self.row[owner]] + along
        found = []
        for order in np.unique(self.order[self.row]):
            part = np.flatnonzero(self.order[self.row[owner]] == order)
            found.append((rows[part], *self._basis(int(order) - 1, owner[part], span[part], u[part])))
        return found

    def _basis(self, degree: int, owner: np.ndarray, span: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The basis functions that do not vanish in a span and their points (Piegl and Tiller 1997, algorithm A2.2)."""
        basis = np.zeros((len(u), degree + 1))
        basis[:, 0] = 1
        left = [u - self.knots[span + 1 - j] for j in range(1, degree + 1)]
        right = [self.knots[span + j] - u for j in range(1, degree + 1)]
        for j in range(1, degree + 1):
            saved = np.zeros(len(u))
            for r in range(j):
                share = basis[:, r] / (right[r] + left[j - r - 1])
                basis[:, r] = saved + right[r] * share
                saved = left[j - r - 1] * share
            basis[:, j] = saved
        curve = self.row[owner]
        inside = (span - self.first[owner])[:, None] + np.arange(-degree, 1)
        index = self.curves.start[curve][:, None] + inside % self.curves.count[curve][:, None]
        if self.curves.weight is not None:
            basis *= self.curves.weight[index]
            basis /= basis.sum(axis=1, keepdims=True)
        return index, basis


# Normals


def normals(
    evaluated: Evaluated,
    cyclic: np.ndarray,
    mode: np.ndarray,
    tilt: np.ndarray | None = None,
    free: np.ndarray | None = None,
) -> np.ndarray:
    """(E, 3) float64 unit normals as Blender has them.

    cyclic, mode (C,): MINIMUM_TWIST, Z_UP or FREE. tilt (E,): angles in radians by which they are turned around the
    tangents. free (E, 3): the normals of curves whose mode is FREE; without any they have minimum
    twist.
    """
    chosen = slice(None) if evaluated.rows is None else _unrepeated(evaluated)
    position, start = evaluated.position[chosen], evaluated.open
    owner = owners(np.diff(start))
    along = tangents(position, start, cyclic)
    flat = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
    upright = np.abs(along[:, :2]).sum(axis=1) < UPRIGHT
    flat[upright] = [1, 0, 0]
    result = _unit(flat)
    least = (mode == MINIMUM_TWIST) | ((mode == FREE) & (free is None))
    if least.any():
        result = np.where(least[owner, None], _minimum_twist(result, along, start, owner, cyclic), result)
    if free is not None:
        given = _unit(np.asarray(free, np.float64)[chosen])
        result = np.where(((mode == FREE)[owner] & given.any(axis=1))[:, None], given, result)
    if tilt is not None:
        result = _turned(result, along, np.asarray(tilt, np.float64)[chosen])
    return result if evaluated.rows is None else result[evaluated.rows]


def _unrepeated(evaluated: Evaluated) -> np.ndarray:
    """The rows of all points but those that close a curve."""
    return ranges(evaluated.start[:-1], np.diff(evaluated.open))


def tangents(position: np.ndarray, start: np.ndarray, cyclic: np.ndarray) -> np.ndarray:
    """(E, 3) float64 unit tangents: bisectors of the two segments that meet at a point.

    Points that coincide with both neighbours have the tangent before them, or the first that there is. cyclic (C,): the
    last point's next is the first. Curves of one place alone have +Z.
    """
    count = len(position)
    if count == 0:
        return np.empty((0, 3))
    owner = owners(np.diff(start))
    every = np.arange(count)
    first, last = start[:-1][owner], start[1:][owner] - 1
    following = np.where(every < last, every + 1, np.where(cyclic[owner], first, every))
    ahead = _unit(np.asarray(position, np.float64)[following] - position)
    behind = np.zeros_like(ahead)
    moved = following != every
    behind[following[moved]] = ahead[moved]
    # A place that coincides with one neighbour takes the other's direction
    missing = ~ahead.any(axis=1)
    alone = ~behind.any(axis=1)
    both = _unit(np.where(missing[:, None], behind, ahead) + np.where(alone[:, None], ahead, behind))
    valid = both.any(axis=1)
    known = np.maximum.accumulate(np.where(valid, every, -1))
    known = np.where(known < first, -1, known)
    earliest = np.full(len(start) - 1, count)
    np.minimum.at(earliest, owner[valid], every[valid])
    known = np.where(known < 0, earliest[owner], known)
    filled = np.concatenate([both, [[0.0, 0.0, 1.0]]])
    return filled[np.minimum(known, count)]


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised rows; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors, float), where=length > 0)


def _minimum_twist(
    normal: np.ndarray, along: np.ndarray, start: np.ndarray, owner: np.ndarray, cyclic: np.ndarray
) -> np.ndarray:
    """The first normal of each curve carried on by the rotations from tangent to tangent; cyclic curves spread what is
    left when they come round over all their points."""
    every = np.arange(len(along))
    first = start[:-1][owner]
    before = np.where(every > first, every - 1, every)
    turn = _between(along[before], along)
    # Rotations from the first point on, as products over 2, 4, 8 ... points
    inside, step = every - first, 1
    longest = int(np.diff(start).max(initial=1))
    while step < longest:
        rows = np.flatnonzero(inside >= step)
        product = _multiplied(turn[rows], turn[rows - step])
        turn[rows] = product / np.linalg.norm(product, axis=1, keepdims=True)
        step *= 2
    carried = _rotated(normal[first], turn)
    if not cyclic.any():
        return carried
    end = np.maximum(start[1:] - 1, 0)
    begin = np.minimum(start[:-1], len(along) - 1)
    back = _rotated(carried[end], _between(along[end], along[begin]))
    away, axis = carried[begin], along[begin]
    sine = np.einsum("ij,ij->i", np.cross(back, away), axis)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", back, away))
    # A half turn either way is the same, and Blender takes the positive one
    share = np.where(cyclic, angle / np.maximum(np.diff(start), 1), 0)[owner] * inside
    return _turned(carried, along, share)


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 4) unit quaternions, real part first, that turn unit vectors a into b the shortest way; opposite ones are
    left alone, since a normal fits both."""
    real = 1 + np.einsum("ij,ij->i", a, b)
    quaternion = np.column_stack([real, np.cross(a, b)])
    quaternion[real < 1e-12] = [1, 0, 0, 0]
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def _multiplied(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternions: first b, then a."""
    w, v, x, u = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    real = w * x - np.einsum("ij,ij->i", v, u)[:, None]
    return np.concatenate([real, w * u + x * v + np.cross(v, u)], axis=1)


def _rotated(vector: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    w, v = quaternion[:, :1], quaternion[:, 1:]
    twice = 2 * np.cross(v, vector)
    return vector + w * twice + np.cross(v, twice)


def _turned(vector: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors turned around unit axes by angles (n,)."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = np.einsum("ij,ij->i", axis, vector)[:, None] * axis
    return along + (vector - along) * cosine + np.cross(axis, vector) * sine
