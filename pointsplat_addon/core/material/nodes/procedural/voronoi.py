"""The Voronoi texture: distances to pseudo-random points, one in each cell of a lattice (Worley 1996)."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from ....numeric.record import record
from ...expression import Expression, SampleInputs
from ..math_functions import smooth_step
from .blocks import by_columns
from .cells import Cells
from .fractals import MOST_DETAIL
from .noise import texture_points

EDGE = 0.0001  # square of the distance between two points that have an edge between them


@record
class Settings:
    """What all octaves have in common; parameters are (n,) or (1,) float32."""

    feature: str
    metric: str
    exponent: np.ndarray
    smoothness: np.ndarray
    randomness: np.ndarray
    congruential: bool


Found = tuple[np.ndarray, np.ndarray, np.ndarray]  # distance (n,), colour (3, n), position (D, n)


@lru_cache
def neighbours(dimensions: int, reach: int = 1) -> np.ndarray:
    """The steps (K, dimensions, 1) float32 to a cell's neighbours and itself, x the fastest."""
    steps = itertools.product(range(-reach, reach + 1), repeat=dimensions)
    return np.array([step[::-1] for step in steps], np.float32)[:, :, None]


def steps_to(index: np.ndarray, dimensions: int) -> np.ndarray:
    """Steps (dimensions, n) float32 by the indices (n,) uint8 of neighbours."""
    return np.ascontiguousarray(neighbours(dimensions)[:, :, 0].T).take(index, axis=1)


def measured(difference: np.ndarray, metric: str, exponent: np.ndarray) -> np.ndarray:
    """Lengths (n,) of vectors (D, n) by a metric: EUCLIDEAN, MANHATTAN, CHEBYCHEV or MINKOWSKI with an exponent."""
    if len(difference) == 1:
        return np.abs(difference[0])
    if metric == "EUCLIDEAN":
        return np.sqrt(_squared(difference))
    size = np.abs(difference)
    if metric == "MANHATTAN":
        return size.sum(axis=0)
    if metric == "CHEBYCHEV":
        return size.max(axis=0)
    return np.power(np.power(size, exponent).sum(axis=0), 1 / exponent)


def _squared(difference: np.ndarray) -> np.ndarray:
    total = difference[0] * difference[0]
    for row in difference[1:]:
        total += row * row
    return total


def _pick(condition: np.ndarray, a: np.ndarray | np.uint8, b: np.ndarray) -> np.ndarray:
    """a where the condition holds, else b, of indices (n,) uint8: without a branch, many times as fast as np.where."""
    return b + condition.view(np.uint8) * (a - b)


def _nearest(p: np.ndarray, s: Settings) -> Found:
    """Distance, colour and position of the nearest point, or of the second where the feature is F2."""
    cells, dimensions = Cells(p, s.congruential), len(p)
    distance = second = np.full(p.shape[1], np.inf, np.float32)
    index = second_index = np.zeros(p.shape[1], np.uint8)
    for number, step in enumerate(neighbours(dimensions)):
        away = measured(_points(cells, step, s) - cells.local, s.metric, s.exponent)
        nearer = away < distance
        if s.feature == "F2":
            second_index = _pick(nearer, index, _pick(away < second, np.uint8(number), second_index))
            second = np.minimum(second, np.maximum(distance, away))
        index = _pick(nearer, np.uint8(number), index)
        distance = np.minimum(distance, away)
    if s.feature == "F2":
        distance, index = second, second_index
    step = steps_to(index, dimensions)
    return distance, cells.colors(step), _points(cells, step, s) + cells.cell


def _points(cells: Cells, step: np.ndarray, s: Settings) -> np.ndarray:
    """The points (D, n) of cells a step away, from the corner of the cell in the middle."""
    return step + cells.points(step) * s.randomness


