"""Lights a scene's surfels: by lamps, by the sky, and by each other, some bounces on."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator

import numpy as np

from ...core.indirect.sites import hashed
from ...core.indirect.surfels import Surfels
from ...core.indirect.tree import build_tree
from ...core.lod.levels import SIDE_AXES
from ...core.numeric.record import record
from ...core.scene.scene import Scene
from ..device.protocol import Device, Texture
from ..passes.indirect.pages import node_shapes, with_radiance
from ..passes.indirect.surfel_light import lit_surfels
from .known_sites import Slices
from .light import BakedLight, IndirectLight, coherent_rows, world_names

MOST_BOUNCE_RECEIVERS = 3000  # of either side, where light is gathered for further bounces
FEWER = 2  # times fewer receivers gather all that comes after the first bounce of lamps' light, which is even
LEAST_GAIN = 0.01  # of the light of surfels, below which what a bounce brings is the last
THINNER = 0.25  # along the normal
ALIKE = 0.9  # cosine between normals of surfels and of receivers next to theirs that light them, too
SMALLEST_SHARE = 10.0  # percent of surfels that are smaller than what is told apart
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32) / np.float32(3**0.5)
LIFTED = 0.05  # radii of a surfel, by which its receiver lies above it


@record
class BounceReceivers:
    """R of N surfels, at which light is gathered for all."""

    rows: np.ndarray  # (R,) int64: surfels
    others: np.ndarray  # (4, N) int64: receivers in whose cells, or next to these, each surfel lies
    weights: np.ndarray  # (4, N) float32, 1 together

    def spread(self, found: np.ndarray) -> np.ndarray:
        """Returns for all surfels (2, N, 3) what receivers have gathered, (2, R, 3)."""
        whole = np.zeros((2, self.others.shape[1], 3), np.float32)
        for other, weight in zip(self.others, self.weights, strict=True):
            whole += found[:, other] * weight[:, None]
        return whole


class Baker:
    """Lights surfels by lamps, by the sky and by each other, so many times; in steps, since it may take seconds."""

    def __init__(self, scene: Scene, surfels: Surfels, lighting: tuple[str, ...], bounces: int) -> None:
        """`lighting`: PS_ names of lamps, shadows and the sky."""
        self._scene, self._surfels, self._bounces = scene, surfels, bounces
        self._names = world_names(lighting)
        self._lamps = tuple(name for name in lighting if name not in self._names)
        self._tree = build_tree(surfels)
        self._shapes = node_shapes(self._tree)
        self._steps = self._in_steps()
        self._light: IndirectLight | None = None  # of the nodes that are gathered from

    @property
    def nbytes(self) -> int:
        """What counts against a limit: the arrays that it holds, about."""
        return 3 * self._shapes.nbytes

    def bake(
        self, device: Device, textures: dict[str, Texture], slices: Slices, check: Callable[[], None]
    ) -> BakedLight:
        """Returns the light. `textures`: what `lighting` reads, in the world from the surfels' origin.

        Cancelled: `slices` put the rest off, or `check` raised it, which is called between steps. Called once more, it
        goes on with the next, on the same device. DeviceError, ShaderError: the device cannot do it; all begins again.
        """
        # Those of the picture that asks: an earlier one's may be gone.
        self._device, self._textures, self._slices = device, textures, slices
        while True:
            try:
                next(self._steps)
            except StopIteration as end:
                self._steps = self._in_steps()
                return end.value
            except Exception:
                self._steps = self._in_steps()
                self._release()
                raise
            try:
                check()
                slices.check()
            except Exception:
                self._release()
                raise

    def _in_steps(self) -> Generator[None, None, BakedLight]:
        surfels, bounces = self._surfels, self._bounces
        leaving = np.broadcast_to(surfels.emission, (2, len(surfels), 3))
        if bounces == 0:
            return self._with(leaving)
        direct = self._direct()
        receivers = bounce_receivers(surfels, MOST_BOUNCE_RECEIVERS)
        at = surfels.take(receivers.rows)
        # What lamps light is bright in places: it is gathered together with the sky, so that it is a
        # bounce ahead of what the sky lights.
        lit = surfels.albedo * direct if bounces > 1 else np.zeros_like(direct)
        yield
        found, of_sky = yield from self._gathered(at, surfels.emission + lit, 1.0)
        total = surfels.emission + surfels.albedo * (direct + receivers.spread(found))
        # All further light is even, and gathered at fewer.
        fewer = bounce_receivers(at, MOST_BOUNCE_RECEIVERS // FEWER)
        some, gain = at.take(fewer.rows), found
        for number in range(1, bounces):
            sends = surfels.albedo * receivers.spread(gain)
            if number == bounces - 1:
                sends *= self._not_ahead(at, found, of_sky, lit)
            if _share(sends, total) < LEAST_GAIN:
                break
            gathered, _ = yield from self._gathered(some, sends, 0.0)
            gain = fewer.spread(gathered)
            total = total + surfels.albedo * receivers.spread(gain)
        return self._with(total)

    def _not_ahead(self, at: Surfels, found: np.ndarray, of_sky: np.ndarray, lit: np.ndarray) -> np.float32:
        """The share that the sky and what shines has in the first bounce; that of lamps is a bounce ahead."""
        sends = at.area * at.albedo.mean(axis=1)
        sky = float((sends * of_sky).sum() / max(float((sends * found.mean(axis=2)).sum()), 1e-30))
        shines, lamps = (float((self._surfels.area[:, None] * x).sum()) for x in (2 * self._surfels.emission, lit))
        return np.float32(sky + (1 - sky) * shines / max(shines + lamps, 1e-30))

    def _with(self, leaving: np.ndarray) -> BakedLight:
        """`leaving` (2, N, 3): radiance that leaves surfels, outside and inside."""
        radiance = self._tree.radiance(self._surfels, *leaving)
        return BakedLight(self._surfels.origin, with_radiance(self._shapes, radiance))

    def _direct(self) -> np.ndarray:
        """(2, N, 3): irradiance over pi by lamps, outside and inside."""
        surfels, lights = self._surfels, len(self._scene.lights)
        found = np.zeros((2, len(surfels), 3), np.float32)
        if not lights:
            return found
        for side, rows, position, normal, share in sides(surfels):
            lit = lit_surfels(self._device, self._lamps, lights, position, normal, self._textures)
            found[side, rows] += np.float32(share) * lit
        return found

    def _gathered(
        self, surfels: Surfels, leaving: np.ndarray, sky: float
    ) -> Generator[None, None, tuple[np.ndarray, np.ndarray]]:
        """Irradiance over pi, outside and inside of some surfels, by what leaves all and by `sky` times the world's
        light: (2, R, 3), and the mean of the world's part, (2, R)."""
        found = np.zeros((2, len(surfels), 4), np.float32)
        if not leaving.any() and not (self._names and sky):
            return found[..., :3], found[..., 3]
        nodes = self._with(leaving)
        for side, some, position, normal, share in sides(surfels):

            def bounced(rows: np.ndarray, place: np.ndarray = position, up: np.ndarray = normal) -> np.ndarray:
                return self._bounced(nodes, (place[rows], up[rows]), sky)

            left = np.argsort(coherent_rows(position, normal))
            while len(left):
                rows, light, left = self._slices.gathered(left, bounced)
                found[side, some[rows]] += np.float32(share) * light
                yield
        self._release()
        return found[..., :3], found[..., 3]

    def _bounced(self, nodes: BakedLight, at: tuple[np.ndarray, np.ndarray], sky: float) -> np.ndarray:
        """What is gathered at places with normals (n, 3): (n, 4) float32."""
        pictures = {name: texture for name, texture in self._textures.items() if name == "ps_environment"}
        if self._light is None:
            self._light = IndirectLight(self._device, nodes, self._scene.world, self._names)
        return self._light.bounced(*at, sky, pictures)

    def _release(self) -> None:
        """Frees what is on the device."""
        if self._light is not None:
            self._light.release()
        self._light = None


