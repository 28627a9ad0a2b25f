"""Device on an OpenGL context of its own, made by moderngl. Works with and without Blender.

In Blender it must live on a thread of its own: a context made on the main thread would take the
place of Blender's.
"""

from __future__ import annotations

import ctypes
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import glcontext
import moderngl
import numpy as np

from ..render.device import protocol as checks
from ..render.device.protocol import CHANNELS, DEPTH_BYTES, EMPTY, DeviceError, Limits, Target, Texture, Timer, to_half
from ..shading import sources
from ..shading.interface import Interface
from .probe import capabilities

KINDS = {"RGBA32F": "f4", "RGBA16F": "f2", "RG32F": "f4", "R32F": "f4", "R32UI": "u4"}
MODES = {"TRIANGLES": moderngl.TRIANGLES, "LINES": moderngl.LINES, "POINTS": moderngl.POINTS}
BAND = 1 << 19  # texels that are written at once
COMPUTE_VERSION = 430  # the first with compute shaders
OLDEST_VERSION = 410  # macOS has no newer one
GL_RENDERBUFFER, GL_DEPTH_COMPONENT32F = 0x8D41, 0x8CAC
GL_COLOR, GL_DEPTH = 0x1800, 0x1801
GL_TIME_ELAPSED, GL_QUERY_RESULT = 0x88BF, 0x8866
# A query that begins anew frees the fence that it waited for. A thread of Mesa 22.3's llvmpipe may have signalled that
# and not yet unlocked it, which then writes into what was freed: what others have ended after, all threads have left.
SPARE_QUERIES = 8
EMPTY_TEXEL = (ctypes.c_uint * 4)(EMPTY, EMPTY, EMPTY, EMPTY)
FARTHEST_DEPTH = (ctypes.c_float * 1)(1.0)