def _smooth_nearest(p: np.ndarray, s: Settings) -> Found:
    """Distance, colour and position blended near the borders of cells by smooth minima (Quilez)."""
    cells = Cells(p, s.congruential)
    distance = np.zeros(1, np.float32)
    color, point = np.zeros((3, 1), np.float32), np.zeros((len(p), 1), np.float32)
    zero, half, one = np.zeros(1, np.float32), np.float32(0.5), np.ones(1, np.float32)
    for number, step in enumerate(neighbours(len(p), reach=2)):
        random = cells.points(step)
        at = step + random * s.randomness
        away = measured(at - cells.local, s.metric, s.exponent)
        share = smooth_step(zero, one, half + half * (distance - away) / s.smoothness, 3) if number else one
        if not share.any():
            continue
        correction = s.smoothness * share * (1 - share)
        distance = distance + share * (away - distance) - correction
        correction = correction / (1 + 3 * s.smoothness)
        color = color + share * (cells.known_colors(step, random) - color) - correction
        point = point + share * (at - point) - correction
    return distance, color, point + cells.cell


def _found(p: np.ndarray, s: Settings) -> Found:
    """What one octave of F1, F2 or SMOOTH_F1 finds; without smoothness the last is F1."""
    sharp = s.smoothness == 0
    if s.feature != "SMOOTH_F1" or sharp.all():
        return _nearest(p, s)
    smooth = _smooth_nearest(p, s)
    if not sharp.any():
        return smooth
    distance, color, position = (np.where(sharp, a, b) for a, b in zip(_nearest(p, s), smooth, strict=True))
    return distance, color, position


def _closest(cells: Cells, s: Settings) -> tuple[np.ndarray, np.ndarray]:
    """The nearest points (D, n), from their middle cells' corners, and the steps (D, n) to their cells: Euclidean."""
    least = np.full(cells.local.shape[1], np.inf, np.float32)
    index = np.zeros(len(least), np.uint8)
    for number, step in enumerate(neighbours(len(cells.local))):
        square = _squared(_points(cells, step, s) - cells.local)
        index = _pick(square < least, np.uint8(number), index)
        least = np.minimum(least, square)
    step = steps_to(index, len(cells.local))
    return _points(cells, step, s), step


def _edge_distance(p: np.ndarray, s: Settings) -> np.ndarray:
    """Euclidean distance (n,) to the nearest border between two points' regions (Quilez)."""
    cells = Cells(p, s.congruential)
    closest = _closest(cells, s)[0] - cells.local
    distance = np.full(1, np.inf, np.float32)
    for step in neighbours(len(p)):
        vector = _points(cells, step, s) - cells.local
        across = vector - closest
        square = _squared(across)
        middle = ((vector + closest) * np.float32(0.5) * across).sum(axis=0) / np.sqrt(square)
        distance = np.where(square > np.float32(EDGE), np.minimum(distance, middle), distance)
    return distance


def _sphere_radius(p: np.ndarray, s: Settings) -> np.ndarray:
    """Half the distance (n,) between the nearest point and the one that is nearest to it."""
    cells = Cells(p, s.congruential)
    nearest, at_cell = _closest(cells, s)
    least = np.full(1, np.inf, np.float32)
    for step in neighbours(len(p)):
        if step.any():
            least = np.minimum(least, _squared(_points(cells, at_cell + step, s) - nearest))
    return np.sqrt(least) / 2


