"""Which segments of strands a view draws, and how much of a pixel's width each of them covers.

A segment that is wider than the raster's line is drawn with its exact outline. A thinner one is a line of one pixel, in
the share of a picture's samples that is its own width over the line's (`Segments.share`): the mean over samples has its
area, and no sample draws what is not needed for that. Short strands are not seen to be broken, and have their outlines
although they are thinner. Where all that inner points of a strand change is below a fraction of a pixel they are left
out by powers of two, and what is drawn keeps the area of what it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..scene.camera import Camera
from ..scene.cloud import FARTHEST
from ..scene.strands import Strands, owners

GOLDEN = (5**0.5 - 1) / 2
BLOCK = 64  # strands that follow one another, of which each sample shows its share
MOST_POINTS = 1 << 24  # of one geometry: float32 counts no farther
ERROR = 0.25  # of the tolerance: how far an outline may move where inner points are left out
SEEN_CHANGE = 1 / 64  # of colours and of surface values between the points that are kept
SHORT = 1.0  # pixels: below it no change along a segment is seen
ROUND = 2.0  # widths of the raster's line: below it a segment has one shade across
THIN = 1.0  # widths of the raster's line: below it a segment is one
SMALL = 16.0  # pixels: strands that are no longer are not seen to be broken
SLIGHT = 0.25  # widths of the raster's line: from here on they are drawn with their outlines
SCARCE = 0.1  # pixels: below this width, drawing a few strands in each sample saves more than choosing them takes
FEW_POINTS = 3  # of a strand in the mean: there is little that could be left out
MARGIN = 2.0  # pixels beyond the picture that lines of one pixel may come from
BELOW_ONE = 1 - 2.0**-24  # the largest float32
FEW = 0.02  # of the strands: what they alone would save costs more to find
LEAST_ALONG = 0.5  # cosine between a strand's end and the way to where it is a radius away
NARROW = 1e-3  # pixels: shorter segments have no direction on the screen
NEAREST = 1e-12  # units from the eye: what is nearer is drawn as if there, for squares of pixels to fit float32


@dataclass(frozen=True, eq=False)
class StrandLevels:
    """The points of strands that can be drawn: finite ones, no two in one place, at least two to a strand, which has a
    radius."""

    origin: np.ndarray  # (3,) float64
    source: np.ndarray  # (P,) int64: rows of the scene.strands.Strands that they come from
    position: np.ndarray  # (P, 3) float32
    radius: np.ndarray  # (P,) float32, at least 0
    start: np.ndarray  # (S + 1,) int64
    tangent: np.ndarray  # (P, 3) float32, unit
    side: np.ndarray | None  # (P, 3) float32, unit: across a ribbon; None: tubes
    material: np.ndarray  # (S,) int64
    levels: tuple[Level, ...]
    detail: np.ndarray  # (S,) int8: up to this level, attributes change too little to be seen
    messages: tuple[str, ...]  # what was left out, counted

    def __len__(self) -> int:
        """How many points."""
        return len(self.position)

    @property
    def nbytes(self) -> int:
        arrays = [self.source, self.position, self.radius, self.start, self.tangent, self.material, self.detail]
        arrays += [] if self.side is None else [self.side]
        arrays += [a for level in self.levels for a in (level.middle, level.low, level.high, level.first, level.strand)]
        return sum(a.nbytes for a in arrays)

    @cached_property
    def phase(self) -> np.ndarray:
        """(S,) float64 in [0, 1): evenly spread over each BLOCK of strands, and without order within it. A sequence
        with one, as multiples of the golden ratio, may be that in which the strands were laid out: then those that a
        sample shows would lie side by side."""
        count = len(self.start) - 1
        block = np.arange(count) // BLOCK
        lot, off = np.random.default_rng(count).random((2, count))
        rank = np.empty(count)
        rank[np.lexsort((lot, block))] = np.arange(count) - BLOCK * block
        return (rank + off) / np.minimum(BLOCK, count - BLOCK * block)

    @cached_property
    def strand(self) -> np.ndarray:
        """(P,) int32: which strand each point belongs to."""
        return np.repeat(np.arange(len(self.start) - 1, dtype=np.int32), np.diff(self.start))

    @cached_property
    def reached(self) -> np.ndarray:
        """(P,) float64: object units along strands from the first point of all, without what is between strands."""
        step = np.linalg.norm(np.diff(self.position, axis=0, prepend=self.position[:1]), axis=1).astype(np.float64)
        step[self.start[:-1]] = 0
        return np.cumsum(step)

    def ends_near(self, ends: np.ndarray) -> np.ndarray:
        """(K, 2) int64: of segments (K, 2), the first and the last point of the strand where balls along the segment
        may reach beyond it, else -1. Closed strands have no ends."""
        strand = self.strand[ends[:, 0]]
        outer = np.stack([self.start[strand], self.start[strand + 1] - 1], axis=1)
        closed = (self.position[outer[:, 0]] == self.position[outer[:, 1]]).all(axis=1)
        reach = np.maximum(*self.radius[ends.T])[:, None]
        near = (np.abs(self.reached[ends] - self.reached[outer]) <= reach) & (reach > 0) & ~closed[:, None]
        return np.where(near, outer, -1)

    def total(self, length: np.ndarray) -> np.ndarray:
        """(S,) float32: sums over strands of what lies between each point and the next (P - 1,) float32."""
        if len(self.start) < 2:
            return np.zeros(0, np.float32)
        length = np.append(length, np.float32(0))
        return np.add.reduceat(length, self.start[:-1]) - length[self.start[1:] - 1]

    @cached_property
    def every(self) -> np.ndarray:
        """(K, 2) int32: all segments, none left out."""
        first = np.delete(np.arange(len(self), dtype=np.int32), self.start[1:] - 1)
        return np.stack([first, first + 1], axis=1)

    @cached_property
    def bounds(self) -> Bounds:
        low, high = self.position.min(axis=0), self.position.max(axis=0)
        middle = 0.5 * (low + high)
        away = np.linalg.norm(self.position - middle, axis=1) + self.radius
        step = np.linalg.norm(np.diff(self.position, axis=0), axis=1)
        widest = np.maximum.reduceat(self.radius, self.start[:-1])
        return Bounds(
            self.origin + middle,
            float(away.max()),
            float(self.total(step).max()),
            float(2 * widest.max()),
            float(2 * np.median(widest)),
        )

    @cached_property
    def local(self) -> np.ndarray:
        """(P,) int32: the how manieth of its strand each point is."""
        return (np.arange(len(self)) - self.start[self.strand]).astype(np.int32)


@dataclass(frozen=True)
class Bounds:
    """Of all strands of one geometry, in its units."""

    middle: np.ndarray  # (3,) float64, of a ball that holds them
    radius: float  # of that ball
    longest: float
    widest: float
    typical: float  # half of the strands are wider somewhere


@dataclass(frozen=True, eq=False)
class Level:
    """The points that one halving leaves out, each between two that stay."""

    middle: np.ndarray  # (N,) int32
    low: np.ndarray  # (N,) int32
    high: np.ndarray  # (N,) int32
    first: np.ndarray  # (R,) int64: rows where another strand begins
    strand: np.ndarray  # (R,) int32: which


@dataclass(frozen=True, eq=False)
class Segments:
    """What one view draws of the strands of one geometry."""

    ends: np.ndarray  # (K, 2) int32: points of `Strands`
    instance: np.ndarray  # (K,) int32: rows of Scene.instances
    material: np.ndarray  # (K,) int32
    phase: np.ndarray  # (K,) float32 in [0, 1): evenly spread over strands
    share: np.ndarray  # (K, 2) float32: of the raster line's width, at both ends
    strands: int  # that have a segment in the list

    def __len__(self) -> int:
        return len(self.ends)

    def take(self, index: np.ndarray) -> Segments:
        """Some of them."""
        named = {name: getattr(self, name)[index] for name in ("ends", "instance", "material", "phase", "share")}
        return replace(self, **named)

    @cached_property
    def most(self) -> np.ndarray:
        """(K,) float32: the greater share of the two ends."""
        return np.maximum(self.share[:, 0], self.share[:, 1])  # several times as fast as along the short axis

    @cached_property
    def wide(self) -> np.ndarray:
        """(K,) int64: segments that are drawn with their outlines in every sample, and may be seen to be round."""
        return np.flatnonzero(self.most >= ROUND)

    @cached_property
    def narrow(self) -> np.ndarray:
        """(K,) int64: segments that are drawn with their outlines in every sample, and are too narrow for more."""
        return np.flatnonzero((self.most >= THIN) & (self.most < ROUND))

    @cached_property
    def thin(self) -> np.ndarray:
        """(K,) int64: segments that are lines of one pixel in some samples."""
        return np.flatnonzero((self.most < THIN) & (self.most > 0))

    def drawn(self, turn: float) -> np.ndarray:
        """(N,) int64: the thin ones of a sample, whose `turn` is one of `turns`."""
        index = self.thin
        if len(index) == 0:
            return index
        phase = (self.phase[index] + np.float32(turn)) % np.float32(1)
        return index[phase < self.most[index]]


def turns(count: int) -> np.ndarray:
    """(count,) float64: k / count in an order in which any first ones lie evenly. With frac(phase + turn) < a, a strand
    of share a is drawn in floor or ceil(a count) samples of all, and so in the first half of them."""
    index, inverse = np.arange(count), np.zeros(count)
    base = 0.5
    while index.any():
        inverse += base * (index & 1)
        index >>= 1
        base /= 2
    turn = np.empty(count)
    turn[:] = np.argsort(np.argsort(inverse)) / count
    return turn


def clean(lines: Strands) -> StrandLevels:
    """The strands that can be drawn. Points that are not finite, or have such a value, break a strand in two; points in
    the place of the one before, strands of one place and strands without a radius are left out."""
    position = np.asarray(lines.position, np.float32).reshape(-1, 3)[:MOST_POINTS]
    count = len(position)
    whole = np.asarray(lines.start, np.int64)
    owner = owners(whole)[:count]
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
    start = np.concatenate([[0], np.cumsum(number[several & wide])]).astype(np.int64)

    p = position[kept]
    tangent = _outward(_tangents(p, start), p, radius, start)
    side = None if lines.normal is None else _sides(np.asarray(lines.normal, np.float32)[kept], tangent)
    owner = owner[kept[start[:-1]]]
    rows = np.full(len(owner), lines.materials[0]) if lines.material is None else lines.material[owner].astype(np.int64)
    levels = _levels(start)
    varying = np.concatenate([a[kept] for a in values], axis=1) if values else None
    detail = _detail(varying, levels, len(start) - 1)
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


def _outward(tangent: np.ndarray, p: np.ndarray, radius: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(P, 3) float32 unit: tangents, those at the ends turned to where the strand is a radius away where they lead
    elsewhere. Splines go back and forth about control points that coincide, and strands end in planes across their
    tangents, which would then cut off the strand instead of its end."""
    if len(start) < 2:
        return tangent
    first, last = start[:-1], start[1:] - 1
    number, owner = np.arange(len(p)), owners(start)
    away, nearest = [], (np.minimum, np.maximum)
    for end, other, near in zip((first, last), (last, first), nearest, strict=True):
        off = p - p[end][owner]
        outside = np.einsum("nc,nc->n", off, off) > (radius[end] ** 2)[owner]
        found = near.reduceat(np.where(outside, number, other[owner]), first)
        away.append(p[found] - p[end])
    for end, way in zip((first, last), (away[0], -away[1]), strict=True):
        size = np.linalg.norm(way, axis=1)
        astray = np.flatnonzero(np.einsum("nc,nc->n", way, tangent[end]) < LEAST_ALONG * size)
        tangent[end[astray]] = way[astray] / size[astray, None]
    return tangent


