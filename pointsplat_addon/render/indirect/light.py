"""The light of a scene's surfels on the device, from which receivers gather it."""

from __future__ import annotations

import numpy as np

from ...core.indirect.around import LightAround, LightAt, joined, matched
from ...core.indirect.moments import MOMENTS
from ...core.light.light_table import light_texture
from ...core.numeric.morton import morton_codes
from ...core.numeric.record import record
from ...core.scene.world import World
from ...shading.interface import Interface
from ..cache.keys import Key
from ..device.protocol import Device, Texture
from ..passes.indirect.gather import COARSENESS, Gather, gather_program
from ..passes.indirect.pages import (
    CAPTURED,
    MEDIA_WIDTH,
    NODE_WIDTH,
    RECEIVER_WIDTH,
    SHINING,
    paged_texture,
    receiver_texture,
)
from .known_sites import KnownSites
from .media import BakedMedia

MOST_REMEMBERED = 1 << 17  # positions, of about 100 bytes each, of which it is remembered what was gathered
DEALT = 64  # texels along a side of what a software rasteriser (llvmpipe) gives to one thread


@record
class BakedLight:
    """The light tree of a scene, with the light that leaves its nodes after some bounces: for all cameras near one."""

    origin: np.ndarray  # (3,) float64, world: of the tree's space, which has the world's axes
    nodes: np.ndarray  # (M, 16) float32, as of node_rows, the root last
    cube: np.ndarray  # (4,) float32, as of LightTree
    media: BakedMedia | None = None
    # (K, 10) float32: what falls on the scene at some positions: these, normals, irradiance over pi, and the binary
    # logarithm of how far they are apart. None: it is not known.
    received: np.ndarray | None = None

    @property
    def nbytes(self) -> int:
        received = 0 if self.received is None else self.received.nbytes
        return (
            self.nodes.nbytes
            + received
            + (0 if self.media is None else self.media.cells.nbytes + self.media.light.nbytes)
        )


