"""Reads passes that are not averaged from the device: from the first sample, but identities from all samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...core.scene.scene import Scene
from ..device.protocol import Texture
from ..passes.outputs import BACKGROUND_DEPTH, CRYPTO
from ..passes.shading.data import data
from ..plan.request import Request
from .cryptomatte import cryptomatte, filtered_cryptomatte


class DataPasses:
    """Collects the passes of a picture that are not averaged over samples: depth, motion, indices, Cryptomatte."""

    def __init__(self, scene: Scene, request: Request) -> None:
        self.scene, self.request = scene, request
        self._first: dict[str, np.ndarray] = {}
        self._lattices: list[tuple[np.ndarray, np.ndarray]] = []  # of sub-samples: identities, weights
        self._captured: np.ndarray | None = None
        self._identities: list[np.ndarray] = []  # (H, W, 2) int32 by sample: instance, material

    @property
    def every_sample(self) -> bool:
        """Whether every sample has to be read, not only the first: Cryptomatte ranks the identities of all."""
        return bool(self.request.passes & set(CRYPTO))

    def read(
        self, textures: Sequence[Texture], read: Callable[[Texture], np.ndarray], first: bool, identify: bool = True
    ) -> None:
        """Reads the textures that are needed of one sample, and keeps their pixels.

        `textures`: those that the pass `data` has drawn; `read` returns the pixels of one, (H, W, 4) float32; `first`:
        whether this is the picture's first sample, of which all textures are read. `identify`: the identities under the
        pixels' centres are ranked.
        """
        for name, texture in zip(data(self.request.passes), textures, strict=True):
            if not (first or name == "index"):
                continue
            picture = read(texture)
            if first:
                self._first[name] = picture
            if name == "index" and self.every_sample and identify:
                self._identities.append(picture[..., :2].astype(np.int32))

    def identify(self, found: np.ndarray, weights: np.ndarray) -> None:
        """Adds the instance and the material of a lattice's sub-samples to those that are ranked.

        found: (S, H, W, 2) int32. weights: (N, S), of the pixel filter.
        """
        self._lattices.append((found, weights))

    def add_captured(self, depth: np.ndarray) -> None:
        """Adds depths (H, W) float32 of captured splats, infinite where there are none."""
        self._captured = depth

    def pixels(self, cropped: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
        """Returns the finished passes by name, (H, W, C) float32; passes whose textures were not read are left out.

        `cropped` takes the picture's own part of what lattices show.
        """
        scene, first = self.scene, self._first
        out = {}
        if "position" in first:
            out["depth"], out["position"] = first["position"][..., 3:], first["position"][..., :3]
        if self._captured is not None:
            depth = np.minimum(self._captured[..., None], BACKGROUND_DEPTH)
            out["depth"] = np.minimum(out.get("depth", BACKGROUND_DEPTH), depth).astype(np.float32)
        if "vector" in first:
            out["vector"] = first["vector"]
        if "index" in first:
            instance, material = (first["index"][..., i].astype(np.int64) for i in range(2))
            out["object_index"] = _looked_up(scene.instances.pass_index, instance)
            out["material_index"] = _looked_up(scene.materials.pass_index, material)
        if self._identities or self._lattices:
            tables = scene.instances.object_hash, scene.materials.hash
            for column, (key, table) in enumerate(zip(CRYPTO, tables, strict=True)):
                if key in self.request.passes:
                    pictures = self._cryptomatte(column, table, cropped)
                    out |= {f"{key}{i:02d}": picture for i, picture in enumerate(pictures)}
        return out

    def _cryptomatte(
        self, column: int, table: np.ndarray | None, cropped: Callable[[np.ndarray], np.ndarray]
    ) -> list[np.ndarray]:
        """The pictures of instances (`column` 0) or materials (1), whose hashes are in a table."""
        known = np.zeros(len(self.scene.instances), np.uint32) if table is None else table.astype(np.uint32)
        padded = np.append(known, np.uint32(0))  # -1 and indices beyond the table look up the last: no identity

        def hashes(ids: np.ndarray) -> np.ndarray:
            return padded[np.minimum(ids[..., column], len(known))]

        levels = self.request.crypto_levels
        if self._lattices:
            lattices = [(hashes(ids), weights) for ids, weights in self._lattices]
            return [cropped(picture) for picture in filtered_cryptomatte(lattices, levels)]
        return cryptomatte(np.stack([hashes(ids) for ids in self._identities]), levels)


def _looked_up(table: np.ndarray | None, index: np.ndarray) -> np.ndarray:
    """Returns table[index] as (H, W, 1) float32; 0 where the index is negative or beyond the table."""
    if table is None or len(table) == 0:
        return np.zeros((*index.shape, 1), np.float32)
    there = (index >= 0) & (index < len(table))
    return np.where(there, table[np.where(there, index, 0)], 0).astype(np.float32)[..., None]
