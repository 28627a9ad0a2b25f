"""The device that draws: the least that the passes need, so that every device can offer it."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from typing import Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np

from ...core.numeric.record import value_record
from ...core.numeric.vectors import each_block
from ...shading.interface import Interface

CHANNELS = {"RGBA32F": 4, "RGBA16F": 4, "RG32F": 2, "R32F": 1, "R32UI": 1}  # formats of textures
BYTES_PER_PIXEL = {"RGBA32F": 16, "RGBA16F": 8, "RG32F": 8, "R32F": 4, "R32UI": 4}
DEPTH_BYTES = 4  # per pixel of a target's depth buffer, which is 32-bit float on every device
MAX_OUTPUTS = 6  # textures of a target; Blender's gpu takes no more
MAX_GROUPS = 65535  # work groups in one direction
EMPTY = 0xFFFFFFFF  # what a cleared R32UI texture holds


# Content of a texture: numbers, or a function that writes the texels of a slice, counted along rows, bottom row first,
# into an array (n, channels) float32. It is called for one slice after another: they need not exist all at once.
WriteTexels = Callable[[np.ndarray, slice], None]
Texels = np.ndarray | WriteTexels


class DeviceError(RuntimeError):
    """The device cannot do what was asked; the message says what and why."""


@value_record
class Limits:
    """What the device was found to offer, by asking it."""

    renderer: str
    texture_size: int  # largest side of a texture
    image_atomics: bool  # compute shaders with atomics on R32UI images
    float_blend: bool  # additive blending into RGBA32F
    driver: str = ""  # with its version: devices of equal ones draw alike, to the bit


class Texture(Protocol):
    """A two-dimensional texture without mipmaps, with nearest filtering, clamped at its edges."""

    size: tuple[int, int]
    format: str

    def release(self) -> None:
        """Frees the texture. More than once does nothing."""
        ...


class Target(Protocol):
    """Textures that one draw writes together."""

    colors: tuple[Texture, ...]

    def release(self) -> None:
        """Frees the target and its depth buffer, but not its textures. More than once does nothing."""
        ...


class Timer(Protocol):
    """Measures the time that the device takes for some draws and dispatches. Timers do not nest."""

    def milliseconds(self) -> float:
        """Time the device spent between start and stop; waits for it if needed. DeviceError: released unread."""
        ...

    def release(self) -> None:
        """Gives the query back to the device, without waiting; a time that was not read is lost."""
        ...


class Device(Protocol):
    """Makes textures and targets and draws with them. All calls come from the thread that made the device."""

    name: str
    limits: Limits

    @property
    def alive(self) -> Set[Texture | Target]:
        """All textures and targets that are not released."""
        ...

    def texture(self, size: tuple[int, int], format: str, data: Texels | None = None) -> Texture:
        """A texture; `data` is float32 of size H*W*channels, bottom row first (never given for R32UI), or writes it.

        Without data its content is undefined.
        """
        ...

    def target(self, colors: Sequence[Texture], depth: bool = False) -> Target:
        """A target over textures of one size, with a depth buffer of its own where `depth`."""
        ...

    def clear(self, target: Target, color: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        """Set all colour textures to `color`, R32UI ones to EMPTY, and the depth buffer to 1."""
        ...

    def fill(self, texture: Texture) -> None:
        """Set an R32UI texture to EMPTY."""
        ...

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
        """Draw `vertices` without vertex attributes (gl_VertexID counts them) as TRIANGLES, LINES or POINTS.

        blend adds to what is there; over covers it with premultiplied colours, (ONE, ONE_MINUS_SRC_ALPHA), in the
        order of the vertices; mask names the channels that are written; depth_test keeps the nearer (of equals the
        first) and writes depth; cull drops back faces (clockwise on screen). The vertex shader of POINTS sets
        gl_PointSize. `target` None draws into what is bound, within the viewport that is set: Blender's own
        framebuffer in view_draw.
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

    def start_timer(self) -> Timer:
        """Starts timing what follows. DeviceError: a timer is running already."""
        ...

    def stop_timer(self, timer: Timer) -> None:
        """Stops the timer, without waiting for the device."""
        ...

    def bytes_allocated(self) -> int:
        """Bytes of all textures and depth buffers alive on the device."""
        ...

    def release(self) -> None:
        """Free everything; the device is unusable afterwards."""
        ...


P = ParamSpec("P")
S = TypeVar("S")


@contextlib.contextmanager
def released_on_failure(device: Device) -> Iterator[None]:
    """Context manager: releases the textures and targets that its block has made if the block raises."""
    before = set(device.alive)
    try:
        yield
    except Exception:
        for thing in set(device.alive) - before:
            thing.release()
        raise


def releases_on_failure(init: Callable[Concatenate[S, Device, P], None]) -> Callable[Concatenate[S, Device, P], None]:
    """Decorates a constructor (self, device, ...) so that it leaves nothing on the device where it raises."""

    @functools.wraps(init)
    def made(self: S, device: Device, *args: P.args, **named: P.kwargs) -> None:
        with released_on_failure(device):
            init(self, device, *args, **named)

    return made


