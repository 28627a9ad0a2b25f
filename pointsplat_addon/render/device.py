"""The device that draws: the least that the passes need, so that every device can offer it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..shading.interface import Interface

COLOR_FORMATS = ("RGBA32F", "RGBA16F", "RG32F", "R32F", "R32UI")
EMPTY = 0xFFFFFFFF  # what a cleared R32UI texture holds


class DeviceError(RuntimeError):
    """The device cannot do what was asked; the message says what and why."""


@dataclass(frozen=True)
class Limits:
    """What the device was found to offer, by asking it."""

    renderer: str
    texture_size: int  # largest side of a texture
    image_atomics: bool  # compute shaders with atomics on R32UI images
    float_blend: bool  # additive blending into RGBA32F


class Texture(Protocol):
    """A two-dimensional texture of one level, nearest filtering, clamped."""

    size: tuple[int, int]
    format: str

    def release(self) -> None: ...


class Target(Protocol):
    """Textures that one draw writes together."""

    def release(self) -> None: ...


class Timer(Protocol):
    def milliseconds(self) -> float:
        """Time the device spent between start and stop; waits for it where it must."""
        ...


class Device(Protocol):
    """All calls come from the thread that made the device."""

    name: str
    limits: Limits

    def texture(self, size: tuple[int, int], format: str, data: np.ndarray | None = None) -> Texture:
        """A texture; `data` is float32 of size H*W*channels, bottom row first (never given for R32UI)."""
        ...

    def target(self, colors: Sequence[Texture], depth: bool = False) -> Target:
        """A target over textures of one size, with a depth buffer of its own where `depth`."""
        ...

    def clear(self, target: Target, color: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        """Set all colour textures to `color` and the depth buffer to 1."""
        ...

    def fill(self, texture: Texture) -> None:
        """Set an R32UI texture to EMPTY."""
        ...

    def draw(
        self,
        interface: Interface,
        target: Target,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, Texture] | None = None,
        vertices: int = 3,
        primitive: str = "TRIANGLES",
        blend: bool = False,
        depth_test: bool = False,
        cull: bool = False,
    ) -> None:
        """Draw `vertices` without vertex attributes (gl_VertexID counts them) as TRIANGLES, LINES or POINTS.

        blend adds to what is there; depth_test keeps the nearer and writes depth; cull drops back faces.
        """
        ...

    def dispatch(
        self,
        interface: Interface,
        groups: int,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, Texture] | None = None,
        images: Mapping[str, Texture] | None = None,
    ) -> None:
        """Run `groups` work groups of interface.local_size. More than 65,535 are laid out in rows: use ps_index()."""
        ...

    def read(self, texture: Texture) -> np.ndarray:
        """The texture as (H, W, channels) float32, or (H, W) uint32 for R32UI; bottom row first."""
        ...

    def start_timer(self) -> Timer: ...

    def stop_timer(self, timer: Timer) -> None: ...

    def bytes_allocated(self) -> int:
        """Bytes of all textures alive on the device."""
        ...

    def release(self) -> None:
        """Free everything; the device is unusable afterwards."""
        ...