def _share(sends: np.ndarray, total: np.ndarray) -> float:
    """The share, mean over colours, that some of the light of surfels (2, N, 3) has in all of it."""
    of_all = total.sum(axis=(0, 2))
    return float((sends.sum(axis=(0, 2)) / np.maximum(of_all + np.median(of_all), 1e-30)).mean())


def bounce_receivers(surfels: Surfels, most: int) -> BounceReceivers:
    """Chooses about `most` sides of surfels, at which light is gathered for all."""
    turned = surfels.normal @ SIDE_AXES.astype(np.float32)
    face = np.abs(turned).argmax(axis=1)
    side = 2 * face + (turned[np.arange(len(face)), face] < 0)
    # Surfels are the larger the farther off they are, and so are the cells that share a receiver. These are
    # flat, thin along the axis that normals are turned to, so that surfaces behind one another do not share one.
    whole = surfels.area * np.where(surfels.half, 2, 1)
    size = np.sqrt(np.maximum(whole, np.percentile(whole, SMALLEST_SHARE)))
    across = np.exp2(np.ceil(np.log2(size)))[:, None]
    thin = np.where(np.abs(SIDE_AXES.T[face]) > 0.5, THINNER, 1.0)
    away = surfels.position - surfels.position.min(axis=0)
    scale = max((np.count_nonzero(~surfels.closed) + len(surfels)) / most, 1.0) ** 0.5
    while True:
        at = away / (scale * thin * across)
        cell = np.floor(at)
        key = hashed(np.column_stack([cell, side, across]))
        order = np.argsort(key, kind="stable")
        new = np.append(True, key[order][1:] != key[order][:-1])
        open_ones = np.count_nonzero(~surfels.closed[order][new])
        if np.count_nonzero(new) + open_ones <= most or not cell.any():
            break
        scale *= 1.25
    group = np.empty(len(key), np.int64)
    group[order] = np.cumsum(new) - 1
    # The surfel nearest to the middle of each.
    count = np.bincount(group)
    middle = np.stack([np.bincount(group, column) / count for column in surfels.position.T], axis=1)
    off = ((surfels.position - middle[group]) ** 2).sum(axis=1)
    rows = np.lexsort((off, group))[np.cumsum(count) - count]
    return _with_neighbours(surfels.normal, rows, group, key[order][new], at, face, np.column_stack([side, across]))


