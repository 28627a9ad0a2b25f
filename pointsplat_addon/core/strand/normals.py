"""Tangents and normals of evaluated curves, as Blender defines them: minimum twist, Z up or given, turned by a tilt."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import owners, ranges
from .curves import FREE, MINIMUM_TWIST, EvaluatedCurves

UPRIGHT = 1e-4  # tangents whose |x| + |y| is below this are vertical (Blender's number)


def curve_normals(
    evaluated: EvaluatedCurves,
    cyclic: np.ndarray,
    mode: np.ndarray,
    tilt: np.ndarray | None = None,
    free: np.ndarray | None = None,
) -> np.ndarray:
    """(E, 3) float64 unit normals of evaluated curves, as Blender defines them.

    cyclic, mode (C,): MINIMUM_TWIST, Z_UP or FREE. tilt (E,): angles in radians by which they are turned around the
    tangents. free (E, 3): the normals of curves whose mode is FREE; without them these have minimum twist.
    """
    chosen = slice(None) if evaluated.rows is None else _unrepeated(evaluated)
    position, start = evaluated.position[chosen], evaluated.open
    owner = owners(np.diff(start))
    along = curve_tangents(position, start, cyclic)
    flat = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
    upright = np.abs(along[:, :2]).sum(axis=1) < UPRIGHT
    flat[upright] = [1, 0, 0]
    result = unit(flat)
    least = (mode == MINIMUM_TWIST) | ((mode == FREE) & (free is None))
    if least.any():
        result = np.where(least[owner, None], _minimum_twist(result, along, start, owner, cyclic), result)
    if free is not None:
        given = unit(np.asarray(free, np.float64)[chosen])
        result = np.where(((mode == FREE)[owner] & given.any(axis=1))[:, None], given, result)
    if tilt is not None:
        result = _rotate_about(result, along, np.asarray(tilt, np.float64)[chosen])
    return result if evaluated.rows is None else result[evaluated.rows]


def _unrepeated(evaluated: EvaluatedCurves) -> np.ndarray:
    """Indices of all points except those that repeat a cyclic curve's first point."""
    return ranges(evaluated.start[:-1], np.diff(evaluated.open))


def curve_tangents(position: np.ndarray, start: np.ndarray, cyclic: np.ndarray) -> np.ndarray:
    """(E, 3) float64 unit tangents: bisectors of the two segments that meet at a point.

    start (C + 1,): the first point of each curve, and E; cyclic (C,) bool: the last point is followed by the first.
    Points that coincide with both neighbours have the previous point's tangent, or the curve's first. Curves whose
    points all coincide have +Z.
    """
    count = len(position)
    if count == 0:
        return np.empty((0, 3))
    owner = owners(np.diff(start))
    every = np.arange(count)
    first, last = start[:-1][owner], start[1:][owner] - 1
    following = np.where(every < last, every + 1, np.where(cyclic[owner], first, every))
    ahead = unit(np.asarray(position, np.float64)[following] - position)
    behind = np.zeros_like(ahead)
    moved = following != every
    behind[following[moved]] = ahead[moved]
    # A point that coincides with one neighbour takes the direction to the other
    missing = ~ahead.any(axis=1)
    alone = ~behind.any(axis=1)
    both = unit(np.where(missing[:, None], behind, ahead) + np.where(alone[:, None], ahead, behind))
    valid = both.any(axis=1)
    known = np.maximum.accumulate(np.where(valid, every, -1))
    known = np.where(known < first, -1, known)
    earliest = np.full(len(start) - 1, count)
    np.minimum.at(earliest, owner[valid], every[valid])
    known = np.where(known < 0, earliest[owner], known)
    filled = np.concatenate([both, [[0.0, 0.0, 1.0]]])
    return filled[np.minimum(known, count)]


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) divided by their lengths; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors, float), where=length > 0)


def _minimum_twist(
    normal: np.ndarray, along: np.ndarray, start: np.ndarray, owner: np.ndarray, cyclic: np.ndarray
) -> np.ndarray:
    """Normals of minimum twist: the first normal of each curve, carried along by the rotations from tangent to tangent.
    Cyclic curves distribute the angle that remains after one turn over all their points."""
    every = np.arange(len(along))
    first = start[:-1][owner]
    before = np.where(every > first, every - 1, every)
    turn = _rotation_between(along[before], along)
    # Rotations from the first point on, as products over 2, 4, 8 ... points
    inside, step = every - first, 1
    longest = int(np.diff(start).max(initial=1))
    while step < longest:
        rows = np.flatnonzero(inside >= step)
        product = _multiply(turn[rows], turn[rows - step])
        turn[rows] = product / np.linalg.norm(product, axis=1, keepdims=True)
        step *= 2
    carried = _rotate(normal[first], turn)
    if not cyclic.any():
        return carried
    end = np.maximum(start[1:] - 1, 0)
    begin = np.minimum(start[:-1], len(along) - 1)
    back = _rotate(carried[end], _rotation_between(along[end], along[begin]))
    away, axis = carried[begin], along[begin]
    sine = np.einsum("ij,ij->i", np.cross(back, away), axis)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", back, away))
    # A half turn either way is the same, and Blender takes the positive one
    share = np.where(cyclic, angle / np.maximum(np.diff(start), 1), 0)[owner] * inside
    return _rotate_about(carried, along, share)


def _rotation_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 4) unit quaternions, real part first, that turn unit vectors a into b the shortest way; opposite ones are
    left alone, since a normal fits both."""
    real = 1 + np.einsum("ij,ij->i", a, b)
    quaternion = np.column_stack([real, np.cross(a, b)])
    quaternion[real < 1e-12] = [1, 0, 0, 0]
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The products of quaternions (n, 4): the rotation b followed by a."""
    w, v, x, u = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    real = w * x - np.einsum("ij,ij->i", v, u)[:, None]
    return np.concatenate([real, w * u + x * v + np.cross(v, u)], axis=1)


def _rotate(vector: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Rotates vectors (n, 3) by unit quaternions (n, 4)."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    twice = 2 * np.cross(v, vector)
    return vector + w * twice + np.cross(v, twice)


def _rotate_about(vector: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotates vectors (n, 3) about unit axes (n, 3) by angles (n,) in radians."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = np.einsum("ij,ij->i", axis, vector)[:, None] * axis
    return along + (vector - along) * cosine + np.cross(axis, vector) * sine
