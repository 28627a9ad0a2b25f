"""What sharp mirrors show: a ray for each group of sub-samples, and the light that leaves what it meets.

Rays of neighbouring groups take different parts of a lobe, and each group shows what all around it have met
(shaders/indirect/reflect.frag). Where few of these lie in its lobe and show different light, it traces more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from ....core.indirect.lobes import SIDE, half_vectors, parts_of_lobes
from ....core.numeric.record import record
from ....core.numeric.vectors import unit_rows
from ...indirect.light import coherent_rows
from ...indirect.traced import Hits, SceneTriangles, is_traced
from ...passes.indirect.trace import TracedTriangles
from ...passes.uniforms import SampleView
from .hits import HitShading, Lit, Mirrored
from .receivers import Groups, directions_to_eye

LIFT = 1e-4  # of the distance from the eye: rays begin so far above what mirrors
ALIKE = 0.8  # cosine between normals of pixels that may show one surface
MOST_CUT = 16  # surfaces that a ray passes where alpha cuts them out
PAST = 1e-4  # of the length of a ray, by which it goes on beyond these
AGAIN = 2  # times that what rays meet mirrors something sharply, too; further times it shows it as cells do
LEAST_RISE = 0.01  # sine of the angle at which what mirrors other mirrors reflects at least above its plane
FEW = 2.0  # alpha over the turn of a half vector from a pixel to the next, below which few neighbours lie in a lobe
CONTRAST = 0.05  # of light and 0.3 together, between what pixels show, from which on more rays are traced
# Pixels beside a group at which further rays are traced: no two in one row or column.
MORE = (np.stack([np.arange(8), [3, 6, 0, 5, 1, 7, 2, 4]], axis=1) + 0.5) / 8 - 0.5
SHUFFLED = np.array([4, 0, 6, 2, 7, 3, 1, 5])
# By which further rays take other parts of a lobe (Roberts 2018).
TURN_OF_PARTS = np.array([0.7548776662466927, 0.5698402909980532])
AROUND = tuple(product((-1, 0, 1), repeat=2))
PARTS = 4  # of a lobe that two rays of neighbouring groups are apart, about, over its width


class TracedScene:
    """A scene's triangles, and on the device the tree of them."""

    def __init__(self, triangles: SceneTriangles | None, tree: TracedTriangles | None) -> None:
        """None: there are none, or too many."""
        self.triangles, self.tree = triangles, tree

    def release(self) -> None:
        if self.tree is not None:
            self.tree.release()


