"""Prepares valid strands for selection: tangents, sides of ribbons, and levels of points that may be left out."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import owners
from ..scene.cloud import FARTHEST
from ..scene.strands import Strands
from .levels import StrandLevels, coarsest_attribute_level, halving_levels

LEAST_END_COSINE = 0.5  # cosine between a strand's end and the way to where it is a radius away


def with_levels(strands: Strands) -> StrandLevels:
    """Returns valid strands with tangents, the sides of ribbons and the levels that points may be left out by."""
    position, radius = np.asarray(strands.position, np.float32), np.asarray(strands.radius, np.float32)
    start = np.asarray(strands.start, np.int64)
    tangent = _straighten_end_tangents(_tangents(position, start), position, radius, start)
    side = None if strands.normal is None else _ribbon_sides(np.asarray(strands.normal, np.float32), tangent)
    count = len(start) - 1
    rows = np.full(count, strands.materials[0]) if strands.material is None else strands.material.astype(np.int64)
    levels = halving_levels(start)
    values = [a for a in (strands.color, strands.surface, strands.emission) if a is not None]
    detail = coarsest_attribute_level(np.concatenate(values, axis=1) if values else None, levels, count)
    return StrandLevels(np.asarray(strands.origin, float), position, radius, start, tangent, side, rows, levels, detail)


def _tangents(p: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(P, 3) float32 unit tangents: the mean of the directions to both neighbours of each point."""
    before, after = np.arange(len(p)) - 1, np.arange(len(p)) + 1
    before[start[:-1]], after[start[1:] - 1] = start[:-1], start[1:] - 1
    # Unit directions to both neighbours, so that long and short segments count alike.
    back, on = p - p[before], p[after] - p
    for d in (back, on):
        d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), np.float32(1e-37))
    both = back + on
    size = np.linalg.norm(both, axis=1, keepdims=True)
    turned = size[:, 0] < 1e-3  # the strand goes back where it came from
    both[turned], size[turned] = on[turned], 1
    # Closed strands have one tangent at their joint.
    ends = start[:-1], start[1:] - 1
    closed = np.flatnonzero((p[ends[0]] == p[ends[1]]).all(axis=1)) if len(start) > 1 else np.empty(0, int)
    result = both / np.maximum(size, np.float32(1e-37))
    if len(closed):
        a, b = ends[0][closed], ends[1][closed]
        joint = result[a] + result[b]
        long = np.linalg.norm(joint, axis=1, keepdims=True)
        good = long[:, 0] > 1e-3
        result[a[good]] = result[b[good]] = joint[good] / long[good]
    return result


def _straighten_end_tangents(tangent: np.ndarray, p: np.ndarray, radius: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(P, 3) float32 unit tangents, those at the ends of strands replaced, where they point elsewhere, by the direction
    to where the strand is a radius away. Splines go back and forth about control points that coincide, and strands end
    in planes across their tangents, which would then cut off the strand instead of its end."""
    if len(start) < 2:
        return tangent
    first, last = start[:-1], start[1:] - 1
    number, owner = np.arange(len(p)), owners(np.diff(start))
    away, nearest = [], (np.minimum, np.maximum)
    for end, other, near in zip((first, last), (last, first), nearest, strict=True):
        off = p - p[end][owner]
        outside = np.einsum("nc,nc->n", off, off) > (radius[end] ** 2)[owner]
        found = near.reduceat(np.where(outside, number, other[owner]), first)
        away.append(p[found] - p[end])
    for end, way in zip((first, last), (away[0], -away[1]), strict=True):
        size = np.linalg.norm(way, axis=1)
        astray = np.flatnonzero(np.einsum("nc,nc->n", way, tangent[end]) < LEAST_END_COSINE * size)
        tangent[end[astray]] = way[astray] / size[astray, None]
    return tangent


def _ribbon_sides(normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """(P, 3) float32 unit vectors across ribbons, perpendicular to tangents and normals; any perpendicular of the
    tangent where the normal gives none."""
    with np.errstate(invalid="ignore"):
        side = np.cross(np.where(np.abs(normal) < FARTHEST, normal, np.float32(0)), tangent)
    size = np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(np.eye(3, dtype=np.float32)[np.abs(tangent).argmin(axis=1)], tangent)
    other /= np.maximum(np.linalg.norm(other, axis=1, keepdims=True), np.float32(1e-37))
    return np.where(size > 1e-6, side / np.maximum(size, np.float32(1e-37)), other).astype(np.float32)
