"""The light of a scene's surfels: by lamps, by the sky, and by each other, some bounces on."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...core.indirect.surfels import Surfels
from ...core.indirect.tree import build_tree
from ...core.lod.levels import SIDE_AXES
from ...core.numeric.morton import DEPTH, morton_codes
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ..device.protocol import Device, Texture
from ..passes.indirect.gather import COARSENESS, Gather, gather_program
from ..passes.indirect.pages import node_texture, receiver_texture
from ..passes.indirect.surfel_light import lit_surfels

MOST_BOUNCE_RECEIVERS = 6000  # where light is gathered for further bounces
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
            rows, group = self._receivers()
            for _ in range(bounces):
                check()
                found = self._gathered_at_surfels(rows)[:, group]
                leaving = surfels.emission + surfels.albedo * (direct + found)
                self._set_light(leaving)

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

    def _receivers(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (R,) of surfels that stand for all, and which of them (N,) stands for each."""
        surfels = self._surfels
        code, _ = morton_codes(surfels.position)
        turned = surfels.normal @ SIDE_AXES.astype(np.float32)
        face = np.abs(turned).argmax(axis=1)
        side = 2 * face + (turned[np.arange(len(face)), face] < 0)
        # In this order, those of one side that share a cell follow one another, whatever the size of cells.
        order = np.lexsort((code, side))
        code, turns = code[order], np.diff(side[order]) != 0
        new, step = np.ones(len(code), bool), code[1:] ^ code[:-1]
        for shift in range(3 * DEPTH + 1):
            new[1:] = turns | (step >> np.uint64(shift) != 0)
            if np.count_nonzero(new) <= MOST_BOUNCE_RECEIVERS:
                break
        group = np.empty(len(code), np.int64)
        group[order] = np.cumsum(new) - 1
        begin = np.flatnonzero(new)
        middle = (begin + np.append(begin[1:], len(order))) // 2
        return order[middle], group

    def _gathered_at_surfels(self, rows: np.ndarray) -> np.ndarray:
        """(2, R, 3): irradiance over pi by sky and surfels, outside and inside, at the surfels `rows`."""
        found = np.zeros((2, len(rows), 3), np.float32)
        for side, some, position, normal, share in sides(self._surfels.take(rows)):
            found[side, some] += np.float32(share) * self.gathered(position, normal)[:, :3]
        return found

    def gathered(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 4) float32: irradiance over pi and nearness at places with normals (N, 3), in the tree's space."""
        receivers = receiver_texture(self._device, position, normal, normal, np.ones(len(position), np.float32))
        made = self.gather(receivers, glossy=False)
        try:
            return self._device.read(made.diffuse).reshape(-1, 4)[: len(position)]
        finally:
            made.release()
            receivers.release()

    def gather(self, receivers: Texture, glossy: bool) -> Gather:
        """Gathers at receivers as of receiver_texture."""
        assert self._nodes is not None
        rotation = np.eye(4)
        rotation[:3, :3] = self._camera.view_from_world[:3, :3]
        program = gather_program(self._world, glossy)
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
