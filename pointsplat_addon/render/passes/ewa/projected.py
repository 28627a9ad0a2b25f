"""Splats of one view after projection, and lists of those that are drawn."""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ..pages.point_page import PageDraw
from ..tiles import TILE
from ..uniforms import SampleView
from . import cover as ewa_cover


class ProjectedSplats:
    """The projected splats of one page of one view."""

    @releases_on_failure
    def __init__(self, device: Device, program: Interface, draw: PageDraw) -> None:
        """DeviceError: more splats than a texture holds."""
        self.draw = draw
        size = (PAGE_WIDTH, max(1, -(-draw.elements // PAGE_WIDTH)))
        exact = ("out_centre", "out_shape", "out_front")
        self.textures: dict[str, Texture] = {
            name.replace("out_", "ps_splat_"): device.texture(size, "RGBA32F" if name in exact else "RGBA16F")
            for _, name in program.outputs
        }
        self.target: Target = device.target(list(self.textures.values()))
        # Elements, by list: small splats that visibility draws "first" and "then"; those that are "blended", where that
        # is not all of them; "large" ones for both.
        self.found: dict[str, np.ndarray] = {}
        self.lists: dict[str, tuple[Texture, int]] = {}  # their texels, and how many
        self._corner = np.zeros(2, np.float32)  # of the picture from the principal point, in pixels

    def find(self, device: Device, view: SampleView, margin: float) -> None:
        """Find the splats that are drawn: not the small ones that lie `margin` pixels outside the picture, since
        vertices cost more than looking once which of them are needed. Those that show their backs come second."""
        x, y, _, kind = device.read(self.textures["ps_splat_centre"]).reshape(-1, 4).T
        self._corner = -np.array(view.principal_point, np.float32)
        odd = np.abs(kind).astype(np.int32) & 1 == 1
        small, turned = odd.copy(), kind < 0
        for at, low, size in zip((x, y), self._corner, np.array(view.size, np.int32), strict=True):
            small &= (at > low - margin) & (at < low + size + margin)
        first, then = np.flatnonzero(small & ~turned), np.flatnonzero(small & turned)
        self.found = {"first": first, "then": then, "large": np.flatnonzero(~odd & (kind != 0))}

    def keep(self, first: np.ndarray, needed: np.ndarray) -> None:
        """Of what was found, visibility drew `first`; `needed`, of each element: what shaders/ewa/needed.frag says."""
        small = np.concatenate([self.found["first"], self.found["then"]])
        drawn = np.zeros(len(needed), bool)
        drawn[first] = True
        then = small[(needed[small] > ewa_cover.COVERED) & ~drawn[small]]
        first = first[needed[first] > ewa_cover.HIDDEN]
        self.found |= {"first": first, "then": then, "blended": small[needed[small] > ewa_cover.HIDDEN]}

    def list_first(self, device: Device, index: np.ndarray) -> None:
        """List these elements as those that visibility draws first."""
        if "first" in self.lists:
            self.lists.pop("first")[0].release()
        self.lists["first"] = upload_list(device, index)

    def list_found(self, device: Device, tiles: np.ndarray | None = None) -> None:
        """List what was found; of small splats only those whose middles lie in the tiles (rows, columns) bool."""
        self._release_lists()
        within = None if tiles is None else self._within(device, tiles)
        for name, index in self.found.items():
            shown = index if within is None or name == "large" else index[within[index]]
            self.lists[name] = upload_list(device, shown)

    def _within(self, device: Device, tiles: np.ndarray) -> np.ndarray:
        middle = device.read(self.textures["ps_splat_centre"]).reshape(-1, 4)[:, :2] - self._corner
        rows, columns = tiles.shape
        column, row = np.clip(middle / TILE, 0, (columns - 1, rows - 1)).astype(np.int32).T
        return tiles[row, column]

    def _release_lists(self) -> None:
        for texture, _ in self.lists.values():
            texture.release()
        self.lists.clear()

    def release(self) -> None:
        self._release_lists()
        self.target.release()
        for texture in self.textures.values():
            texture.release()


def upload_list(device: Device, index: np.ndarray) -> tuple[Texture, int]:
    """Uploads the texels of elements (N,); returns the texture and how many they are."""
    size, data = paged(np.stack([index % PAGE_WIDTH, index // PAGE_WIDTH], axis=1), 2)
    return device.texture(size, "RG32F", data), len(index)
