"""The light of a scene's surfels: by lamps, by the sky, and by each other, some bounces on."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...core.indirect.closed import scrambled
from ...core.indirect.surfels import Surfels
from ...core.indirect.tree import build_tree
from ...core.lod.levels import SIDE_AXES
from ...core.numeric.morton import morton_codes
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ..device.protocol import Device, Texture
from ..passes.indirect.gather import BOUNCE_CELLS, CELLS, COARSENESS, Gather, gather_program
from ..passes.indirect.pages import RECEIVER_WIDTH, node_texture, receiver_texture
from ..passes.indirect.surfel_light import lit_surfels

MOST_BOUNCE_RECEIVERS = 3000  # of either side, where light is gathered for further bounces
LEAST_GAIN = 0.01  # of the light of surfels, below which what a bounce brings is the last
THINNER = 0.25  # along the normal
SMALLEST_SHARE = 10.0  # percent of surfels that are smaller than what is told apart
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32) / np.float32(3**0.5)
LIFTED = 0.05  # radii of a surfel, by which its receiver lies above it


class IndirectLight:
    """The light tree of a scene on the device, with the light that leaves its nodes after some bounces."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        camera: Camera,
        surfels: Surfels,
        lighting: tuple[str, ...],
        textures: dict[str, Texture],
        bounces: int,
        check: Callable[[], None],
    ) -> None:
        """`lighting`: PS_ names of lamps, shadows and the sky; `textures`: what these read, in the camera's view."""
        self._device, self._scene, self._camera, self._surfels = device, scene, camera, surfels
        self._world = tuple(name for name in lighting if name in ("PS_HAS_WORLD", "PS_HAS_ENVIRONMENT"))
        self._lamps = tuple(name for name in lighting if name not in self._world)
        self._textures = textures
        self.origin = surfels.origin
        self.tree = build_tree(surfels)
        self._nodes: Texture | None = None
        direct = self._direct() if bounces > 0 else np.zeros((2, len(surfels), 3), np.float32)
        leaving = np.broadcast_to(surfels.emission, (2, len(surfels), 3))
        self._set_light(leaving)
        if bounces > 0:
            self._bounce(leaving, direct, bounces, check)

    def _direct(self) -> np.ndarray:
        """(2, N, 3): irradiance over pi by lamps, outside and inside."""
        surfels, lights = self._surfels, len(self._scene.lights)
        found = np.zeros((2, len(surfels), 3), np.float32)
        if not lights:
            return found
        view = self._camera.view_from_world
        rotation, shift = view[:3, :3], view[:3, 3] + view[:3, :3] @ surfels.origin
        for side, rows, position, normal, share in sides(surfels):
            lit = lit_surfels(
                self._device, self._lamps, lights, position @ rotation.T + shift, normal @ rotation.T, self._textures
            )
            found[side, rows] += np.float32(share) * lit
        return found

    def _bounce(self, leaving: np.ndarray, direct: np.ndarray, bounces: int, check: Callable[[], None]) -> None:
        """Lights surfels by what leaves others, (2, N, 3), and by lamps, over and over."""
        surfels = self._surfels
        rows, group = self._receivers()
        for number in range(bounces):
            check()
            if number == 0 and not self._world and not leaving.any():
                found = np.zeros_like(direct)
            else:
                found = self._gathered_at_surfels(rows)[:, group]
            former, leaving = leaving, surfels.emission + surfels.albedo * (direct + found)
            gain = leaving - former
            of_all = leaving.sum(axis=(0, 2))
            share = float((gain.sum(axis=(0, 2)) / np.maximum(of_all + np.median(of_all), 1e-30)).mean())
            self._set_light(leaving)
            if number and share < LEAST_GAIN:
                break

    def _receivers(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (R,) of surfels that stand for all, and which of them (N,) stands for each."""
        surfels = self._surfels
        turned = surfels.normal @ SIDE_AXES.astype(np.float32)
        face = np.abs(turned).argmax(axis=1)
        side = 2 * face + (turned[np.arange(len(face)), face] < 0)
        # Surfels are the larger the farther off they are, and so are the cells that share a receiver. These are
        # flat, thin along the axis that normals are turned to, so that surfaces behind one another do not share one.
        size = np.sqrt(np.maximum(surfels.area, np.percentile(surfels.area, SMALLEST_SHARE)))
        across = np.exp2(np.ceil(np.log2(size)))[:, None]
        thin = np.where(np.abs(SIDE_AXES.T[face]) > 0.5, THINNER, 1.0)
        away = surfels.position - surfels.position.min(axis=0)
        scale = max((np.count_nonzero(~surfels.closed) + len(surfels)) / MOST_BOUNCE_RECEIVERS, 1.0) ** 0.5
        while True:
            cell = np.floor(away / (scale * thin * across))
            key = _hashed(np.column_stack([cell, side, across]))
            order = np.argsort(key, kind="stable")
            new = np.append(True, key[order][1:] != key[order][:-1])
            open_ones = np.count_nonzero(~surfels.closed[order][new])
            if np.count_nonzero(new) + open_ones <= MOST_BOUNCE_RECEIVERS or not cell.any():
                break
            scale *= 1.25
        group = np.empty(len(key), np.int64)
        group[order] = np.cumsum(new) - 1
        # The surfel nearest to the middle of each.
        count = np.bincount(group)
        middle = np.stack([np.bincount(group, column) / count for column in surfels.position.T], axis=1)
        away = ((surfels.position - middle[group]) ** 2).sum(axis=1)
        nearest = np.lexsort((away, group))
        return nearest[np.cumsum(count) - count], group

    def _gathered_at_surfels(self, rows: np.ndarray) -> np.ndarray:
        """(2, R, 3): irradiance over pi by sky and surfels, outside and inside, at the surfels `rows`."""
        found = np.zeros((2, len(rows), 3), np.float32)
        for side, some, position, normal, share in sides(self._surfels.take(rows)):
            found[side, some] += np.float32(share) * self.gathered(position, normal, BOUNCE_CELLS, normal)[:, :3]
        return found

    def gathered(
        self,
        position: np.ndarray,
        normal: np.ndarray,
        cells: int,
        mirror: np.ndarray,
        sharpness: np.ndarray | None = None,
    ) -> np.ndarray:
        """Gathers at places with normals (N, 3), in the tree's space: (N, 8) float32, without sharpness (N, 4).

        Irradiance over pi and nearness, the mean of inverse distances; what lobes around mirrored views (N, 3), so
        sharp (N,), show of surfaces, and how much of them is open.
        """
        glossy = sharpness is not None
        rows = coherent_rows(position, normal)
        arrays = (position, normal, mirror, np.ones(len(position), np.float32) if sharpness is None else sharpness)
        texels = RECEIVER_WIDTH * (int(rows.max(initial=0)) // RECEIVER_WIDTH + 1)
        laid = [np.zeros((texels, *array.shape[1:]), np.float32) for array in arrays]
        for to, of in zip(laid, arrays, strict=True):
            to[rows] = of
        receivers = receiver_texture(self._device, *laid)
        made = self.gather(receivers, glossy, cells)
        try:
            textures = (made.diffuse, made.glossy) if glossy else (made.diffuse,)
            return np.concatenate([self._device.read(item).reshape(-1, 4)[rows] for item in textures], axis=1)
        finally:
            made.release()
            receivers.release()

    def gather(self, receivers: Texture, glossy: bool, cells: int = CELLS) -> Gather:
        """Gathers at receivers as of receiver_texture."""
        assert self._nodes is not None
        rotation = np.eye(4)
        rotation[:3, :3] = self._camera.view_from_world[:3, :3]
        program = gather_program(self._world, glossy, cells)
        assert program.block is not None
        values = {"view_from_world": rotation, "root": len(self.tree) - 1, "coarseness": COARSENESS}
        record = program.block.record(**{name: values[name] for _, name in program.block.fields})
        wanted = {"ps_lights", "ps_environment"} if self._world else set()
        textures = {name: texture for name, texture in self._textures.items() if name in wanted}
        if self._world == ("PS_HAS_WORLD",):
            textures.pop("ps_environment", None)
        textures |= {"ps_nodes": self._nodes}
        return Gather(self._device, receivers, program, record, textures)

    def _set_light(self, leaving: np.ndarray) -> None:
        """`leaving` (2, N, 3): radiance that leaves surfels, outside and inside."""
        if self._nodes is not None:
            self._nodes.release()
        self._nodes = node_texture(self._device, self.tree, self.tree.radiance(self._surfels, *leaving))

    def release(self) -> None:
        """Frees what is on the device."""
        if self._nodes is not None:
            self._nodes.release()


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


def _hashed(columns: np.ndarray) -> np.ndarray:
    """(N,) uint64: equal where rows (N, k) of numbers are, and else but with a probability of 2^-64."""
    with np.errstate(over="ignore"):
        found = np.zeros(len(columns), np.uint64)
        for column in columns.T:
            found = scrambled(found ^ (column.astype(np.float64) + 0.0).view(np.uint64))
    return found


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
