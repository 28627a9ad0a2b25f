"""Lights a scene's surfels and media: by lamps, by the sky, and by each other, some bounces on."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

import numpy as np

from ...core.indirect.closed import scrambled
from ...core.indirect.media import MediaGrid
from ...core.indirect.sites import PRIMES, cell_keys
from ...core.indirect.surfels import Surfels
from ...core.indirect.tree import build_tree
from ...core.lod.levels import SIDE_AXES
from ...core.numeric.record import record
from ...core.numeric.vectors import dot, each_block
from ...core.scene.scene import Scene
from ..device.protocol import Device, Texture
from ..passes.indirect.pages import node_shapes, with_radiance
from ..passes.indirect.surfel_light import lit_surfels
from .known_sites import Slices
from .light import BakedLight, IndirectLight, coherent_rows, world_names
from .media import baked_media

MOST_BOUNCE_RECEIVERS = 3000  # of either side, where light is gathered for further bounces
FEWER = 2  # times fewer receivers gather all that comes after the first bounce of lamps' light, which is even
LEAST_GAIN = 0.01  # of the light of surfels, below which what a bounce brings is the last
LEAST_GAIN_OF_MEDIA = 0.005  # below which bounces in media are taken to become less evenly
MOST_LEFT = 0.98  # of a bounce, in the next one
THINNER = 0.25  # along the normal
ALIKE = 0.9  # cosine between normals of surfels and of receivers next to theirs that light them, too
GROWTH = 1.1  # of cells, from step to step
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
        """Returns for all surfels (2, N, C) what receivers have gathered, (2, R, C)."""
        channels = np.moveaxis(found, 1, 2).reshape(2 * found.shape[2], found.shape[1])
        whole = np.zeros((len(channels), self.others.shape[1]), np.float32)
        # Channel by channel, which stay in the processor's cache.
        for out, channel in zip(whole, np.ascontiguousarray(channels, np.float32), strict=True):
            for other, weight in zip(self.others, self.weights, strict=True):
                out += channel.take(other) * weight
        return np.moveaxis(whole.reshape(2, found.shape[2], self.others.shape[1]), 2, 1)


@record
class Leaving:
    """What is sent: by N surfels, and by C cells of media."""

    surfels: np.ndarray  # (2, N, 3) float32: radiance, outside and inside
    media: np.ndarray  # (C, 3) float32: radiance per unit of length; C is 0 where there are none

    def __add__(self, other: Leaving) -> Leaving:
        return Leaving(self.surfels + other.surfels, self.media + other.media)


@record
class Received:
    """What falls on R sides of surfels and on M receivers in media, with the mean of the world's part in it."""

    surfels: np.ndarray  # (2, R, 4) float32: irradiance over pi, outside and inside
    media: np.ndarray  # (M, 4) float32: mean radiance


