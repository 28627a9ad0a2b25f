"""The light of a scene's surfels: by lamps, by the sky, and by each other, some bounces on."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...core.indirect.sites import hashed
from ...core.indirect.surfels import Surfels
from ...core.indirect.tree import build_tree
from ...core.light.light_table import light_texture
from ...core.lod.levels import SIDE_AXES
from ...core.numeric.morton import morton_codes
from ...core.numeric.record import record
from ...core.scene.scene import Scene
from ...core.scene.world import World
from ...shading.interface import Interface
from ..device.protocol import Device, Texture
from ..passes.indirect.gather import COARSENESS, GATHER_BLOCK, Gather, gather_program
from ..passes.indirect.pages import (
    NODE_WIDTH,
    RECEIVER_WIDTH,
    node_shapes,
    paged_texture,
    receiver_texture,
    with_radiance,
)
from ..passes.indirect.surfel_light import lit_surfels

MOST_BOUNCE_RECEIVERS = 3000  # of either side, where light is gathered for further bounces
FEWER = 2  # times fewer receivers gather all that comes after the first bounce of lamps' light, which is even
LEAST_GAIN = 0.01  # of the light of surfels, below which what a bounce brings is the last
THINNER = 0.25  # along the normal
ALIKE = 0.9  # cosine between normals of surfels and of receivers next to theirs that light them, too
SMALLEST_SHARE = 10.0  # percent of surfels that are smaller than what is told apart
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32) / np.float32(3**0.5)
MOST_KNOWN = 1 << 21  # sites that are kept, of 40 bytes each
LIFTED = 0.05  # radii of a surfel, by which its receiver lies above it


@record
class BakedLight:
    """The light tree of a scene, with the light that leaves its nodes after some bounces: for all cameras near one."""

    origin: np.ndarray  # (3,) float64, world: of the tree's space, which has the world's axes
    nodes: np.ndarray  # (M, 16) float32, as of node_rows, the root last

    @property
    def nbytes(self) -> int:
        return self.nodes.nbytes


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


class KnownSites:
    """What was gathered at sites (core/indirect/sites.py), by their keys: it depends on nothing else."""

    def __init__(self) -> None:
        self._keys, self._found = np.zeros(0, np.uint64), np.zeros((0, 8), np.float32)

    def lookup(self, keys: np.ndarray, gather: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Returns (N, 8) for keys (N,). `gather` returns it for rows (n,) of those that are not known."""
        unique, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        at = np.searchsorted(self._keys, unique)
        known = np.zeros(len(unique), bool)
        within = at < len(self._keys)
        known[within] = self._keys[at[within]] == unique[within]
        found = np.empty((len(unique), 8), np.float32)
        found[known] = self._found[at[known]]
        if not known.all():
            found[~known] = gather(first[~known])
            if len(self._keys) > MOST_KNOWN:
                self._keys, self._found = unique, found
            else:
                self._keys = np.insert(self._keys, at[~known], unique[~known])
                self._found = np.insert(self._found, at[~known], found[~known], axis=0)
        return found[inverse]


