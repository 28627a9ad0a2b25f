"""Textures and targets that are made together, and released together."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from .protocol import Device, Target, Texture


class Releasable(Protocol):
    """What holds something on the device."""

    def release(self) -> None:
        """Gives it back."""
        ...


Item = TypeVar("Item", bound=Releasable)


def texture_of(device: Device, texels: np.ndarray, format: str) -> Texture:
    """Returns a texture of texels (rows, columns, channels) of numbers, or (rows, columns) of one channel."""
    size = texels.shape[1], texels.shape[0]
    return device.texture(size, format, texels.astype(np.float32).reshape(-1))


class Owned:
    """What one part of a picture holds on the device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._items: list[Releasable] = []

    def add(self, item: Item) -> Item:
        """Takes an item, and returns it."""
        self._items.append(item)
        return item

    def texture(self, size: tuple[int, int], format: str) -> Texture:
        """Makes a texture of a size (width, height). DeviceError: the device cannot."""
        return self.add(self._device.texture(size, format))

    def filled(self, texels: np.ndarray, format: str) -> Texture:
        """Makes a texture of texels, as `texture_of`. DeviceError: the device cannot."""
        return self.add(texture_of(self._device, texels, format))

    def target(self, *textures: Texture) -> Target:
        """Makes a target of textures that are written together. DeviceError: the device cannot."""
        return self.add(self._device.target(textures))

    def release(self) -> None:
        """Releases everything, the latest first."""
        for item in reversed(self._items):
            item.release()
        self._items.clear()