def wait(device: Device) -> None:
    """Waits until the device has finished its work: reading a texture does so on every device."""
    texel = device.texture((1, 1), "R32F", np.zeros(1, np.float32))
    device.read(texel)
    texel.release()


_TEXEL = (("FLOAT_2D", "ps_texel"),)
LET_GO = Interface("let go", compute="device/let_go.comp", samplers=_TEXEL, images=(("R32UI", "cell"),))
DRAW_NOTHING = Interface(
    "let go", vertex="device/let_go.vert", fragment="device/let_go.frag", samplers=_TEXEL, outputs=(("vec4", "color"),)
)


def let_go(device: Device) -> None:
    """Has the driver let go of what the last draw and dispatch have read: Mesa keeps it, released or not, until others
    have read something in its place."""
    with released_on_failure(device):
        texel, pixel = device.texture((1, 1), "R32F", np.zeros(1, np.float32)), device.texture((1, 1), "R32F")
        target, cell = device.target([pixel]), device.texture((1, 1), "R32UI")
        device.draw(DRAW_NOTHING, target, textures={"ps_texel": texel})
        if device.limits.image_atomics:
            device.fill(cell)
            device.dispatch(LET_GO, 1, textures={"ps_texel": texel}, images={"cell": cell})
        device.read(pixel)
    for one in (target, texel, pixel, cell):
        one.release()


def check_texture(size: tuple[int, int], format: str, data: Texels | None, limits: Limits) -> None:
    """Checks a texture. DeviceError: no device can make it, or the data have another size."""
    width, height = size
    if format not in CHANNELS:
        raise DeviceError(f"no texture format {format}; there are {', '.join(CHANNELS)}")
    if not 1 <= min(size) <= max(size) <= limits.texture_size:
        raise DeviceError(f"a texture of {width} x {height} is outside this GPU's 1 to {limits.texture_size}")
    if data is not None and format == "R32UI":
        raise DeviceError("a texture of unsigned integers takes no data")
    if isinstance(data, np.ndarray) and data.size != width * height * CHANNELS[format]:
        raise DeviceError(f"{data.size} numbers for a texture of {width} x {height} of {format}")


def check_target(colors: Sequence[Texture]) -> None:
    """Checks a target. DeviceError: these textures cannot be written together."""
    if not 1 <= len(colors) <= MAX_OUTPUTS:
        raise DeviceError(f"a target of {len(colors)} textures; 1 to {MAX_OUTPUTS} are possible")
    if len({tuple(texture.size) for texture in colors}) > 1:
        raise DeviceError(f"a target of textures of different sizes: {[texture.size for texture in colors]}")


def check_call(
    interface: Interface,
    target: Target | None,
    uniforms: np.ndarray | None,
    textures: Mapping[str, Texture],
    images: Mapping[str, Texture],
    blend: bool = False,
) -> None:
    """Checks a draw or dispatch. DeviceError: it does not fit its interface, or reads what it writes."""
    name = interface.name
    if interface.block and (uniforms is None or uniforms.dtype != interface.block.dtype() or uniforms.size != 1):
        raise DeviceError(f"{name}: uniforms are not one record of {interface.block.type}")
    for kind, key in interface.samplers:
        if key not in textures:
            raise DeviceError(f"{name}: no texture for {key}")
        if (kind == "UINT_2D") != (textures[key].format == "R32UI"):
            raise DeviceError(f"{name}: {key} is {kind}, its texture {textures[key].format}")
    for format, key in interface.images:
        if key not in images or images[key].format != format:
            raise DeviceError(f"{name}: no texture of format {format} for {key}")
    if target is None:
        return
    if len(interface.outputs) != len(target.colors):
        raise DeviceError(f"{name}: {len(interface.outputs)} outputs into {len(target.colors)} textures")
    if blend and any(texture.format == "R32UI" for texture in target.colors):
        raise DeviceError(f"{name}: unsigned integers cannot be blended")
    read = {id(texture) for texture in textures.values()}
    if any(id(texture) in read for texture in target.colors):
        raise DeviceError(f"{name}: a texture is both read and drawn into")


def to_half(data: np.ndarray) -> np.ndarray:
    """Converts `data` to float16, to the nearest. What is too large, infinities too, becomes the largest float16, and
    NaN becomes 0: light that is too bright for a texture stays bright, where infinities would be drawn black."""
    found = np.empty(data.shape, np.float16)
    flat, values = found.reshape(-1), np.ascontiguousarray(data).reshape(-1)

    def convert(block: slice) -> None:
        with np.errstate(over="ignore"):
            flat[block] = values[block]
        bits = flat[block].view(np.uint16)
        if (bits & 0x7FFF).max(initial=0) >= 0x7C00:
            bits[(bits & 0x7FFF) == 0x7C00] -= 1  # of either sign
            bits[(bits & 0x7FFF) > 0x7C00] = 0

    each_block(flat.size, convert)
    return found


def layout_groups(groups: int) -> tuple[int, int]:
    """Returns (columns, rows) of the smallest grid of at least `groups` work groups; columns are at most MAX_GROUPS.

    There are as few rows as possible.
    """
    rows = max(1, -(-groups // MAX_GROUPS))
    return -(-groups // rows), rows