@record
class Voronoi(Expression):
    """Distance or radius, colour, position and W of the Voronoi texture, (N, 8), in this order.

    feature: F1, F2, SMOOTH_F1, DISTANCE_TO_EDGE (distance alone) or N_SPHERE_RADIUS (radius alone). metric: see
    `measured`. normalize: distances are divided by the largest possible one. Octaves of F1, F2 and SMOOTH_F1 add up,
    of DISTANCE_TO_EDGE the least counts; the radius has one.
    """

    vector: Expression
    w: Expression
    scale: Expression
    detail: Expression
    roughness: Expression
    lacunarity: Expression
    smoothness: Expression
    exponent: Expression
    randomness: Expression
    dimensions: int = 3
    feature: str = "F1"
    metric: str = "EUCLIDEAN"
    normalize: bool = False
    congruential: bool = True  # the cells' hash: that of Blender 5, else of Blender 4

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        alone = self.feature in ("DISTANCE_TO_EDGE", "N_SPHERE_RADIUS")
        return by_columns(self._columns, 1 if alone else 8, *values)

    def _columns(
        self, vector: np.ndarray, w: np.ndarray, scale: np.ndarray, *rest: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        detail, roughness, lacunarity, smoothness, exponent, randomness = (a[0] for a in rest)
        p = texture_points(vector, w, self.dimensions) * scale
        settings = Settings(
            self.feature,
            self.metric,
            exponent,
            np.clip(smoothness / 2, 0, np.float32(0.5)),
            np.clip(randomness, 0, 1),
            self.congruential,
        )
        if self.feature == "N_SPHERE_RADIUS":
            return (_sphere_radius(p, settings),)
        detail, roughness = np.clip(detail, 0, np.float32(MOST_DETAIL)), np.clip(roughness, 0, 1)
        detail = np.where(roughness == 0, np.float32(0), detail)
        if self.feature == "DISTANCE_TO_EDGE":
            return (self._edge_octaves(p, settings, detail, roughness, lacunarity),)
        distance, color, position = self._octaves(p, settings, detail, roughness, lacunarity)
        position = np.where(scale != 0, position / np.where(scale != 0, scale, 1), 0)
        d = self.dimensions
        zero = np.zeros(1, np.float32)
        xyz = [position[k] if k < d and d > 1 else zero for k in range(3)]
        return distance, *color, *xyz, position[-1] if d in (1, 4) else zero

    def _octaves(
        self, p: np.ndarray, s: Settings, detail: np.ndarray, roughness: np.ndarray, lacunarity: np.ndarray
    ) -> Found:
        scale = amplitude = np.ones(1, np.float32)
        largest = distance = np.zeros(1, np.float32)
        color, position = np.zeros((3, 1), np.float32), np.zeros((len(p), 1), np.float32)
        for octave in range(1 + int(np.ceil(detail.max(initial=0)))):
            share = np.clip(detail - (octave - 1), 0, 1) if octave else np.ones(1, np.float32)
            found = _found(p * scale, s)
            largest = largest + share * amplitude
            distance = distance + share * (found[0] * amplitude)
            color = color + share * (found[1] * amplitude)
            position = position + share * amplitude * (found[2] / scale - position)
            scale = scale * lacunarity
            amplitude = amplitude * roughness
        if self.normalize:
            distance = distance / (largest * self._largest(s))
            color = color / largest
        return distance, color, position

    def _largest(self, s: Settings) -> np.ndarray:
        """The largest distance that the feature can have."""
        half = np.float32(0.5)
        if self.feature == "DISTANCE_TO_EDGE":
            return half + half * s.randomness
        corner = np.broadcast_to(half + half * s.randomness, (self.dimensions, len(s.randomness)))
        return measured(corner, self.metric, s.exponent) * (2 if self.feature == "F2" else 1)

    def _edge_octaves(
        self, p: np.ndarray, s: Settings, detail: np.ndarray, roughness: np.ndarray, lacunarity: np.ndarray
    ) -> np.ndarray:
        scale = amplitude = np.ones(1, np.float32)
        most = largest = self._largest(s)
        distance = None
        for octave in range(1 + int(np.ceil(detail.max(initial=0)))):
            share = np.clip(detail - (octave - 1), 0, 1) if octave else np.ones(1, np.float32)
            found = _edge_distance(p * scale, s)
            if distance is None:
                distance = found
            else:
                least = distance + amplitude * (np.minimum(distance, found / scale) - distance)
                distance = distance + share * (np.minimum(distance, least) - distance)
                largest = largest + share * amplitude * (most / scale - largest)
            scale = scale * lacunarity
            amplitude = amplitude * roughness
        assert distance is not None
        return distance / largest if self.normalize else distance