class Baker:
    """Lights surfels and media by lamps, by the sky and by each other, so many times; in steps, since it may take
    seconds."""

    def __init__(
        self,
        scene: Scene,
        surfels: Surfels,
        lighting: tuple[str, ...],
        bounces: int,
        media: MediaGrid | None = None,
        apart: np.ndarray | None = None,
    ) -> None:
        """`lighting`: PS_ names of lamps, shadows and the sky. `apart` (N,): smaller surfels count as that large where
        receivers are chosen; None: all count as large as they are."""
        self._scene, self._surfels, self._bounces, self._media = scene, surfels, bounces, media
        self._apart = np.zeros(len(surfels)) if apart is None else apart
        self._receiving = surfels.receiving
        self._names = world_names(lighting)
        self._lamps = tuple(name for name in lighting if name not in self._names)
        self._tree = build_tree(surfels) if len(surfels) else None
        self._shapes = np.zeros((0, 16), np.float32) if self._tree is None else node_shapes(self._tree)
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
        bounces = self._bounces
        shines = Leaving(np.broadcast_to(self._surfels.emission, (2, len(self._surfels), 3)), self._shining)
        if bounces == 0:
            return (yield from self._finished(shines))
        direct = self._direct()
        lit_ones, lit_apart = self._surfels.take(self._receiving), self._apart[self._receiving]
        receivers = bounce_receivers(lit_ones, MOST_BOUNCE_RECEIVERS, lit_apart)
        at = lit_ones.take(receivers.rows)
        # What lamps light is bright in places: it is gathered together with the sky, so that it is a
        # bounce ahead of what the sky lights.
        lit = direct if bounces > 1 else Leaving(np.zeros_like(direct.surfels), np.zeros_like(direct.media))
        yield
        found = yield from self._gathered(at, shines + lit, 1.0)
        sends = self._scattered(receivers, found, shines + lit)
        total = shines + direct + sends
        # All further light is even, and gathered at fewer.
        fewer = bounce_receivers(at, MOST_BOUNCE_RECEIVERS // FEWER, lit_apart[receivers.rows])
        some, gain, now = at.take(fewer.rows), found, np.zeros(3)
        falls = [found.surfels[..., :3]]
        for number in range(1, bounces):
            if number == bounces - 1:
                sends = self._not_ahead(sends, at, found, shines, lit)
            of_media = (_share(*(of.media[None, :, k : k + 1] for of in (sends, total))) for k in range(3))
            shares = _share(sends.surfels, total.surfels), max(of_media)
            before, now = now, sends.media.sum(axis=0, dtype=float)
            if shares[0] < LEAST_GAIN and shares[1] < LEAST_GAIN_OF_MEDIA:
                ratio = np.where(before > 0, np.minimum(now / np.maximum(before, 1e-30), MOST_LEFT), 0.0)
                left = ratio * (1 - ratio ** (bounces - number)) / (1 - ratio)
                total = Leaving(total.surfels, total.media + left.astype(np.float32) * sends.media)
                break
            gathered = yield from self._gathered(some, sends, 0.0)
            gain = Received(fewer.spread(gathered.surfels), gathered.media)
            sends = self._scattered(receivers, gain, sends)
            total = total + sends
            falls.append(gain.surfels[..., :3])
        baked = yield from self._finished(total)
        apart = np.bincount(receivers.others[0], lit_ones.area, len(receivers.rows)) ** 0.5
        return replace(baked, received=_received(at, apart, falls))

    @property
    def _shining(self) -> np.ndarray:
        """(C, 3): what cells of media emit."""
        return np.zeros((0, 3), np.float32) if self._media is None else self._media.emission

    def _scattered(self, receivers: BounceReceivers, found: Received, sent: Leaving) -> Leaving:
        """What is sent on of light that falls on receivers, and of what has been `sent` by surfels and falls on them
        again."""
        media = self._media
        spread, rows = receivers.spread(found.surfels[..., :3]), self._receiving
        if len(rows) < len(self._surfels):
            falls = np.zeros((2, len(self._surfels), 3), np.float32)
            falls[:, rows] = spread
            spread = falls
        of_surfels = self._surfels.albedo * self._with_returned(spread, sent.surfels)
        if media is None:
            return Leaving(of_surfels, self._shining)
        return Leaving(of_surfels, media.scattering * media.in_cells(media.on_blocks(found.media[:, :3])))

    def _with_returned(self, falls: np.ndarray, sent: np.ndarray | float) -> np.ndarray:
        """(2, N, 3): what falls on surfels, by what falls on the plane of each, and by what it has sent before."""
        if (returned := self._surfels.returned) is None:
            return falls
        return falls + returned[:, None] * (sent - falls)

    def _not_ahead(self, sends: Leaving, at: Surfels, found: Received, shines: Leaving, lit: Leaving) -> Leaving:
        """The share that the sky and what shines has in the first bounce; that of lamps is a bounce ahead."""
        of_surfels = self._surfels.area[:, None]
        weight = at.area * at.albedo.mean(axis=1)
        some = _not_of_lamps(found.surfels, weight, of_surfels * shines.surfels, of_surfels * lit.surfels)
        others = _not_of_lamps(found.media, np.ones(len(found.media)), shines.media, lit.media)
        return Leaving(np.float32(some) * sends.surfels, np.float32(others) * sends.media)

    def _finished(self, leaving: Leaving) -> Generator[None, None, BakedLight]:
        """All light, with what falls on media at last."""
        if self._media is None:
            return self._with(leaving)
        found = yield from self._gathered(self._surfels.take(np.zeros(0, np.int64)), leaving, 1.0)
        return self._with(leaving, found.media[:, :3])

    def _with(self, leaving: Leaving, in_media: np.ndarray | None = None) -> BakedLight:
        """in_media (M, 3): mean radiance at receivers there."""
        nodes, media = self._shapes, None
        if self._tree is not None:
            nodes = with_radiance(self._shapes, self._tree.radiance(self._surfels, *leaving.surfels))
        if (grid := self._media) is not None:
            none = np.zeros((len(grid.receivers), 3), np.float32)
            media = baked_media(grid, leaving.media, none if in_media is None else in_media)
        cube = np.zeros(4, np.float32) if self._tree is None else self._tree.cube
        return BakedLight(self._surfels.origin, nodes, cube, media)

    def _direct(self) -> Leaving:
        """What is sent on of the light of lamps."""
        surfels, media, lights = self._surfels, self._media, len(self._scene.lights)
        found = np.zeros((2, len(surfels), 3), np.float32)
        sent = np.zeros_like(self._shining)
        if lights:
            for side, some, position, normal, share in sides(surfels.take(self._receiving)):
                rows = self._receiving[some]
                lit = lit_surfels(self._device, self._lamps, lights, position, normal, self._textures)
                found[side, rows] += np.float32(share) * lit
        if lights and media is not None:
            cells = media.lit_cells
            lit = np.zeros((len(cells), 3), np.float32)
            parts = media.parts(len(cells))
            for at in parts:
                place = (media.centres(cells) + at).astype(np.float32)
                up = np.ones_like(place)
                lit += lit_surfels(self._device, self._lamps, lights, place, up, self._textures, True)
            sent[cells] = media.lit[cells] * lit / np.float32(len(parts))
        return Leaving(surfels.albedo * self._with_returned(found, 0.0), sent)

    def _gathered(self, surfels: Surfels, leaving: Leaving, sky: float) -> Generator[None, None, Received]:
        """What falls on some surfels, and on receivers in media, of what leaves all and of `sky` times the world's
        light."""
        places = np.zeros((0, 3)) if self._media is None else self._media.places
        found = np.zeros((2, len(surfels), 4), np.float32)
        in_media = np.zeros((len(places), 4), np.float32)
        if not leaving.surfels.any() and not leaving.media.any() and not (self._names and sky):
            return Received(found, in_media)
        nodes = self._with(leaving)
        for side, some, position, normal, share in sides(surfels):

            def bounced(rows: np.ndarray, place: np.ndarray = position, up: np.ndarray = normal) -> np.ndarray:
                light, pictures = self._of(nodes)
                return light.bounced(place[rows], up[rows], sky, pictures)

            left = np.argsort(coherent_rows(position, normal))
            while len(left):
                rows, light, left = self._slices.gathered(left, bounced)
                found[side, some[rows]] += np.float32(share) * light
                yield

        def within(rows: np.ndarray) -> np.ndarray:
            light, pictures = self._of(nodes)
            return light.within_media(places[rows], sky, pictures)

        left = np.argsort(coherent_rows(places, np.ones_like(places)))
        while len(left):
            rows, light, left = self._slices.gathered(left, within)
            in_media[rows] = light
            yield
        self._release()
        return Received(found, in_media)

    def _of(self, nodes: BakedLight) -> tuple[IndirectLight, dict[str, Texture]]:
        """What is gathered from, and the world's picture."""
        if self._light is None:
            self._light = IndirectLight(self._device, nodes, self._scene.world, self._names)
        return self._light, {name: texture for name, texture in self._textures.items() if name == "ps_environment"}

    def _release(self) -> None:
        """Frees what is on the device."""
        if self._light is not None:
            self._light.release()
        self._light = None


def _received(at: Surfels, apart: np.ndarray, falls: list[np.ndarray]) -> np.ndarray:
    """(K, 10) float32: `received` of BakedLight, by what falls on receivers (R,), which are `apart` (R,): the sum of
    `falls` (2, R, 3), and of one more, which gathers of pictures add."""
    if len(falls) < 2:
        return np.zeros((0, 10), np.float32)  # lamps' light would be missing
    before, last = (float(one.sum(dtype=float)) for one in falls[-2:])
    more = min(last / max(before, 1e-30), MOST_LEFT)
    light = np.sum(falls, axis=0) + np.float32(more) * falls[-1]
    level = np.ceil(np.log2(np.maximum(apart, 1e-30)))
    parts = []
    for side, shown in ((0, slice(None)), (1, ~at.closed & at.normal.any(axis=1))):
        normal = (1 - 2 * side) * at.normal[shown]
        parts.append(np.column_stack([at.position[shown], normal, light[side][shown], level[shown]]))
    return np.concatenate(parts).astype(np.float32)


def _not_of_lamps(found: np.ndarray, weight: np.ndarray, shines: np.ndarray, lit: np.ndarray) -> float:
    """The share of light (..., 4), weighed by (...), that is not of lamps: of the world, or of what shines itself."""
    sky = float((weight * found[..., 3]).sum() / max(float((weight * found[..., :3].mean(axis=-1)).sum()), 1e-30))
    shining, lamps = float(shines.sum(dtype=float)), float(lit.sum(dtype=float))
    return sky + (1 - sky) * shining / max(shining + lamps, 1e-30)


def _share(sends: np.ndarray, total: np.ndarray) -> float:
    """The share, mean over colours, that some of the light of surfels (2, N, 3) has in all of it."""
    if total.size == 0:
        return 0.0
    of_all = total.sum(axis=(0, 2))
    return float((sends.sum(axis=(0, 2)) / np.maximum(of_all + np.median(of_all), 1e-30)).mean())


def bounce_receivers(surfels: Surfels, most: int, apart: np.ndarray) -> BounceReceivers:
    """Chooses about `most` sides of surfels, at which light is gathered for all. `apart` (N,): those that are smaller
    count as that large, else pieces of fine meshes would take nearly all receivers, and large floors none."""
    if len(surfels) == 0:
        none = np.zeros((4, 0), np.int64)
        return BounceReceivers(none[0], none, none.astype(np.float32))
    normal = np.ascontiguousarray(surfels.normal.T)
    turned = np.stack([dot(axis, normal) for axis in SIDE_AXES.T])
    face = np.abs(turned).argmax(axis=0)
    side = 2 * face + (np.take_along_axis(turned, face[None], axis=0)[0] < 0)
    # Surfels are the larger the farther off they are, and so are the cells that share a receiver. These are
    # flat, thin along the axis that normals are turned to, so that surfaces behind one another do not share one.
    whole = surfels.area * np.where(surfels.half, 2, 1)
    size = np.maximum(np.sqrt(np.maximum(whole, np.percentile(whole, SMALLEST_SHARE))), apart)
    level = np.ceil(np.log2(size))
    thin = np.where(np.abs(SIDE_AXES) > 0.5, THINNER, 1.0)[:, face]
    away = (surfels.position.T - surfels.position.min(axis=0)[:, None]) / (thin * np.exp2(level))
    kind = scrambled((8 * level + side).astype(np.int64).view(np.uint64))
    fills = np.minimum(whole / np.maximum(apart * apart, 1e-30), 1.0)  # of a cell
    # From here on cells grow until receivers are few enough. Both sides of a cell count, but where surfaces end or turn
    # they fill cells in part.
    scale = max(float(fills.sum()) / most, 1.0) ** 0.5
    while True:
        at = away / scale
        cell = np.floor(at)
        key = cell_keys(cell, kind)
        found = _distinct(key) + _distinct(key[~surfels.closed])
        if found <= most or not cell.any():
            break
        # Cells of surfaces are as many as squares would be, of leaves at most as many as cubes.
        scale *= GROWTH ** max(np.floor(np.log(found / most) / (3 * np.log(GROWTH))), 1.0)
    order = np.argsort(key)
    new = np.flatnonzero(np.append(True, key[order][1:] != key[order][:-1]))
    count = np.diff(np.append(new, len(key)))
    group = np.empty(len(key), np.int64)
    group[order] = np.repeat(np.arange(len(new)), count)
    # The surfel nearest to the middle of each.
    middle = np.stack([np.bincount(group, column) / count for column in surfels.position.T])
    off = dot(*(2 * [surfels.position.T - middle[:, group]]))
    nearest = off == np.minimum.reduceat(off[order], new)[group]
    rows = np.minimum.reduceat(np.where(nearest[order], order, len(key)), new)
    return _with_neighbours(normal, rows, group, key[order[new]], at - cell, key, face)


def _distinct(keys: np.ndarray) -> int:
    """How many different ones there are."""
    keys = np.sort(keys)
    return int(np.count_nonzero(keys[1:] != keys[:-1])) + min(len(keys), 1)


def _with_neighbours(
    normal: np.ndarray,
    rows: np.ndarray,
    group: np.ndarray,
    keys: np.ndarray,
    within: np.ndarray,
    key: np.ndarray,
    face: np.ndarray,
) -> BounceReceivers:
    """Receivers `rows` (R,) of cells with keys (R,), rising, to which surfels with normals (3, N), of groups (N,),
    belong. `within` (3, N): places in their cells, with keys (N,), in faces (N,) across the axes."""
    # In the order of the surfels: that of keys depends on the unit of length.
    order = np.argsort(rows)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    of_rows, steps = normal[:, rows], np.array(PRIMES)
    others, weights = np.empty((4, len(group)), np.int64), np.empty((4, len(group)), np.float32)

    def fill(block: slice) -> None:
        ahead, apart = within[:, block] < 0.5, np.abs(within[:, block] - 0.5)
        axes = (face[block] + 1) % 3, (face[block] + 2) % 3
        of_axes = [np.take_along_axis(apart, axis[None], axis=0)[0] for axis in axes]
        back = [np.take_along_axis(ahead, axis[None], axis=0)[0] for axis in axes]
        with np.errstate(over="ignore"):
            moves = [np.where(one, -steps[axis], steps[axis]) for axis, one in zip(axes, back, strict=True)]
            moved = moves[0], moves[1], moves[0] + moves[1]
        others[0, block], total = place.take(group[block]), [(1 - of_axes[0]) * (1 - of_axes[1])]
        for k, (move, shares) in enumerate(zip(moved, ((0, 1), (1, 0), (0, 0)), strict=True), 1):
            with np.errstate(over="ignore"):
                wanted = key[block] + move
            weight = np.abs(shares[0] - of_axes[0]) * np.abs(shares[1] - of_axes[1])
            found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            alike = dot(normal[:, block], of_rows.take(found, axis=1))
            others[k, block] = place.take(found)
            total.append(np.where((keys[found] == wanted) & (alike > ALIKE), weight, 0.0))
        weights[:, block] = np.stack(total) / np.sum(total, axis=0)

    each_block(len(group), fill)
    return BounceReceivers(rows[order], others, weights)


def sides(surfels: Surfels) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, float]]:
    """Yields what light falls on: 0 outside or 1 inside, rows of surfels (n,), places and normals (n, 3) slightly above
    them, and the share that these have in the whole side.

    What has no normal is looked at from the four corners of a tetrahedron.
    """
    radius = np.sqrt(surfels.area / np.pi)[:, None]
    flat = surfels.normal.any(axis=1)
    for side, rows in ((0, np.flatnonzero(flat)), (1, np.flatnonzero(flat & ~surfels.closed))):
        if len(rows):
            normal, lift = surfels.normal[rows] * np.float32(1 - 2 * side), LIFTED * radius[rows]
            if surfels.raised is not None:
                lift = np.maximum(lift, surfels.raised[rows, None])
            yield side, rows, surfels.position[rows] + lift * normal, normal, 1.0
    rows = np.flatnonzero(~flat)
    for corner in TETRAHEDRON if len(rows) else ():
        normal = np.broadcast_to(corner, (len(rows), 3))
        # The area of a ball is four times that of its disk.
        yield 0, rows, surfels.position[rows] + 0.5 * radius[rows] * normal, normal, 0.25
