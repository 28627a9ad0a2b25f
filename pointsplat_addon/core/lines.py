"""Strands: hair, curves, ribbons and tubes, as polylines with radii (Marroquim et al. 2008, section 4)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Lines:
    """Strands of one object, in object space: P points in S strands, one after another.

    A strand without normals is a tube, which is round; one with normals is a ribbon, flat and two-sided, as wide as the
    tube would be. What varies along strands is linear between their points.
    """

    key: str  # content key: equal keys mean equal arrays
    name: str  # the object's name, for messages
    position: np.ndarray  # (P, 3) float32, relative to origin
    start: (
        np.ndarray
    )  # (S + 1,) int64: the points of strand s are start[s] .. start[s + 1] - 1; a closed one ends as it began
    radius: np.ndarray  # (P,) float32, half the width
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64
    normal: np.ndarray | None = None  # (P, 3) float32, unit: ribbons; None: tubes
    color: np.ndarray | None = None  # (P, 3) float32, scene-linear base colour; None: the material's
    surface: np.ndarray | None = None  # (P, 2) float32: roughness, metallic; None: the material's
    emission: np.ndarray | None = None  # (P, 3) float32 radiance; None: the material's
    uv: np.ndarray | None = None  # (S, 2) float32: where each strand grows on its surface
    material: np.ndarray | None = None  # (S,) uint16, rows of Scene.materials; None: all `materials[0]`
    materials: tuple[int, ...] = (0,)  # the rows in use

    def __len__(self) -> int:
        """How many strands."""
        return len(self.start) - 1

    @property
    def nbytes(self) -> int:
        arrays = (self.position, self.start, self.radius, self.normal, self.color, self.surface, self.emission, self.uv,
                  self.material)  # fmt: skip
        return sum(a.nbytes for a in arrays if a is not None)

    @cached_property
    def count(self) -> np.ndarray:
        """(S,) int64: points of each strand."""
        return np.diff(self.start)

    def take(self, points: np.ndarray, start: np.ndarray, strands: np.ndarray | slice = slice(None)) -> Lines:
        """Strands of some of the points (indices), from `start` (S' + 1,) on; strands: which ones are left."""
        named = {name: array[points] for name in OF_POINTS if (array := getattr(self, name)) is not None}
        named |= {name: array[strands] for name in OF_STRANDS if (array := getattr(self, name)) is not None}
        return replace(self, start=start, **named)


OF_POINTS = ("position", "radius", "normal", "color", "surface", "emission")
OF_STRANDS = ("uv", "material")
COLOR_STEP = 1 / 32  # colours that `simplified` may be off by: below it is hardly seen
GOLDEN = 0.6180339887498949  # its multiples lie evenly, however many are taken


def owners(start: np.ndarray) -> np.ndarray:
    """(P,) int64: the strand of each point."""
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def areas(lines: Lines) -> np.ndarray:
    """(S,) float64: what each strand covers seen from the side, in object units squared."""
    inner = np.ones(max(len(lines.position) - 1, 0), bool)
    ends = lines.start[1:-1] - 1
    inner[ends[(ends >= 0) & (ends < len(inner))]] = False
    length = np.linalg.norm(np.diff(lines.position.astype(np.float64), axis=0), axis=1)
    width = lines.radius[:-1].astype(np.float64) + lines.radius[1:]
    return np.bincount(owners(lines.start)[:-1][inner], (length * width)[inner], len(lines))


def cleaned(lines: Lines) -> tuple[Lines | None, list[str]]:
    """The strands that can be drawn, with what was left out, each counted: points that are no numbers, points without
    a distance to those before them, strands of one point and strands without a radius. None where nothing is left.

    Negative radii are 0. What is sound already comes back as it is.
    """
    messages: list[str] = []
    start = np.asarray(lines.start, np.int64)
    strand = owners(start)
    sound = np.isfinite(lines.position).all(axis=1) & np.isfinite(lines.radius)
    for name in OF_POINTS[2:]:
        if (array := getattr(lines, name)) is not None:
            sound &= np.isfinite(array).all(axis=1)
    points = np.flatnonzero(sound)
    _tell(messages, len(sound) - len(points), "point", "is not a number", "are not numbers")

    # Compared with the point that is left before it, not with one that was no number
    if len(points):
        fresh = (lines.position[points[1:]] != lines.position[points[:-1]]).any(axis=1)
        fresh |= strand[points[1:]] != strand[points[:-1]]
        points = points[np.concatenate([[True], fresh])]
    radius = np.maximum(lines.radius, 0)
    number = np.bincount(strand[points], minlength=len(lines))
    widest = np.bincount(strand[points], radius[points], len(lines))  # a sum, 0 where all are
    single, thin = number < 2, (number >= 2) & (widest <= 0)
    _tell(messages, int(single.sum()), "strand", "has less than two places", "have less than two places")
    _tell(messages, int(thin.sum()), "strand", "has no radius", "have no radius")
    kept = ~(single | thin)
    if not kept.any():
        return None, messages
    if len(points) == len(sound) and kept.all() and (lines.radius >= 0).all():
        return lines, messages
    points = points[kept[strand[points]]]
    begin = np.concatenate([[0], np.cumsum(number[kept])])
    return replace(lines, radius=radius.astype(np.float32)).take(points, begin, np.flatnonzero(kept)), messages


def _tell(messages: list[str], number: int, what: str, one: str, many: str) -> None:
    if number:
        messages.append(f"{number} {what} {one} and is left out" if number == 1 else
                        f"{number} {what}s {many} and are left out")  # fmt: skip


def simplified(lines: Lines, tolerance: float) -> Lines:
    """The strands with every second, fourth, eighth ... of their points, each as few as `tolerance` (object units)
    lets: no dropped point lies farther than that from the line that takes its place, no edge of the strand either, and
    colours differ by COLOR_STEP at most. Radii grow as lengths shrink, so that each strand covers the area that it did.

    Ends stay. Strands of equal numbers of points keep the same ones at equal levels. Raises ValueError where the
    tolerance is not positive.
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance is {tolerance}, expected a positive length")
    strand, count = owners(lines.start), lines.count
    first, last = lines.start[:-1][strand], lines.start[1:][strand] - 1
    inside = np.arange(len(strand)) - first
    level = np.zeros(len(lines), np.int64)
    going, step = count > 2, 2
    while going.any():
        rows = np.flatnonzero(going[strand] & (inside % step != 0) & (first + inside != last))
        before = rows - inside[rows] % step
        after = np.minimum(before + step, last[rows])
        failed = _farthest(lines, rows, before, after) > tolerance
        going = going.copy()
        going[strand[rows[failed]]] = False
        level[going] += 1
        going &= count - 1 > step
        step *= 2
    if not level.any():
        return lines
    kept = (inside % (1 << level[strand]) == 0) | (first + inside == last)
    points = np.flatnonzero(kept)
    start = np.concatenate([[0], np.cumsum(np.bincount(strand[points], minlength=len(lines)))])
    fewer = lines.take(points, start)
    return replace(
        _widened(fewer, np.divide(areas(lines), now := areas(fewer), out=np.ones(len(lines)), where=now > 0)),
        key=f"{lines.key} within {tolerance:g}",
    )


def _farthest(lines: Lines, rows: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n,) how far points, or the strand's edges at them, lie from the segments that take their place; infinite where
    colours differ too much."""
    p, a, b = (lines.position[i].astype(np.float64) for i in (rows, before, after))
    along, offset = b - a, p - a
    square = np.einsum("ij,ij->i", along, along)
    t = np.einsum("ij,ij->i", offset, along)
    t = np.clip(np.divide(t, square, out=np.zeros_like(t), where=square > 0), 0, 1)
    distance = np.linalg.norm(offset - t[:, None] * along, axis=1)
    distance += np.abs(lines.radius[rows] - ((1 - t) * lines.radius[before] + t * lines.radius[after]))
    if lines.normal is not None:
        mixed = (1 - t)[:, None] * lines.normal[before] + t[:, None] * lines.normal[after]
        distance += lines.radius[rows] * np.linalg.norm(lines.normal[rows] - mixed, axis=1)
    for values in (lines.color, lines.surface, lines.emission):
        if values is not None:
            mixed = (1 - t)[:, None] * values[before] + t[:, None] * values[after]
            distance[np.abs(values[rows] - mixed).max(axis=1) > COLOR_STEP] = np.inf
    return distance


def thinned(lines: Lines, share: float) -> Lines:
    """About `share` (in (0, 1]) of the strands, evenly chosen, widened to cover the area that all did; those of a
    smaller share are among those of a larger one. At least one stays. Raises ValueError where the share is not in
    (0, 1]."""
    if not 0 < share <= 1:
        raise ValueError(f"share is {share}, expected more than 0 and at most 1")
    lot = np.arange(len(lines)) * GOLDEN % 1
    strands = np.flatnonzero(lot < max(share, lot.min(initial=1) + 1e-12))
    if len(strands) == len(lines):
        return lines
    count = lines.count[strands]
    start = np.concatenate([[0], np.cumsum(count)])
    points = np.arange(start[-1]) + np.repeat(lines.start[strands] - start[:-1], count)
    whole = areas(lines)
    factor = whole.sum() / max(whole[strands].sum(), 1e-300)
    fewer = lines.take(points, start, strands)
    return replace(_widened(fewer, np.full(len(strands), factor)), key=f"{lines.key} {share:g} of all")


def _widened(lines: Lines, factor: np.ndarray) -> Lines:
    return replace(lines, radius=(lines.radius * factor[owners(lines.start)]).astype(np.float32))