class IndirectLight:
    """Such a tree on the device, from which light is gathered."""

    def __init__(
        self,
        device: Device,
        baked: BakedLight,
        world: World,
        names: tuple[str, ...],
        key: Key | None = None,
        within: float | None = None,
    ) -> None:
        """`names`: PS_ names of the world. `key`: by which it is kept. `within`: what hides the world sends no light,
        and what is farther away than this does not hide it. None: all does both."""
        self._device, self._names, self.key = device, names, key
        self._within = within
        self.origin = baked.origin
        self._baked: BakedLight | None = baked  # until something is gathered
        self._root, self.media, self._cube = len(baked.nodes) - 1, baked.media, tuple(baked.cube.tolist())
        bits = np.bitwise_or.reduce(baked.nodes[:, 6].astype(np.int64), initial=0)
        self._captured = bool(bits & int(CAPTURED))
        self._shining = bool(bits & int(SHINING)) and within is None
        self._bodies = bool((baked.nodes[:, 4] < 0).any())
        self._table = light_texture((), world, np.eye(4))
        self._textures: dict[str, Texture] = {}
        self.known, self.known_moments = KnownSites(8), KnownSites(MOMENTS)
        self._received = None if baked.received is None else _light_at(baked.received)
        self._remembered: list[LightAt] = []  # what was gathered
        self._around: LightAround | None = None

    def remember(self, known: LightAt) -> None:
        """Takes in what was gathered, for `around`; of much, the latest."""
        self._remembered.append(known)
        self._around = None
        if sum(len(one.level) for one in self._remembered) > 2 * MOST_REMEMBERED:
            self._remembered = [joined(self._remembered).take(slice(-MOST_REMEMBERED, None))]

    @property
    def around(self) -> LightAround | None:
        """What is known of light, from which it is estimated elsewhere; None where nothing is."""
        if self._around is None:
            known = [] if not self._remembered else [joined(self._remembered)]
            if self._received is not None and len(self._received.level):
                known.append(matched(self._received, *known) if known else self._received)
            if known:
                self._around = LightAround(*known)
        return self._around

    @property
    def tells(self) -> bool:
        """Whether light can be estimated wherever a surface receives some."""
        return self._root < 0 or self.around is not None

    @property
    def _colored(self) -> bool:
        return self.media is not None and self.media.colored

    @property
    def occlusion(self) -> bool:
        """Whether it tells how much of the world is open, and no light."""
        return self._within is not None

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
        program = self._program(glossy)
        mirror = normal if mirror is None else mirror
        sharpness = np.ones(count, np.float32) if sharpness is None else sharpness
        return self._gathered(program, (position, normal, mirror, sharpness), 1.0, sky)

    def moments(self, position: np.ndarray, sky: dict[str, Texture]) -> np.ndarray:
        """Gathers from all sides at places (N, 3): (N, 24) float32, as of core/indirect/moments.py. Otherwise as
        `gathered`."""
        program = self._program(False, moments=True)
        found = np.zeros((len(position), MOMENTS), np.float32)
        for sign in (1.0, -1.0):
            up = np.broadcast_to(np.array([0.0, 0.0, sign]), position.shape)
            found += self._gathered(program, (position, up, up, np.ones(len(position))), 1.0, sky)
        return found

    def bounced(self, position: np.ndarray, normal: np.ndarray, sky: float, pictures: dict[str, Texture]) -> np.ndarray:
        """Gathers less finely, by `sky` times the world's light: (N, 4) float32, irradiance over pi and the mean of
        what the world has in it. Otherwise as `gathered`."""
        program = self._program(False, bounces=True)
        return self._gathered(program, (position, normal, normal, np.ones(len(position))), sky, pictures)

    def within_media(self, position: np.ndarray, sky: float, pictures: dict[str, Texture]) -> np.ndarray:
        """Gathers from all sides at places (N, 3) in media: (N, 4) float32, mean radiance and the mean of what the
        world has in it. Otherwise as `bounced`."""
        program = self._program(False, bounces=True, every_side=True)
        found = np.zeros((len(position), 4), np.float32)
        for sign in (1.0, -1.0):
            up = np.broadcast_to(np.array([0.0, 0.0, sign]), position.shape)
            receivers = position, up, up, np.ones(len(position))
            found += np.float32(0.5) * self._gathered(program, receivers, sky, pictures)
        return found

    def _program(self, glossy: bool, **kind: bool) -> Interface:
        of_scene = {"media": self.media is not None, "colored": self._colored, "captured": self._captured}
        # What is sent on further is even, and needs no more.
        last = not kind.get("bounces", False)
        of_scene["shining"], of_scene["bodies"] = self._shining and last, self._bodies and last and not self._shining
        of_scene["occlusion"] = self.occlusion
        return gather_program(self._names, glossy, **of_scene, **kind)

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
        values: dict[str, object] = {"root": self._root, "coarseness": COARSENESS, "sky": sky, "cube": self._cube}
        values |= {} if self._within is None else {"within": self._within}
        if (media := self.media) is not None:
            values |= {"media_corner": (*media.low, media.edge), "media_cells": (*media.shape, 0)}
        assert program.block is not None
        record = program.block.record(**values)
        textures = self._uploaded() | pictures
        wanted = {name for _, name in program.samplers}
        textures = {name: texture for name, texture in textures.items() if name in wanted}
        made = Gather(device, texture, program, record, textures)
        try:
            return np.concatenate([device.read(item).reshape(-1, 4)[rows] for item in made.textures], axis=1)
        finally:
            made.release()
            texture.release()

    def on_media(self, view_from_world: np.ndarray) -> tuple[dict[str, object], Texture] | None:
        """What lighting media reads in a view, (4, 4): values of GATHERED_FIELDS, and the texture of the light that
        falls on them; None where there are none."""
        media = self.media
        if media is None:
            return None
        blocks_from_world = np.eye(4)
        edge = media.block * media.edge
        blocks_from_world[:3] /= edge
        blocks_from_world[:3, 3] = -(self.origin + media.low) / edge
        if "ps_medium_light_of" not in self._textures:
            self._textures["ps_medium_light_of"] = paged_texture(self._device, media.light, MEDIA_WIDTH)
        values: dict[str, object] = {
            "blocks_from_view": blocks_from_world @ np.linalg.inv(view_from_world),
            "medium_blocks": (*-(-media.shape // media.block), 0),
        }
        return values, self._textures["ps_medium_light_of"]

    def _uploaded(self) -> dict[str, Texture]:
        """The nodes and the world's colour, by sampler name."""
        if self._baked is not None:
            device, table = self._device, self._table
            self._textures["ps_nodes"] = paged_texture(device, self._baked.nodes, NODE_WIDTH)
            if self.media is not None:
                self._textures["ps_media"] = paged_texture(device, self.media.cells, MEDIA_WIDTH)
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


def _light_at(received: np.ndarray) -> LightAt:
    """What falls on surfaces, as of BakedLight, (K, 10). Nothing is known of what they mirror."""
    count = len(received)
    found = np.zeros((count, 8), np.float32)
    found[:, :3] = received[:, 6:9]
    position, normal, _, level = np.split(received.astype(np.float64), (3, 6, 9), axis=1)
    return LightAt(position, normal, level[:, 0], found, np.zeros(count, bool))


def world_names(lighting: tuple[str, ...]) -> tuple[str, ...]:
    """Returns those of PS_ names of lights and shadows that are of the world."""
    return tuple(name for name in lighting if name in ("PS_HAS_WORLD", "PS_HAS_ENVIRONMENT"))


def coherent_rows(position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N,) int64: which row of a texture of receivers each is to be, so that those that are drawn together, in blocks
    of 4 x 4 texels, lie near each other and are turned alike.

    Two blocks after the other lie in each square of DEALT texels in turn, all of which software rasterisers deal to
    their threads: few receivers keep all of these busy, too.
    """
    if len(position) == 0:
        return np.zeros(0, np.int64)
    octant = ((normal > 0) * np.array([1, 2, 4])).sum(axis=1)
    order = np.lexsort((morton_codes(position)[0], octant))
    number = np.arange(len(order))
    pair, (square, inside) = number >> 5, (RECEIVER_WIDTH // DEALT, DEALT // 8)
    turn = pair // square
    x = DEALT * (pair % square) + 8 * (turn % inside) + (number >> 4 & 1) * 4 + number % 4
    y = 4 * (turn // inside) + (number >> 2 & 3)
    rows = np.empty(len(order), np.int64)
    rows[order] = RECEIVER_WIDTH * y + x
    return rows
