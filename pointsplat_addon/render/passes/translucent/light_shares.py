"""Shares of light that reach the splats of a page; they hold for all cameras and are kept from frame to frame."""

from __future__ import annotations

from collections.abc import Callable

from ....shading.interface import Interface
from ...device.protocol import Device, Target, Texture, released_on_failure

MOST_KEPT = 7  # points of wide lights whose shares are kept


class LightShares:
    """The shares of light that reach the splats of a page, kept for all cameras."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._key: tuple = ()
        self._kept: dict[int, tuple[Target, dict[str, Texture]]] = {}  # all points from MOST_KEPT on share one
        self._taps: dict[int, int] = {}  # which point of wide lights each is of

    def textures(
        self, key: tuple, tap: int, program: Interface, size: tuple[int, int], light: Callable[[Target], None]
    ) -> dict[str, Texture]:
        """Returns the textures by sampler name. `light` draws them where they are not known for `key`."""
        if key != self._key:
            self.release()
            self._key = key
        slot = min(tap, MOST_KEPT)
        if slot not in self._kept:
            with released_on_failure(self.device):
                textures = {
                    name.replace("out_", "ps_"): self.device.texture(size, "RGBA16F") for _, name in program.outputs
                }
                self._kept[slot] = self.device.target(list(textures.values())), textures
        target, textures = self._kept[slot]
        if self._taps.get(slot) != tap:
            light(target)
            self._taps[slot] = tap
        return textures

    def release(self) -> None:
        for target, textures in self._kept.values():
            target.release()
            for texture in textures.values():
                texture.release()
        self._kept.clear()
        self._taps.clear()