@record
class Reflecting:
    """Groups that mirror."""

    position: np.ndarray  # (N, 3) float64, from the eye
    to_eye: np.ndarray  # (N, 3), unit
    normal: np.ndarray  # (N, 3), unit: of what mirrors
    bends: np.ndarray  # (N, 2, 3): change of the normal from a pixel to the next, along x and y
    above: np.ndarray  # (N,): how far above its place rays begin
    alpha: np.ndarray  # (N,)
    depth: np.ndarray  # (N,)
    pixel: np.ndarray  # (N,) int64

    def take(self, rows: np.ndarray) -> Reflecting:
        return replace(self, **{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


@record
class Shown:
    """What n groups show by rays."""

    rows: np.ndarray  # (n,) int64: groups
    light: np.ndarray  # (K, n, 4) float32, of each ray: radiance of surfaces; 1 where there are none
    ends: np.ndarray  # (K, n, 4) float32: see shaders/indirect/reflect.frag; zeros: a group has no further rays
    kinds: np.ndarray  # (n, 2) float32: likewise
    count: np.ndarray  # (n,) float32: how many of the K rays each has


class Mirrors:
    """Shows sharp mirrors what is around them."""

    def __init__(self, traced: Callable[[], TracedScene], shading: HitShading, others: bool) -> None:
        """`traced`: makes the tree when first something is mirrored, or returns it. `others`: there are things beside
        triangles, which rays pass."""
        self._traced, self._shading, self.others = traced, shading, others

    def trace(self, groups: Groups, roughness: np.ndarray) -> bool:
        """Whether `shown` may be called: some group mirrors sharply, and there is what rays may meet."""
        return bool(((is_traced(roughness) > 0) & (groups.depth != 0)).any()) and self._traced().tree is not None

    def shown(
        self,
        view: SampleView,
        groups: Groups,
        roughness: np.ndarray,
        ray: np.ndarray,
        beyond: np.ndarray | None,
        lit: Lit,
    ) -> Shown:
        """Returns what groups show by rays.

        roughness (N,): < 0: nothing is mirrored. ray: (N, 4), mirrored views in the world, and how far what groups
        stand for bulges above their planes. beyond: (N, 4), what groups mirror where rays meet nothing; None: the
        world.
        """
        share = is_traced(roughness)
        rows = np.flatnonzero((share > 0) & (groups.depth != 0))
        traced = self._traced()
        position = groups.position[rows] - groups.eye
        to_eye = directions_to_eye(view, position)
        normal = unit_rows(to_eye + ray[rows, :3])
        depth = groups.depth[rows].astype(np.float64)
        alpha = np.maximum(roughness[rows].astype(np.float64), 0) ** 2
        of = Reflecting(
            position, to_eye, normal, bends(view, groups)[rows], ray[rows, 3] + LIFT * depth, alpha, depth,
            groups.pixel[rows],
        )  # fmt: skip
        row, column = np.divmod(of.pixel, view.size[0])
        parts = parts_of_lobes(column, row)
        light, ends = self._traced_light(view, traced, groups.eye, of, np.zeros((len(rows), 2)), parts, lit, AGAIN)
        turn = _turn(view, of, ends)
        narrow, few = alpha < turn, alpha < FEW * turn
        lights, all_ends = [light], [ends]
        differs = few & _contrasts(view, of.pixel, light)
        # Of rough mirrors by squares, or rare rays that meet something bright would be those to which others are added.
        jagged = np.flatnonzero(differs | (few & (alpha > 0) & _in_squares(view, of.pixel, differs)))
        if len(jagged):
            count, again = len(jagged), np.tile(jagged, len(MORE))
            number = np.repeat(np.arange(len(MORE)), count)
            within = (parts[again] + (number + 1)[:, None] * TURN_OF_PARTS) % 1.0
            # Those that count alone are a whole lobe together, without its rim, for which one in 64 may stand but not
            # one in 8.
            order = SHUFFLED[(number + (len(MORE) * parts[again, 0]).astype(np.int64)) % len(MORE)]
            within[:, 0] = np.where(narrow[again], (order + 0.5) / len(MORE), within[:, 0])
            more = self._traced_light(
                view, traced, groups.eye, of.take(again), np.repeat(MORE, count, axis=0),
                within, lit, AGAIN,
            )  # fmt: skip
            found, found_ends = (one.reshape(len(MORE), count, 4) for one in more)
            light[jagged[narrow[jagged]]] = found.mean(axis=0)[narrow[jagged]]
            for own, own_ends in zip(found, found_ends, strict=True):
                lights.append(np.zeros_like(light))
                all_ends.append(np.zeros_like(ends))
                lights[-1][jagged], all_ends[-1][jagged] = own, own_ends
            # Groups count alike, however many rays they have.
            for own_ends in all_ends:
                own_ends[jagged, 3] *= len(all_ends)
        if beyond is not None:
            for own in lights:
                own[:, :] = own[:, :] * [1, 1, 1, 0] + own[:, 3:] * beyond[rows]
        kinds = np.column_stack([share[rows], np.where(narrow, 0, alpha)]).astype(np.float32)
        count = np.ones(len(rows), np.float32)
        count[jagged] = len(lights)
        return Shown(rows, np.stack(lights), np.stack(all_ends), kinds, count)

    def _first_met(
        self, traced: TracedScene, origin: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As TracedTriangles.trace, past what alpha cuts out."""
        assert traced.tree is not None
        assert traced.triangles is not None
        triangle, distance, weights = traced.tree.trace(origin, direction, coherent_rows(origin, direction))
        rows = np.flatnonzero(triangle >= 0)
        for _ in range(MOST_CUT):
            rows = rows[self._shading.cut_out(traced.triangles, triangle[rows], weights[rows])]
            if not len(rows):
                break
            begun = distance[rows] * (1 + PAST)
            place = origin[rows] + begun[:, None] * direction[rows]
            found = traced.tree.trace(place, direction[rows], coherent_rows(place, direction[rows]))
            triangle[rows], weights[rows] = found[0], found[2]
            distance[rows] = begun + found[1]
            rows = rows[triangle[rows] >= 0]
        return triangle, distance, weights

    def _traced_light(
        self,
        view: SampleView,
        traced: TracedScene,
        eye: np.ndarray,
        of: Reflecting,
        offset: np.ndarray,
        parts: np.ndarray,
        lit: Lit,
        again: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Traces a ray of each group, `offset` (N, 2) pixels beside it, in a part of its lobe: `light` and `ends` of
        Shown. `again`: how often what they meet mirrors something sharply, too."""
        assert traced.tree is not None
        assert traced.triangles is not None
        pixel = 1 / view.camera.pixel_from_view()[0]
        place, to_eye, mirror = _moved(view, of, offset)
        half = np.where(of.alpha[:, None] > 0, half_vectors(mirror, to_eye, of.alpha, parts), mirror)
        direction = 2 * (half * to_eye).sum(axis=1, keepdims=True) * half - to_eye
        below = (direction * mirror).sum(axis=1) <= 0
        half[below] = mirror[below]
        direction[below] = (2 * (mirror * to_eye).sum(axis=1, keepdims=True) * mirror - to_eye)[below]
        place = place + of.above[:, None] * mirror
        origin = place + eye
        triangle, distance, weights = self._first_met(traced, origin, direction)
        light = np.zeros((len(origin), 4), np.float32)
        met = triangle >= 0
        light[~met, 3] = 1
        end = np.where(met[:, None], place + np.where(met, distance, 0)[:, None] * direction, direction)
        if met.any():
            some, away = of.take(np.flatnonzero(met)), distance[met].astype(np.float64)
            perspective = view.camera.perspective
            across = pixel * (some.depth if perspective else 1.0)
            turns = 2 * np.linalg.norm(some.bends, axis=2).max(axis=1) + (pixel if perspective else 0.0)
            whole = turns + 4 * some.alpha
            width = across + (turns + 4 * some.alpha / PARTS) * away
            hits = Hits(triangle[met], weights[met], direction[met], width, across + whole * away, whole)
            seen = Groups(eye, origin[met], some.normal, (width / pixel).astype(np.float32), some.pixel)

            def mirrored(met: Groups, roughness: np.ndarray, plane: np.ndarray, to_eye: np.ndarray) -> Mirrored | None:
                return self._mirrored(view, traced, met, roughness, plane, to_eye, lit, again)

            deeper = mirrored if again else None
            light[met, :3] = self._shading.shade(view, traced.triangles, hits, end[met], seen, lit, deeper)
        cosine = (half * mirror).sum(axis=1)
        density = of.alpha**2 / np.maximum((cosine**2 * (of.alpha**2 - 1) + 1) ** 2, 1e-20)
        density = np.where(of.alpha > 0, density, 1)
        return light, np.column_stack([end, np.where(met, density, -density)]).astype(np.float32)

    def _mirrored(
        self,
        view: SampleView,
        traced: TracedScene,
        groups: Groups,
        roughness: np.ndarray,
        plane: np.ndarray,
        to_eye: np.ndarray,
        lit: Lit,
        again: int,
    ) -> Mirrored | None:
        """Returns what groups mirror that are seen by way of mirrors. plane, to_eye: (N, 3), unit."""
        share = is_traced(roughness)
        rows = np.flatnonzero(share > 0)
        if not len(rows):
            return None
        to_eye, plane, normal = (one[rows].astype(np.float64) for one in (to_eye, plane, groups.normal))
        direction = 2 * (normal * to_eye).sum(axis=1, keepdims=True) * normal - to_eye
        direction += np.maximum(LEAST_RISE - (direction * plane).sum(axis=1), 0)[:, None] * plane
        depth = groups.depth[rows].astype(np.float64)
        of = Reflecting(
            groups.position[rows] - groups.eye, to_eye, unit_rows(unit_rows(direction) + to_eye),
            np.zeros((len(rows), 2, 3)), LIFT * depth, np.maximum(roughness[rows].astype(np.float64), 0) ** 2, depth,
            groups.pixel[rows],
        )  # fmt: skip
        row, column = np.divmod(of.pixel, view.size[0])
        parts = (parts_of_lobes(column, row)[:, ::-1] + again * TURN_OF_PARTS) % 1.0
        off = np.zeros((len(rows), 2))
        light, _ = self._traced_light(view, traced, groups.eye, of, off, parts, lit, again - 1)
        return rows, light, share[rows]


def _turn(view: SampleView, of: Reflecting, ends: np.ndarray) -> np.ndarray:
    """(N,) radians: by how much half vectors turn from a pixel to the next, towards the nearest of what rays around
    have met, `ends` (N, 4) of Shown."""
    turn = np.linalg.norm(of.bends, axis=2).max(axis=1)
    if not view.camera.perspective:
        return turn
    # Not what its own ray has met: a group would have further rays, or none, by what these ought to tell.
    wide, high = view.size
    columns, rows = -(-wide // SIDE) + 2, -(-high // SIDE) + 2
    row, column = np.divmod(of.pixel, wide)
    square = (row // SIDE + 1) * columns + column // SIDE + 1
    away = np.linalg.norm(ends[:, :3] - of.position, axis=1) / of.depth
    least = np.full(rows * columns, np.inf)
    np.minimum.at(least, square, np.where(ends[:, 3] < 0, np.inf, away))
    near = 1 / np.maximum(np.min([least[square + y * columns + x] for y, x in AROUND], axis=0), 1e-3)
    return turn + 0.5 * (1 + near) / view.camera.pixel_from_view()[0]


def _moved(view: SampleView, of: Reflecting, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places from the eye, directions to it, and normals, (N, 3) each, `offset` (N, 2) pixels beside groups."""
    if not offset.any():
        return of.position, of.to_eye, of.normal
    step = np.column_stack([offset / np.array(view.camera.pixel_from_view()[:2]), np.zeros(len(offset))])
    step = step @ view.world_from_view[:3, :3].T
    perspective = view.camera.perspective
    ahead = of.position + step * (of.depth[:, None] if perspective else 1.0)
    along = ahead if perspective else -of.to_eye
    slope = (along * of.normal).sum(axis=1)
    off = ((of.position - ahead) * of.normal).sum(axis=1)
    with np.errstate(all="ignore"):
        farther = np.where(np.abs(slope) > 1e-3 * np.linalg.norm(along, axis=1), off / slope, 0)
    place = ahead + farther[:, None] * along
    normal = unit_rows(of.normal + np.einsum("na,nac->nc", offset, of.bends))
    return place, directions_to_eye(view, place), normal


def bends(view: SampleView, groups: Groups) -> np.ndarray:
    """(N, 2, 3) float32: by how much normals of groups change from a pixel to the next, along x and y; of those whose
    neighbours show other surfaces 0."""
    width, height = view.size
    normals = np.zeros((height + 2, width + 2, 3), np.float32)
    there = np.flatnonzero(groups.depth != 0)
    row, column = np.divmod(groups.pixel[there], width)
    own = groups.normal[there]
    normals[row + 1, column + 1] = own
    found = np.zeros((len(groups.depth), 2, 3), np.float32)
    for axis, (across, up) in enumerate(((1, 0), (0, 1))):
        least = np.full(len(there), np.inf, np.float32)
        change = np.zeros_like(own)
        for sign in (-1, 1):
            other = normals[row + 1 + sign * up, column + 1 + sign * across]
            size = np.linalg.norm(other - own, axis=1)
            nearer = ((other * own).sum(axis=1) > ALIKE) & (size < least)
            change[nearer] = sign * (other - own)[nearer]
            least[nearer] = size[nearer]
        found[there, axis] = change
    return found


def _in_squares(view: SampleView, pixel: np.ndarray, some: np.ndarray) -> np.ndarray:
    """(N,) bool: groups of pixels in squares that take all parts of a lobe, in which there are some (N,) bool."""
    wide, high = view.size
    row, column = np.divmod(pixel, wide)
    square = (row // SIDE) * (-(-wide // SIDE)) + column // SIDE
    found = np.zeros((-(-high // SIDE)) * (-(-wide // SIDE)), bool)
    found[square[some]] = True
    return found[square]


def _contrasts(view: SampleView, pixel: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(N,) bool: groups of pixels that show other light (N, 4) than those beside them."""
    width, height = view.size
    shown = np.full((height + 2, width + 2, 4), np.nan, np.float32)
    row, column = np.divmod(pixel, width)
    shown[row + 1, column + 1] = light
    found = np.zeros(len(pixel), bool)
    for y, x in AROUND:
        other = shown[row + 1 + y, column + 1 + x]
        with np.errstate(invalid="ignore"):
            found |= (np.abs(other - light) > CONTRAST * (0.3 + np.maximum(other, light))).any(axis=1)
    return found