class IndirectLight:
    """Such a tree on the device, from which light is gathered."""

    def __init__(self, device: Device, baked: BakedLight, world: World, names: tuple[str, ...]) -> None:
        """`names`: PS_ names of the world."""
        self._device, self._names = device, names
        self.origin = baked.origin
        self._baked: BakedLight | None = baked  # until something is gathered
        self._root = len(baked.nodes) - 1
        self._table = light_texture((), world, np.eye(4))
        self._textures: dict[str, Texture] = {}
        self.known = KnownSites()

    @property
    def empty(self) -> bool:
        """Whether nothing hides or scatters light."""
        return self._root < 0

    def gathered(
        self,
        position: np.ndarray,
        normal: np.ndarray,
        sky: dict[str, Texture],
        mirror: np.ndarray | None = None,
        sharpness: np.ndarray | None = None,
    ) -> np.ndarray:
        """Gathers at places with normals (N, 3), in the tree's space: (N, 8) float32, without sharpness (N, 4).

        `sky`: the picture of the world, by sampler name, where there is one. Irradiance over pi and nearness, the mean
        of inverse distances; what lobes around mirrored views (N, 3), so sharp (N,), show of surfaces, and how much of
        them is open.
        """
        glossy, count = sharpness is not None, len(position)
        program = gather_program(self._names, glossy)
        mirror = normal if mirror is None else mirror
        sharpness = np.ones(count, np.float32) if sharpness is None else sharpness
        return self._gathered(program, (position, normal, mirror, sharpness), 1.0, sky)

    def bounced(self, position: np.ndarray, normal: np.ndarray, sky: float, pictures: dict[str, Texture]) -> np.ndarray:
        """Gathers less finely, by `sky` times the world's light: (N, 4) float32, irradiance over pi and the mean of
        what the world has in it. Otherwise as `gathered`."""
        program = gather_program(self._names, False, bounces=True)
        return self._gathered(program, (position, normal, normal, np.ones(len(position))), sky, pictures)

    def _gathered(
        self, program: Interface, receivers: tuple[np.ndarray, ...], sky: float, pictures: dict[str, Texture]
    ) -> np.ndarray:
        device = self._device
        rows = coherent_rows(*receivers[:2])
        texels = RECEIVER_WIDTH * (int(rows.max(initial=0)) // RECEIVER_WIDTH + 1)
        laid = [np.zeros((texels, *array.shape[1:]), np.float32) for array in receivers]
        for to, of in zip(laid, receivers, strict=True):
            to[rows] = of
        texture = receiver_texture(device, *laid)
        record = GATHER_BLOCK.record(root=self._root, coarseness=COARSENESS, sky=sky)
        textures = self._uploaded() | pictures
        wanted = {name for _, name in program.samplers}
        textures = {name: texture for name, texture in textures.items() if name in wanted}
        made = Gather(device, texture, program, record, textures)
        try:
            found = (made.diffuse, made.glossy) if len(program.outputs) > 1 else (made.diffuse,)
            return np.concatenate([device.read(item).reshape(-1, 4)[rows] for item in found], axis=1)
        finally:
            made.release()
            texture.release()

    def _uploaded(self) -> dict[str, Texture]:
        """The nodes and the world's colour, by sampler name."""
        if self._baked is not None:
            device, table = self._device, self._table
            self._textures["ps_nodes"] = paged_texture(device, self._baked.nodes, NODE_WIDTH)
            self._baked = None
            if self._names:
                lights = device.texture((table.shape[1], table.shape[0]), "RGBA32F", table.reshape(-1))
                self._textures["ps_lights"] = lights
        return self._textures

    def release(self) -> None:
        """Frees what is on the device."""
        for texture in self._textures.values():
            texture.release()
        self._textures = {}


def bake_light(
    device: Device,
    scene: Scene,
    surfels: Surfels,
    lighting: tuple[str, ...],
    textures: dict[str, Texture],
    bounces: int,
    check: Callable[[], None],
) -> BakedLight:
    """Lights surfels by lamps, by the sky and by each other, so many times.

    `lighting`: PS_ names of lamps, shadows and the sky; `textures`: what these read, in the world from the surfels'
    origin. Raises what `check` raises, which is called between steps.
    """
    return _Baker(device, scene, surfels, lighting, textures).baked(bounces, check)


class _Baker:
    """Surfels that are being lit."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        surfels: Surfels,
        lighting: tuple[str, ...],
        textures: dict[str, Texture],
    ) -> None:
        self._device, self._scene, self._surfels = device, scene, surfels
        self._names = world_names(lighting)
        self._lamps = tuple(name for name in lighting if name not in self._names)
        self._textures = textures
        self._tree = build_tree(surfels)
        self._shapes = node_shapes(self._tree)

    def baked(self, bounces: int, check: Callable[[], None]) -> BakedLight:
        surfels = self._surfels
        leaving = np.broadcast_to(surfels.emission, (2, len(surfels), 3))
        if bounces == 0:
            return self._with(leaving)
        direct = self._direct()
        receivers = bounce_receivers(surfels, MOST_BOUNCE_RECEIVERS)
        at = surfels.take(receivers.rows)
        # What lamps light is bright in places: it is gathered together with the sky, so that it is a
        # bounce ahead of what the sky lights.
        lit = surfels.albedo * direct if bounces > 1 else np.zeros_like(direct)
        check()
        found, of_sky = self._gathered(at, surfels.emission + lit, 1.0)
        total = surfels.emission + surfels.albedo * (direct + receivers.spread(found))
        # All further light is even, and gathered at fewer.
        fewer = bounce_receivers(at, MOST_BOUNCE_RECEIVERS // FEWER)
        some, gain = at.take(fewer.rows), found
        for number in range(1, bounces):
            check()
            sends = surfels.albedo * receivers.spread(gain)
            if number == bounces - 1:
                sends *= self._not_ahead(at, found, of_sky, lit)
            if _share(sends, total) < LEAST_GAIN:
                break
            gain = fewer.spread(self._gathered(some, sends, 0.0)[0])
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

    def _gathered(self, surfels: Surfels, leaving: np.ndarray, sky: float) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance over pi, outside and inside of some surfels, by what leaves all and by `sky` times the world's
        light: (2, R, 3), and the mean of the world's part, (2, R)."""
        found = np.zeros((2, len(surfels), 4), np.float32)
        if not leaving.any() and not (self._names and sky):
            return found[..., :3], found[..., 3]
        pictures = {name: texture for name, texture in self._textures.items() if name == "ps_environment"}
        light = IndirectLight(self._device, self._with(leaving), self._scene.world, self._names)
        try:
            for side, some, position, normal, share in sides(surfels):
                found[side, some] += np.float32(share) * light.bounced(position, normal, sky, pictures)
        finally:
            light.release()
        return found[..., :3], found[..., 3]


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


def world_names(lighting: tuple[str, ...]) -> tuple[str, ...]:
    """Returns those of PS_ names of lights and shadows that are of the world."""
    return tuple(name for name in lighting if name in ("PS_HAS_WORLD", "PS_HAS_ENVIRONMENT"))


def coherent_rows(position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N,) int64: which row of a texture of receivers each is to be, so that those that are drawn together, in blocks
    of 4 x 4 texels, lie near each other and are turned alike."""
    if len(position) == 0:
        return np.zeros(0, np.int64)
    octant = ((normal > 0) * np.array([1, 2, 4])).sum(axis=1)
    order = np.lexsort((morton_codes(position)[0], octant))
    number = np.arange(len(order))
    block, within = number >> 4, number & 15
    across = RECEIVER_WIDTH // 4
    rows = np.empty(len(order), np.int64)
    rows[order] = (4 * (block // across) + within // 4) * RECEIVER_WIDTH + 4 * (block % across) + within % 4
    return rows


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
