"""Strands without the points that cannot be drawn, with unit tangents and sides at those that remain."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import offsets, owners
from ..scene.cloud import FARTHEST
from ..scene.strands import Strands
from .levels import StrandLevels, coarsest_attribute_level, halving_levels

MOST_POINTS = 1 << 24  # of one geometry: float32 counts no farther
LEAST_END_COSINE = 0.5  # cosine between a strand's end and the way to where it is a radius away


def clean(lines: Strands) -> StrandLevels:
    """The strands that can be drawn. Points that are not finite, or have such a value, break a strand in two; points in
    the place of the one before, strands of one place and strands without a radius are left out."""
    position = np.asarray(lines.position, np.float32).reshape(-1, 3)[:MOST_POINTS]
    count = len(position)
    whole = np.asarray(lines.start, np.int64)
    owner = owners(np.diff(whole))[:count]
    values = [a[:count] for a in (lines.color, lines.surface, lines.emission) if a is not None]
    with np.errstate(invalid="ignore"):
        good = (np.abs(position) < FARTHEST).all(axis=1) & (np.abs(lines.radius[:count]) < FARTHEST)
    for value in values:
        good &= np.isfinite(value).all(axis=1)
    begins = np.ones(count, bool)
    begins[1:] = (owner[1:] != owner[:-1]) | ~good[:-1]
    repeated = np.zeros(count, bool)
    repeated[1:] = (position[1:] == position[:-1]).all(axis=1) & ~begins[1:]
    kept = np.flatnonzero(good & ~repeated)
    radius = np.maximum(np.asarray(lines.radius, np.float32)[kept], 0)
    run = np.cumsum(begins)[kept]
    number = np.bincount(run)
    several, wide = number > 1, np.bincount(run, radius) > 0
    strand = np.zeros((2, len(whole) - 1), bool)  # of those that were given: with two places, and to be drawn
    for found, runs in zip(strand, (several, several & wide), strict=True):
        found[owner[kept[runs[run]]]] = True
    drawn = (several & wide)[run]
    kept, radius = kept[drawn], radius[drawn]
    start = offsets(number[several & wide])

    p = position[kept]
    tangent = _straighten_end_tangents(_tangents(p, start), p, radius, start)
    side = None if lines.normal is None else _ribbon_sides(np.asarray(lines.normal, np.float32)[kept], tangent)
    owner = owner[kept[start[:-1]]]
    rows = np.full(len(owner), lines.materials[0]) if lines.material is None else lines.material[owner].astype(np.int64)
    levels = halving_levels(start)
    varying = np.concatenate([a[kept] for a in values], axis=1) if values else None
    detail = coarsest_attribute_level(varying, levels, len(start) - 1)
    messages = [
        *_counted(int(np.count_nonzero(~good)), "point", "is not finite", "are not finite"),
        *_counted(int((~strand[0]).sum()), "strand", "has less than two places", "have less than two places"),
        *_counted(int((strand[0] & ~strand[1]).sum()), "strand", "has no radius", "have no radius"),
    ]
    if len(lines.position) > MOST_POINTS:
        messages.append(f"strands beyond {MOST_POINTS} points are left out")
    return StrandLevels(
        np.asarray(lines.origin, float), kept, p, radius, start, tangent, side, rows, levels, detail, tuple(messages)
    )


def _counted(number: int, what: str, one: str, many: str) -> list[str]:
    if number == 0:
        return []
    return [f"1 {what} {one} and is left out" if number == 1 else f"{number} {what}s {many} and are left out"]


def _tangents(p: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(P, 3) float32 unit, by the neighbours of each point."""
    before, after = np.arange(len(p)) - 1, np.arange(len(p)) + 1
    before[start[:-1]], after[start[1:] - 1] = start[:-1], start[1:] - 1
    # Of the directions to both neighbours, so that long and short segments count alike.
    back, on = p - p[before], p[after] - p
    for d in (back, on):
        d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), np.float32(1e-37))
    both = back + on
    size = np.linalg.norm(both, axis=1, keepdims=True)
    turned = size[:, 0] < 1e-3  # the strand goes back where it came from
    both[turned], size[turned] = on[turned], 1
    # Closed strands go on.
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
    """(P, 3) float32 unit: tangents, those at the ends turned to where the strand is a radius away where they lead
    elsewhere. Splines go back and forth about control points that coincide, and strands end in planes across their
    tangents, which would then cut off the strand instead of its end."""
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
    """(P, 3) float32 unit, perpendicular to tangents and normals; any, where these are no directions."""
    with np.errstate(invalid="ignore"):
        side = np.cross(np.where(np.abs(normal) < FARTHEST, normal, np.float32(0)), tangent)
    size = np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(np.eye(3, dtype=np.float32)[np.abs(tangent).argmin(axis=1)], tangent)
    other /= np.maximum(np.linalg.norm(other, axis=1, keepdims=True), np.float32(1e-37))
    return np.where(size > 1e-6, side / np.maximum(size, np.float32(1e-37)), other).astype(np.float32)