class OpenGLTexture:
    def __init__(self, device: OpenGLDevice, size: tuple[int, int], format: str, data: checks.Texels | None):
        self.size, self.format = size, format
        kind = KINDS[format]
        whole = _stored(data, format) if isinstance(data, np.ndarray) else None
        self.handle = device.context.texture(size, CHANNELS[format], whole, dtype=kind, alignment=1)  # pyright: ignore[reportArgumentType]
        self.handle.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.handle.repeat_x = self.handle.repeat_y = False
        self.nbytes = size[0] * size[1] * checks.BYTES_PER_PIXEL[format]
        self._context = device.context
        self._target: moderngl.Framebuffer | None = None
        self._alive = device.alive
        self._alive.add(self)
        if data is not None and not isinstance(data, np.ndarray):
            self._write(data)

    def _write(self, write: checks.WriteTexels) -> None:
        """Fills the texture band by band: what is on its way to the device stays in the processor's cache."""
        width, height = self.size
        rows = max(1, BAND // width)
        band = np.empty((min(rows, height) * width, CHANNELS[self.format]), np.float32)
        for low in range(0, height, rows):
            high = min(low + rows, height)
            texels = band[: (high - low) * width]
            write(texels, slice(low * width, high * width))
            self.handle.write(_stored(texels, self.format), viewport=(0, low, width, high - low), alignment=1)

    @property
    def target(self) -> moderngl.Framebuffer:
        """What draws into this texture alone; made at the first call."""
        self._target = self._target or self._context.framebuffer([self.handle])
        return self._target

    def release(self) -> None:
        if self in self._alive:
            self._alive.remove(self)
            if self._target is not None:
                self._target.release()
            self.handle.release()


class OpenGLTarget:
    def __init__(self, device: OpenGLDevice, colors: Sequence[Texture], depth: bool):
        self.colors: tuple[Texture, ...] = tuple(colors)
        width, height = size = colors[0].size
        self.depth = None
        if depth:
            # moderngl makes 24 bits; Blender has 32-bit floats, and which points tie depends on it.
            self.depth = device.context.depth_renderbuffer(size)
            device.bind_renderbuffer(GL_RENDERBUFFER, self.depth.glo)
            device.renderbuffer_storage(GL_RENDERBUFFER, GL_DEPTH_COMPONENT32F, width, height)
        self.handle = device.context.framebuffer([texture.handle for texture in colors], self.depth)
        self.nbytes = width * height * DEPTH_BYTES if depth else 0
        self._alive = device.alive
        self._alive.add(self)

    def release(self) -> None:
        if self in self._alive:
            self._alive.remove(self)
            self.handle.release()
            if self.depth:
                self.depth.release()


class OpenGLTimer:
    """Time on the GPU itself, by a query: moderngl's have 32 bits of nanoseconds, 4.3 seconds at most."""

    def __init__(self, device: OpenGLDevice, query: int):
        self._device, self._elapsed = device, -1.0
        self._started = 0.0
        self._query: int | None = query  # None: the device has it back

    def start(self) -> None:
        if self._query is not None:
            self._started = time.perf_counter()
            self._device.begin_query(GL_TIME_ELAPSED, self._query)

    def stop(self) -> None:
        if self._query is not None:
            self._device.end_query(GL_TIME_ELAPSED)

    def milliseconds(self) -> float:
        if self._query is not None:
            nanoseconds = ctypes.c_uint64()
            self._device.query_result(self._query, GL_QUERY_RESULT, ctypes.addressof(nanoseconds))
            # At times llvmpipe answers with the time since the machine was started.
            self._elapsed = min(nanoseconds.value / 1e6, 1e3 * (time.perf_counter() - self._started))
            self.release()
        if self._elapsed < 0.0:
            raise DeviceError("this timer was released before it was read")
        return self._elapsed

    def release(self) -> None:
        # A query can begin anew whether or not it was read or has ended.
        if self._query is not None:
            self._device.free_queries.append(self._query)
        self._query = None


class OpenGLDevice:
    name = "opengl"

    def __init__(self) -> None:
        """Raise DeviceError where no context of OpenGL 4.1 or newer can be made."""
        self.context, gl = _make_context()
        values = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p  # which buffers, index of the texture, its value
        self._clear_integers = _function(gl, "glClearBufferuiv", *values)
        self._clear_floats = _function(gl, "glClearBufferfv", *values)
        self.bind_renderbuffer = _function(gl, "glBindRenderbuffer", ctypes.c_uint, ctypes.c_uint)
        self.renderbuffer_storage = _function(
            gl, "glRenderbufferStorage", ctypes.c_uint, ctypes.c_uint, ctypes.c_int, ctypes.c_int
        )
        # moderngl keeps Python's lock during these, in which software renderers draw for long. Without it another
        # thread builds hierarchies meanwhile, and Blender's window stays alive.
        self._use_program = _function(gl, "glUseProgram", ctypes.c_uint)
        self._dispatch = _function(gl, "glDispatchCompute", *[ctypes.c_uint] * 3)
        self._finish = _function(gl, "glFinish")
        self.version = COMPUTE_VERSION if self.context.version_code >= COMPUTE_VERSION else OLDEST_VERSION
        self.alive: set[OpenGLTexture | OpenGLTarget] = set()
        self._make_queries = _function(gl, "glGenQueries", ctypes.c_int, ctypes.c_void_p)
        self.begin_query = _function(gl, "glBeginQuery", ctypes.c_uint, ctypes.c_uint)
        self.end_query = _function(gl, "glEndQuery", ctypes.c_uint)
        self.query_result = _function(gl, "glGetQueryObjectui64v", ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p)
        self.free_queries: deque[int] = deque()  # each is used again, the one that ended first
        self._timing: OpenGLTimer | None = None
        self._programs: dict[Interface, tuple[moderngl.Program | moderngl.ComputeShader, object]] = {}
        self._blocks: dict[int, moderngl.Buffer] = {}
        self._released = False
        info = self.context.info
        self.limits = Limits(f"{info['GL_RENDERER']}, OpenGL {self.version}", info["GL_MAX_TEXTURE_SIZE"], False, False)
        atomics, blend = capabilities(self, compute=self.version >= COMPUTE_VERSION)
        driver = ", ".join(info[f"GL_{name}"] for name in ("VENDOR", "RENDERER", "VERSION"))
        self.limits = replace(self.limits, image_atomics=atomics, float_blend=blend, driver=f"OpenGL, {driver}")

    def texture(self, size: tuple[int, int], format: str, data: checks.Texels | None = None) -> OpenGLTexture:
        checks.check_texture(size, format, data, self.limits)
        return OpenGLTexture(self, size, format, data)

    def target(self, colors: Sequence[Texture], depth: bool = False) -> OpenGLTarget:
        checks.check_target(colors)
        return OpenGLTarget(self, colors, depth)

    def clear(self, target: Target, color: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        target.handle.use()
        for index, texture in enumerate(target.colors):
            if texture.format == "R32UI":
                self._clear_integers(GL_COLOR, index, EMPTY_TEXEL)
            else:
                self._clear_floats(GL_COLOR, index, (ctypes.c_float * 4)(*color))
        if target.depth is not None:  # type: ignore[attr-defined]
            self._clear_floats(GL_DEPTH, 0, FARTHEST_DEPTH)

    def fill(self, texture: Texture) -> None:
        texture.target.use()  # type: ignore[attr-defined]
        self._clear_integers(GL_COLOR, 0, EMPTY_TEXEL)

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
        if target is None:
            raise DeviceError(f"{interface.name}: this device has no screen to draw on")
        checks.check_call(interface, target, uniforms, textures or {}, {}, blend or over)
        if vertices == 0:
            return
        program, array = self._program(interface)
        self._bind(interface, program, uniforms, textures or {})
        _set_mask(target, mask)
        target.handle.use()
        context = self.context
        context.enable_only(
            moderngl.PROGRAM_POINT_SIZE
            | (moderngl.BLEND if blend or over else 0)
            | (moderngl.DEPTH_TEST if depth_test else 0)
            | (moderngl.CULL_FACE if cull else 0)
        )
        context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA if over else moderngl.ONE
        context.depth_func = "<"
        array.render(MODES[primitive], vertices=vertices)  # type: ignore[attr-defined]
        _set_mask(target, "RGBA")

    def dispatch(
        self,
        interface: Interface,
        groups: int,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, Texture] | None = None,
        images: Mapping[str, Texture] | None = None,
    ) -> None:
        if self.version < COMPUTE_VERSION:
            raise DeviceError(f"{interface.name}: this OpenGL has no compute shaders")
        checks.check_call(interface, None, uniforms, textures or {}, images or {})
        if groups == 0:
            return
        program, _ = self._program(interface)
        self._bind(interface, program, uniforms, textures or {})
        for unit, (_, name) in enumerate(interface.images):
            if images:  # their units stand in the header: moderngl sets no uniforms of images
                images[name].handle.bind_to_image(unit)
        self._use_program(program.glo)
        self._dispatch(*checks.layout_groups(groups), 1)
        self.context.memory_barrier()

    def read(self, texture: Texture) -> np.ndarray:
        width, height = texture.size
        kind = KINDS[texture.format]
        array = np.empty((height, width, CHANNELS[texture.format]), kind)
        self.finish()
        texture.handle.read_into(array, alignment=1)  # pyright: ignore[reportArgumentType]
        return array[..., 0] if kind == "u4" else array.astype(np.float32, copy=False)

    def finish(self) -> None:
        """Waits until all is drawn, without Python's lock."""
        self._finish()

    def start_timer(self) -> OpenGLTimer:
        if self._timing:
            raise DeviceError("a timer is running already")
        while len(self.free_queries) < SPARE_QUERIES:
            query = ctypes.c_uint()
            self._make_queries(1, ctypes.addressof(query))
            self.free_queries.append(query.value)
        self._timing = OpenGLTimer(self, self.free_queries.popleft())
        self._timing.start()
        return self._timing

    def stop_timer(self, timer: Timer) -> None:
        timer.stop()
        self._timing = None

    def bytes_allocated(self) -> int:
        return sum(thing.nbytes for thing in self.alive)

    def release(self) -> None:
        if self._released:
            return
        self._released = True
        for thing in list(self.alive):
            thing.release()
        self._programs.clear()
        self._blocks.clear()
        self.context.release()

    def _program(self, interface: Interface):
        if interface not in self._programs:
            self._programs[interface] = self._compile(interface)
        return self._programs[interface]

    def _compile(self, interface: Interface):
        if interface.compute:
            files = {"compute": interface.compute}
        else:
            files = {"vertex": interface.vertex, "fragment": interface.fragment}
        loaded = {stage: sources.load(file) for stage, file in files.items()}
        text = {stage: interface.header(stage, self.version) + source.body for stage, source in loaded.items()}
        try:
            if interface.compute:
                return self.context.compute_shader(text["compute"]), None
            program = self.context.program(vertex_shader=text["vertex"], fragment_shader=text["fragment"])
            return program, self.context.vertex_array(program, [])
        except moderngl.Error as error:
            log = str(error)
            stage = "vertex" if "vertex_shader" in log else list(files)[-1]
            raise sources.ShaderError(f"{interface.name}, {files[stage]}: {loaded[stage].explain(log)}") from error

    def _bind(self, interface: Interface, program, uniforms: np.ndarray | None, textures: Mapping[str, Texture]):
        if interface.block and uniforms is not None and f"{interface.block.type}_block" in program:
            size = uniforms.nbytes
            if size not in self._blocks:
                self._blocks[size] = self.context.buffer(reserve=size, dynamic=True)
            self._blocks[size].orphan(size)
            self._blocks[size].write(uniforms.tobytes())
            self._blocks[size].bind_to_uniform_block(0)
            program[f"{interface.block.type}_block"].binding = 0
        for unit, (_, name) in enumerate(interface.samplers):
            if name in program:
                textures[name].handle.use(unit)
                program[name] = unit


def _stored(values: np.ndarray, format: str) -> np.ndarray:
    """Numbers as a texture of the format takes them."""
    return to_half(values) if format == "RGBA16F" else np.ascontiguousarray(values, np.float32)


def _set_mask(target: Target, mask: str) -> None:
    """Which channels of a target are written when it is used next."""
    channels = tuple(channel in mask for channel in "RGBA")
    given = channels if len(target.colors) == 1 else (channels,) * len(target.colors)
    if target.handle.color_mask != given:  # type: ignore[attr-defined]
        target.handle.color_mask = given  # type: ignore[attr-defined]


def _make_context() -> tuple[moderngl.Context, object]:
    """A context off any screen, and its loader of functions: EGL where there is one (no display server
    needed), else the platform's own; the newest that is needed first, because some drivers give exactly
    the version that was asked for.
    """
    failures = []
    for backend in (_egl_by_name, lambda: glcontext.get_backend_by_name("egl"), glcontext.default_backend):
        for version in (COMPUTE_VERSION, OLDEST_VERSION):
            try:
                loader = backend()(mode="standalone", glversion=version)
                return moderngl.create_context(standalone=True, require=version, context=loader), loader
            except Exception as error:  # glcontext raises a plain one, or OSError for a missing library
                failures.append(str(error))
    raise DeviceError("no OpenGL 4.1 context: " + "; ".join(dict.fromkeys(failures)))


def _egl_by_name() -> Callable[..., Any]:
    """EGL from the libraries as Linux names them. glcontext asks other programs for these names, which takes a third
    of the time until there is a context. ImportError: this is not Linux."""
    from glcontext import egl

    return partial(egl.create_context, libgl="libGL.so.1", libegl="libEGL.so.1")


def _function(loader, name: str, *arguments: type) -> Callable[..., None]:
    """An OpenGL function that moderngl does not offer."""
    return ctypes.CFUNCTYPE(None, *arguments)(loader.load(name))