def _sides(normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """(P, 3) float32 unit, perpendicular to tangents and normals; any, where these are no directions."""
    with np.errstate(invalid="ignore"):
        side = np.cross(np.where(np.abs(normal) < FARTHEST, normal, np.float32(0)), tangent)
    size = np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(np.eye(3, dtype=np.float32)[np.abs(tangent).argmin(axis=1)], tangent)
    other /= np.maximum(np.linalg.norm(other, axis=1, keepdims=True), np.float32(1e-37))
    return np.where(size > 1e-6, side / np.maximum(size, np.float32(1e-37)), other).astype(np.float32)


def _levels(start: np.ndarray) -> tuple[Level, ...]:
    """Level k leaves out points whose number in their strand is an odd multiple of 2^k; ends stay."""
    longest = int(np.diff(start).max(initial=0))
    found, step = [], 1
    while 2 * step <= longest:
        inner = np.maximum((np.diff(start) - 2) // step + 1, 0) // 2  # odd multiples of `step` before the last point
        strand = np.repeat(np.arange(len(inner), dtype=np.int32), inner)
        number = np.arange(len(strand)) - np.repeat(np.cumsum(inner) - inner, inner)
        middle = start[strand] + step * (2 * number + 1)
        high = np.minimum(middle + step, start[strand + 1] - 1)
        some = np.flatnonzero(inner)
        first = (np.cumsum(inner) - inner)[some]
        middle, low, high = (a.astype(np.int32) for a in (middle, middle - step, high))
        found.append(Level(middle, low, high, first, some.astype(np.int32)))
        step *= 2
    return tuple(level for level in found if len(level.middle))


def _detail(values: np.ndarray | None, levels: tuple[Level, ...], strands: int) -> np.ndarray:
    """(S,) int8: the level up to which values (P, C) are linear enough."""
    if values is None:
        return np.full(strands, 127, np.int8)
    largest = np.maximum(np.abs(values).max(axis=0, initial=0), 1)
    off, result = np.zeros(strands), np.zeros(strands, np.int8)
    fine = np.ones(strands, bool)
    for number, level in enumerate(levels, 1):
        span = (level.high - level.low)[:, None]
        part = (level.middle - level.low)[:, None] / span
        between = values[level.low] * (1 - part) + values[level.high] * part
        error = (np.abs(values[level.middle] - between) / largest).max(axis=1)
        off[level.strand] += np.maximum.reduceat(error, level.first)
        fine &= off <= SEEN_CHANGE
        result[fine] = number
    return result


def select(
    strands: StrandLevels, view_from_object: np.ndarray, instance: int, camera: Camera, tolerance: float
) -> Segments:
    """The segments of one instance (its row in Scene.instances) that `camera` may see; (4, 4) float64 matrix.

    Widths of tubes scale with the cube root of the instance's volume; ribbons are scaled as surfaces are.
    """
    scale = _scale(strands.bounds, view_from_object, camera) if len(strands) else None
    if scale is None:
        return _none()
    if _outlined(strands, scale):
        return _all_of(strands, instance)
    picture = _projected(strands, view_from_object, camera)
    first, last = strands.every.T
    level = np.zeros(len(strands.start) - 1, np.int32)
    if strands.levels:
        level = _coarsest(strands, picture, ERROR * tolerance)
        kept = strands.local & ((np.int32(1) << level) - 1)[strands.strand] == 0
        kept[strands.start[1:] - 1] = True
        index = np.flatnonzero(kept)
        first, last = index[:-1], index[1:]
        whole = strands.strand[first] == strands.strand[last]
        first, last = first[whole], last[whole]
    if not scale.inside:
        seen = _seen(picture, first, last, camera)
        first, last = first[seen], last[seen]
    strand = strands.strand[first]
    share = _shares(strands, picture, first, last, level[strand] > 0)
    exact = (strands.total(picture.length) <= SMALL) & (level == 0)
    most = np.maximum(*share.T)
    share[exact[strand] & (most >= SLIGHT) & (most < THIN)] = THIN
    visible = (share[:, 0] > 0) | (share[:, 1] > 0)
    first, last, share, strand = first[visible], last[visible], share[visible], strand[visible]
    phase = (strands.phase[strand] + instance * GOLDEN) % 1
    return Segments(
        np.stack([first, last], axis=1).astype(np.int32),
        np.full(len(first), instance, np.int32),
        strands.material[strand].astype(np.int32),
        np.minimum(phase, BELOW_ONE).astype(np.float32),
        share,
        int(np.count_nonzero(np.diff(strand)) + 1) if len(strand) else 0,
    )


@dataclass(frozen=True)
class _Scale:
    """How large a view shows one instance."""

    fewest: float  # pixels of a unit that faces the eye; 0 where that is not known
    most: float  # infinite where something may reach the near plane
    inside: bool  # all of it lies in the picture


def _scale(bounds: Bounds, view_from_object: np.ndarray, camera: Camera) -> _Scale | None:
    """None where the ball lies outside the picture."""
    linear = view_from_object[:3, :3]
    x, y, z = linear @ bounds.middle + view_from_object[:3, 3]
    if not (np.isfinite(linear).all() and np.isfinite([x, y, z]).all()):
        return _Scale(0.0, np.inf, False)
    scales = np.linalg.svd(linear, compute_uv=False)
    # Radii of tubes are scaled by the mean of the three, which is no more.
    reach = bounds.radius * float(scales[0])
    nearest, farthest = -z - reach, -z + reach
    if farthest <= camera.near or nearest >= camera.far:
        return None
    if camera.perspective and nearest <= camera.near:
        return _Scale(0.0, np.inf, False)
    fx, fy, cx, cy = camera.pixel_from_view()
    depths = (nearest, farthest) if camera.perspective else (1.0, 1.0)
    inside = nearest > camera.near and farthest < camera.far
    for middle, f, c, most in ((x, fx, cx, camera.window[2]), (y, fy, cy, camera.window[3])):
        sides = [f * (middle + side) / depth + c for side in (-reach, reach) for depth in depths]
        if min(sides) > most + MARGIN or max(sides) < -MARGIN:
            return None
        inside &= min(sides) >= 0 and max(sides) <= most
    f = float(np.sqrt(abs(fx * fy)))
    # Away from the middle of the picture perspective stretches what leads away from the eye.
    slope = (np.array([x, y]) + reach * np.sign([x, y])) / nearest if camera.perspective else np.zeros(2)
    stretched = float(np.sqrt(1 + slope @ slope))
    return _Scale(f * float(scales[2]) / depths[1], stretched * f * float(scales[0]) / depths[0], bool(inside))


def _outlined(strands: StrandLevels, scale: _Scale) -> bool:
    """Whether all of a geometry may be drawn with its outlines without a look at each segment: strands of few points
    that are short in the picture and mostly not too thin."""
    bounds = strands.bounds
    few = len(strands) <= FEW_POINTS * (len(strands.start) - 1)
    flat = strands.side is not None or bounds.widest * scale.most < ROUND
    return few and flat and bounds.longest * scale.most <= SMALL and bounds.typical * scale.fewest >= SCARCE


def _all_of(strands: StrandLevels, instance: int) -> Segments:
    ends = strands.every
    count = len(ends)
    return Segments(
        ends,
        np.full(count, instance, np.int32),
        strands.material[strands.strand[ends[:, 0]]].astype(np.int32),
        np.zeros(count, np.float32),
        np.full((count, 2), THIN, np.float32),
        len(strands.start) - 1,
    )


def _none() -> Segments:
    none = np.zeros(0, np.int32)
    return Segments(np.zeros((0, 2), np.int32), none, none, np.zeros(0, np.float32), np.zeros((0, 2), np.float32), 0)


@dataclass(frozen=True, eq=False)
class _Picture:
    """Points of strands as one view sees them."""

    place: np.ndarray  # (P, 2) float32, pixels; of what lies before the near plane as if it lay in it
    depth: np.ndarray  # (P,) float32
    reach: np.ndarray  # (P,) float32: radius in view space
    width: np.ndarray  # (P,) float32, pixels
    across: np.ndarray | None  # (P, 2) float32, pixels: from a ribbon's middle to its edge; None: tubes
    length: np.ndarray  # (P - 1,) float32: pixels from each point to the next


def _projected(strands: StrandLevels, view_from_object: np.ndarray, camera: Camera) -> _Picture:
    linear = view_from_object[:3, :3]
    with np.errstate(all="ignore"):
        shift = (linear @ strands.origin + view_from_object[:3, 3]).astype(np.float32)
        p = strands.position @ linear.T.astype(np.float32) + shift
        scale = np.float32(lengths_scale(view_from_object[None])[0])
        fx, fy, cx, cy = camera.pixel_from_view()
        depth = -p[:, 2]
        inverse = np.ones_like(depth)
        if camera.perspective:
            inverse = 1 / np.maximum(depth, np.float32(max(camera.near, NEAREST)))
        q = np.stack([p[:, 0] * (inverse * fx) + cx, p[:, 1] * (inverse * fy) + cy], axis=1).astype(np.float32)
        reach, across = strands.radius * scale, None
        if strands.side is None:
            width = (2 * np.float32(np.sqrt(abs(fx * fy)))) * reach * inverse
        else:
            side = (strands.side * strands.radius[:, None]) @ linear.T.astype(np.float32)
            reach = np.sqrt(np.einsum("nc,nc->n", side, side))
            # How the picture of a ribbon's edge lies beside that of its middle.
            nearer = side[:, 2] * inverse if camera.perspective else np.zeros_like(depth)
            columns = [f * inverse * (side[:, i] + p[:, i] * nearer) for i, f in enumerate((fx, fy))]
            across = np.stack(columns, axis=1).astype(np.float32)
            width = 2 * np.sqrt(np.einsum("nc,nc->n", across, across))
        step = np.diff(q, axis=0)
        length = np.sqrt(np.einsum("nc,nc->n", step, step))
    return _Picture(q, depth, reach, width, across, length)


def _areas(strands: StrandLevels, picture: _Picture) -> np.ndarray:
    """(P,) float64: pixels^2 from the first point to each."""
    width, across = picture.width, picture.across
    if across is None:
        area = picture.length * (0.5 * (width[1:] + width[:-1]))
    else:
        x, y = np.diff(picture.place, axis=0).T
        area = np.abs(across[:-1, 0] * y - across[:-1, 1] * x) + np.abs(across[1:, 0] * y - across[1:, 1] * x)
    area[strands.start[1:-1] - 1] = 0  # between strands
    return np.concatenate([[0.0], np.cumsum(area, dtype=np.float64)])


def _seen(picture: _Picture, first: np.ndarray, last: np.ndarray, camera: Camera) -> np.ndarray:
    """(K,) bool: segments from `first` to `last` that may be in the picture."""
    margin = 0.5 * np.maximum(picture.width[first], picture.width[last]) + 2
    seen = np.ones(len(first), bool)
    # Coordinate by coordinate: along a short axis NumPy takes many times as long.
    for place, most in zip(picture.place.T, camera.window[2:], strict=True):
        x, y = place[first], place[last]
        seen &= (np.minimum(x, y) < most + margin) & (np.maximum(x, y) > -margin)
    a, b = picture.depth[first], picture.depth[last]
    nearest, farthest = np.minimum(a, b), np.maximum(a, b)
    seen |= nearest < camera.near  # what is behind the eye has no picture
    reach = np.maximum(picture.reach[first], picture.reach[last])
    return seen & (farthest + reach > camera.near) & (nearest - reach < camera.far)


def _shares(
    strands: StrandLevels, picture: _Picture, first: np.ndarray, last: np.ndarray, thinned: np.ndarray
) -> np.ndarray:
    """(K, 2) float32: widths at the ends of segments over that of the raster's line, which is one pixel along the
    nearer axis. Segments that stand for several (`thinned`) have the area of these."""
    chord = picture.place[last] - picture.place[first]
    size = np.sqrt(np.einsum("nc,nc->n", chord, chord))
    line = np.where(size > NARROW, np.maximum(*np.abs(chord.T)) / np.maximum(size, NARROW), 1)
    across = picture.across
    if across is None:
        wide = np.stack([picture.width[first], picture.width[last]], axis=1)
    else:
        x, y = (chord / np.maximum(size, NARROW)[:, None]).T
        wide = 2 * np.stack([np.abs(across[i, 0] * y - across[i, 1] * x) for i in (first, last)], axis=1)
    if thinned.any():
        area = _areas(strands, picture)
        covers = (area[last] - area[first]).astype(np.float32)
        straight = 0.5 * (wide[:, 0] + wide[:, 1]) * size
        alike = thinned & (straight > 0.25 * covers)
        wide[alike] *= (covers[alike] / straight[alike])[:, None]
        other = thinned & ~alike
        wide[other] = (covers[other] / np.maximum(size[other], NARROW))[:, None]
    return np.nan_to_num(wide / line[:, None], posinf=1e30).astype(np.float32)


def lengths_scale(view_from_object: np.ndarray) -> np.ndarray:
    """(I,) float64: by how much matrices (I, 4, 4) scale the radii of tubes; 0 where they are not finite."""
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.cbrt(np.abs(np.linalg.det(view_from_object[:, :3, :3]))), posinf=0.0)


def _coarsest(strands: StrandLevels, picture: _Picture, allowed: float) -> np.ndarray:
    """(S,) int32: the level that each strand is drawn at, with outlines that are off by at most `allowed` pixels."""
    q, length = picture.place, picture.length
    beside = 0.5 * picture.width[:, None] if picture.across is None else picture.across
    count = len(strands.start) - 1
    level, off = np.zeros(count, np.int32), np.zeros(count, np.float32)
    total = strands.total(length)
    # Segments of the next level are half as many.
    short = np.floor(np.log2(np.maximum(SHORT * np.diff(strands.start) / np.maximum(total, 1e-20), 1)))
    most = np.maximum(strands.detail, np.minimum(short, 126))
    fine = np.ones(count, bool)
    for number, part in enumerate(strands.levels, 1):
        a, b, m = q[part.low], q[part.high], q[part.middle]
        chord, to = b - a, m - a
        squared = np.maximum(np.einsum("nc,nc->n", chord, chord), np.float32(1e-12))
        t = np.clip(np.einsum("nc,nc->n", chord, to) / squared, 0, 1)[:, None]
        away = to - t * chord
        error = np.sqrt(np.einsum("nc,nc->n", away, away))
        edge = beside[part.middle] - (beside[part.low] * (1 - t) + beside[part.high] * t)
        error += np.sqrt(np.einsum("nc,nc->n", edge, edge))
        off[part.strand] += np.maximum.reduceat(error, part.first)
        fine &= (off <= allowed) & (most >= number)
        if np.count_nonzero(fine) <= FEW * count:
            break
        # A strand that has nothing left to leave out is no coarser.
        level[part.strand[fine[part.strand]]] = number
    return level


def together(parts: list[Segments]) -> Segments:
    """The segments of several instances as one list."""
    if len(parts) == 1:
        return parts[0]
    ends, instance, material, phase, share = (
        np.concatenate(arrays)
        for arrays in zip(*((p.ends, p.instance, p.material, p.phase, p.share) for p in parts), strict=True)
    )
    return Segments(ends, instance, material, phase, share, sum(p.strands for p in parts))
