"""Shares of light that reach the splats of a page; they hold for all cameras and are kept from frame to frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ....shading.interface import Interface
from ...cache.keys import Key, Kind
from ...cache.on_disk import NOWHERE, Form, OnDisk
from ...device.protocol import BYTES_PER_PIXEL, Device, Target, Texture, released_on_failure

FORMAT = "RGBA16F"

MOST_KEPT = 7  # points of wide lights whose shares are kept


class LightShares:
    """The shares of light that reach the splats of a page, kept for all cameras."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._key: tuple = ()
        self._kept: dict[int, dict[str, Texture]] = {}  # all points from MOST_KEPT on share one
        self._taps: dict[int, int] = {}  # which point of wide lights each is of

    def textures(
        self,
        key: tuple,
        tap: int,
        program: Interface,
        size: tuple[int, int],
        light: Callable[[Target], None],
        on_disk: OnDisk = NOWHERE,
    ) -> dict[str, Texture]:
        """Returns the textures by sampler name. `light` draws what is not known for `key`, here or `on_disk`."""
        if key != self._key:
            self.release()
            self._key = key
        slot = min(tap, MOST_KEPT)
        if self._taps.get(slot) != tap:
            self._drop(slot)
            device, names = self.device, [name.replace("out_", "ps_") for _, name in program.outputs]

            def make() -> tuple[Texture, ...]:
                with released_on_failure(device):
                    textures = tuple(device.texture(size, FORMAT) for _ in names)
                    target = device.target(textures)
                    device.clear(target)  # behind the last splat of the page
                    light(target)
                target.release()
                return textures

            whole = Key(Kind.LIGHT_SHARES, key, other=(tap, program))
            found = on_disk.lookup(whole, make, _form(device), device.limits.driver)
            self._kept[slot], self._taps[slot] = dict(zip(names, found, strict=True)), tap
        return self._kept[slot]

    def release(self) -> None:
        for slot in list(self._kept):
            self._drop(slot)

    def _drop(self, slot: int) -> None:
        self._taps.pop(slot, None)
        for texture in self._kept.pop(slot, {}).values():
            texture.release()


def _form(device: Device) -> Form[tuple[Texture, ...]]:
    """How files keep shares: as they are, in half floats."""

    def save(textures: tuple[Texture, ...]) -> tuple[np.ndarray, ...] | None:
        found = tuple(device.read(texture).astype(np.float16) for texture in textures)
        return found if all(np.isfinite(shares).all() for shares in found) else None

    def load(found: tuple[Any, ...]) -> tuple[Texture, ...]:
        with released_on_failure(device):
            return tuple(
                device.texture((shares.shape[1], shares.shape[0]), FORMAT, shares.astype(np.float32).reshape(-1))
                for shares in found
            )

    def settle(textures: tuple[Texture, ...]) -> int:
        device.read(textures[0])  # waits until it is drawn
        return sum(texture.size[0] * texture.size[1] * BYTES_PER_PIXEL[FORMAT] for texture in textures)

    return Form(save, load, {}, settle)