def _with_neighbours(
    normal: np.ndarray,
    rows: np.ndarray,
    group: np.ndarray,
    keys: np.ndarray,
    at: np.ndarray,
    face: np.ndarray,
    kind: np.ndarray,
) -> BounceReceivers:
    """Receivers `rows` (R,) of cells with keys (R,), rising, to which surfels of groups (N,) belong. `at` (N, 3):
    places in cells, in faces (N,) across the axes; `kind` (N, 2): what keys hold beside cells."""
    number = np.arange(len(group))
    ahead = np.where(at - np.floor(at) < 0.5, -1.0, 1.0)
    apart = np.abs(at - np.floor(at) - 0.5)
    first, second = (face + 1) % 3, (face + 2) % 3
    others, weights = [group], [(1 - apart[number, first]) * (1 - apart[number, second])]
    for steps in ((first,), (second,), (first, second)):
        cell, weight = np.floor(at), np.ones(len(group))
        for axis in (first, second):
            moved = any(axis is step for step in steps)
            cell[number, axis] += ahead[number, axis] if moved else 0
            weight *= apart[number, axis] if moved else 1 - apart[number, axis]
        wanted = hashed(np.column_stack([cell, kind]))
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        alike = (normal * normal[rows[found]]).sum(axis=1)
        others.append(found)
        weights.append(np.where((keys[found] == wanted) & (alike > ALIKE), weight, 0.0))
    total = np.stack(weights)
    # In the order of the surfels: that of keys depends on the unit of length.
    order = np.argsort(rows)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return BounceReceivers(rows[order], place[np.stack(others)], (total / total.sum(axis=0)).astype(np.float32))


def sides(surfels: Surfels) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, float]]:
    """Yields what light falls on: 0 outside or 1 inside, rows of surfels (n,), places and normals (n, 3) slightly above
    them, and the share that these have in the whole side.

    What has no normal is looked at from the four corners of a tetrahedron.
    """
    radius = np.sqrt(surfels.area / np.pi)[:, None]
    flat = surfels.normal.any(axis=1)
    for side, rows in ((0, np.flatnonzero(flat)), (1, np.flatnonzero(flat & ~surfels.closed))):
        if len(rows):
            normal = surfels.normal[rows] * np.float32(1 - 2 * side)
            yield side, rows, surfels.position[rows] + LIFTED * radius[rows] * normal, normal, 1.0
    rows = np.flatnonzero(~flat)
    for corner in TETRAHEDRON if len(rows) else ():
        normal = np.broadcast_to(corner, (len(rows), 3))
        # The area of a ball is four times that of its disk.
        yield 0, rows, surfels.position[rows] + 0.5 * radius[rows] * normal, normal, 0.25
