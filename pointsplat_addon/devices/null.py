"""Device that draws nothing and records everything: tests ask it which passes and textures a scene needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from ..core.numeric.record import record
from ..render.device import protocol as checks
from ..render.device.protocol import CHANNELS, DEPTH_BYTES, EMPTY, DeviceError, Limits, Target, Texture, Timer
from ..shading import sources
from ..shading.interface import Interface

LIMITS = Limits("null", texture_size=16384, image_atomics=True, float_blend=True)


@record
class Call:
    """One draw or dispatch."""

    interface: Interface
    target: Target | None = None  # None: a dispatch, or Blender's own framebuffer
    count: int = 0  # vertices, or work groups
    primitive: str = ""  # "": a dispatch
    uniforms: np.ndarray | None = None
    textures: Mapping[str, Texture] = field(default_factory=dict)
    images: Mapping[str, Texture] = field(default_factory=dict)
    flags: frozenset[str] = frozenset()  # of blend, over, depth_test, cull
    mask: str = "RGBA"


class NullTexture:
    def __init__(self, device: NullDevice, size: tuple[int, int], format: str, uploaded: int):
        self.size, self.format, self.uploaded = size, format, uploaded
        self.nbytes = size[0] * size[1] * checks.BYTES_PER_PIXEL[format]
        self._device = device

    def release(self) -> None:
        self._device.alive.discard(self)


class NullTarget:
    def __init__(self, device: NullDevice, colors: Sequence[Texture], depth: bool):
        self.colors, self.depth = tuple(colors), depth
        width, height = colors[0].size
        self.nbytes = width * height * DEPTH_BYTES if depth else 0
        self._device = device

    def release(self) -> None:
        self._device.alive.discard(self)


class NullTimer:
    def milliseconds(self) -> float:
        return 0.0

    def release(self) -> None:
        pass


class NullDevice:
    name = "null"

    def __init__(self, limits: Limits = LIMITS):
        self.limits = limits
        self.calls: list[Call] = []
        self.textures: list[NullTexture] = []  # all that were ever made
        self.targets: list[NullTarget] = []
        self.interfaces: list[Interface] = []  # what would have been compiled, in order of first use
        self.seen: set[int] = set()  # ids of textures that the host has read
        self.alive: set[NullTexture | NullTarget] = set()
        self.peak_bytes = 0

    @property
    def names(self) -> list[str]:
        """The passes in the order in which they ran."""
        return [call.interface.name for call in self.calls]

    @property
    def uploaded_bytes(self) -> int:
        return sum(texture.uploaded for texture in self.textures)

    def texture(self, size: tuple[int, int], format: str, data: checks.Texels | None = None) -> NullTexture:
        checks.check_texture(size, format, data, self.limits)
        uploaded = 0 if data is None else size[0] * size[1] * checks.BYTES_PER_PIXEL[format]
        texture = NullTexture(self, size, format, uploaded)
        self.textures.append(texture)
        self._add(texture)
        return texture

    def target(self, colors: Sequence[Texture], depth: bool = False) -> NullTarget:
        checks.check_target(colors)
        target = NullTarget(self, colors, depth)
        self.targets.append(target)
        self._add(target)
        return target

    def clear(self, target: Target, color: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        pass

    def fill(self, texture: Texture) -> None:
        if texture.format != "R32UI":
            raise DeviceError(f"fill is for R32UI, not {texture.format}")

    def draw(
        self,
        interface: Interface,
        target: Target | None,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, Texture] | None = None,
        vertices: int = 3,
        primitive: str = "TRIANGLES",
        blend: bool = False,
        over: bool = False,
        mask: str = "RGBA",
        depth_test: bool = False,
        cull: bool = False,
    ) -> None:
        checks.check_call(interface, target, uniforms, textures or {}, {}, blend or over)
        self._check_alive(interface, [*(textures or {}).values(), *([] if target is None else [target])])
        self._use(interface, interface.vertex, interface.fragment)
        flags = {"blend": blend, "over": over, "depth_test": depth_test, "cull": cull}
        self.calls.append(
            Call(
                interface,
                target,
                vertices,
                primitive,
                None if uniforms is None else uniforms.copy(),
                dict(textures or {}),
                flags=frozenset(name for name, on in flags.items() if on),
                mask=mask,
            )
        )

    def dispatch(
        self,
        interface: Interface,
        groups: int,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, Texture] | None = None,
        images: Mapping[str, Texture] | None = None,
    ) -> None:
        if not self.limits.image_atomics:
            raise DeviceError(f"{interface.name}: this device has no compute shaders")
        checks.check_call(interface, None, uniforms, textures or {}, images or {})
        self._check_alive(interface, [*(textures or {}).values(), *(images or {}).values()])
        self._use(interface, interface.compute)
        record = None if uniforms is None else uniforms.copy()
        self.calls.append(
            Call(interface, None, groups, uniforms=record, textures=dict(textures or {}), images=dict(images or {}))
        )

    def read(self, texture: Texture) -> np.ndarray:
        self.seen.add(id(texture))
        width, height = texture.size
        if texture.format == "R32UI":
            return np.full((height, width), EMPTY, np.uint32)  # as `fill` leaves it
        return np.zeros((height, width, CHANNELS[texture.format]), np.float32)

    def start_timer(self) -> NullTimer:
        return NullTimer()

    def stop_timer(self, timer: Timer) -> None:
        pass

    def bytes_allocated(self) -> int:
        return sum(thing.nbytes for thing in self.alive)

    def release(self) -> None:
        self.alive.clear()

    def _add(self, thing: NullTexture | NullTarget) -> None:
        self.alive.add(thing)
        self.peak_bytes = max(self.peak_bytes, self.bytes_allocated())

    def _check_alive(self, interface: Interface, things: list[Any]) -> None:
        if not self.alive.issuperset(things):
            raise DeviceError(f"{interface.name}: what it reads or writes was released before")

    def _use(self, interface: Interface, *files: str) -> None:
        if interface in self.interfaces:
            return
        for file in files:
            sources.load(file)  # a missing file is an error here too
        self.interfaces.append(interface)
