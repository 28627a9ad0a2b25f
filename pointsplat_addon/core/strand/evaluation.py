"""Points on Catmull-Rom, poly, Bezier and NURBS curves, at Blender's parameters, as weighted sums of control points."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import offsets, owners, ranges, ranks, starts
from .curves import AUTO, BEZIER, CATMULL_ROM, NURBS, POLY, Curves, EvaluatedCurves
from .normals import unit
from .nurbs import NurbsSpans

MOST_STEPS = 12  # that AUTO takes in a segment, Blender's default resolution
CHORD = 0.25  # largest deviation of a chord from its curve under AUTO, in radii
SAG = 0.01  # and in lengths of the segment, so that thick curves show no corners either


def evaluate_curves(curves: Curves) -> EvaluatedCurves:
    """Evaluates curves at the parameters of Blender 5.2 (Blender 4.5 spaces the points of NURBS curves differently, on
    the same curve)."""
    count, start = curves.count, np.asarray(curves.start, np.int64)
    spans = NurbsSpans(curves)
    kind = np.where(spans.fits | (curves.kind != NURBS), curves.kind, POLY)
    owner = owners(count)
    inside = np.arange(start[-1]) - start[owner]

    # Points from each control point on; the last control point of an open curve gives one
    steps = np.where(kind == POLY, 1, np.maximum(curves.resolution, 1))[owner]
    last = inside == count[owner] - 1
    following = np.where(last, start[owner], np.arange(start[-1]) + 1)
    if (automatic := (kind == CATMULL_ROM) & (curves.resolution == AUTO)).any():
        steps = np.where(automatic[owner], _automatic_steps(curves, owner, inside, following), steps)
    if curves.vector_left is not None and curves.vector_right is not None:
        straight = curves.vector_right & curves.vector_left[following]
        steps = np.where(straight & (kind == BEZIER)[owner], 1, steps)
    steps[last & ~(curves.cyclic & (count > 1))[owner]] = 1
    steps[spans.fits[owner]] = 0
    total = np.add.reduceat(steps, start[:-1]) if len(count) else np.zeros(0, np.int64)
    total = np.where(spans.fits, spans.total, total)
    opened = offsets(total)

    # Points of segments: parameters between their control points
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

    # Cyclic curves end with a copy of their first point
    repeated = None
    start_closed = opened
    if (closed := curves.cyclic & (total > 1)).any():
        start_closed = opened + offsets(closed)
        repeated = ranges(opened[:-1], np.diff(start_closed))
        repeated[start_closed[1:][closed] - 1] = opened[:-1][closed]
    result = EvaluatedCurves(start_closed, np.empty(0), tuple(p for p in parts if len(p[0])), repeated, opened)
    position = _positions(result, curves, kind, owner, point, following, rows, t)
    return EvaluatedCurves(start_closed, position, result.parts, repeated, opened)


def _positions(
    found: EvaluatedCurves,
    curves: Curves,
    kind: np.ndarray,
    owner: np.ndarray,
    point: np.ndarray,
    following: np.ndarray,
    rows: np.ndarray,
    t: np.ndarray,
) -> np.ndarray:
    """(E, 3) float64 positions of evaluated points: interpolated, and by the handles on Bezier curves."""
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
    """The control points (e, 4) and weights (e, 4) of points at parameters t (e,) of Catmull-Rom segments."""
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
    """The four control points of the segments that begin at `point`. Ends of open curves are repeated, and so are both
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


def _automatic_steps(curves: Curves, owner: np.ndarray, inside: np.ndarray, following: np.ndarray) -> np.ndarray:
    """(P,) int64: steps of each segment such that chords deviate from the curve by at most CHORD radii and SAG of the
    segment's length; n steps deviate by at most |p''| / 8 n^2."""
    every = np.arange(len(owner))
    a, b, c, d = _neighbours(every, curves.start, owner, inside, following, curves.cyclic)
    p = np.asarray(curves.position, np.float64)
    across = p[c] - p[b]
    chord = unit(across)
    # Only what leads away from the chord; along it points merely lie unevenly
    bends = (2 * p[a] - 5 * p[b] + 4 * p[c] - p[d], -p[a] + 4 * p[b] - 5 * p[c] + 2 * p[d])
    first, second = (np.linalg.norm(v - np.einsum("ij,ij->i", v, chord)[:, None] * chord, axis=1) for v in bends)
    radius = np.zeros(len(p)) if curves.radius is None else np.maximum(curves.radius[b], curves.radius[c])
    bend = np.maximum(first, second) / 8
    allowed = np.minimum(CHORD * radius, SAG * np.linalg.norm(across, axis=1))
    with np.errstate(all="ignore"):
        found = np.ceil(np.sqrt(bend / allowed) - 1e-6)
    return np.clip(np.nan_to_num(found, nan=1, posinf=MOST_STEPS), 1, MOST_STEPS).astype(np.int64)
