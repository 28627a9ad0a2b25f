"""Device on Blender's gpu module: OpenGL, Vulkan or Metal, whichever Blender runs on.

It lives on Blender's main thread, and may draw into the viewport (`draw` with target None). Every
state that it changes is put back. Timers measure the wall clock: Blender offers no way to wait for
the GPU but reading a texture, so a timer may only see the time that handing over the work took.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import gpu
import numpy as np

from ..core.numeric.blocks import empty_block
from ..core.numeric.vectors import each_block
from ..render.device import protocol as checks
from ..render.device.protocol import CHANNELS, DEPTH_BYTES, DeviceError, Limits, Target, Texture, Timer, to_half
from ..shading import sources
from ..shading.interface import Interface
from .probe import capabilities

MODES = {"TRIANGLES": "TRIS", "LINES": "LINES", "POINTS": "POINTS"}
IMAGE_TYPES = {"R32UI": "UINT_2D_ATOMIC", "RGBA32F": "FLOAT_2D"}
LOG_STAGE = re.compile(r"pyGPU_Shader\W+(vert|frag|comp)", re.IGNORECASE)
LOG_LINE = re.compile(r"python_shader\.glsl:(\d+)")  # from Blender 5 on; 4.5 prints no line that can be relied on


def available() -> tuple[bool, str]:
    """Whether this thread can draw with Blender's gpu module, and if not, why."""
    # Only the main thread may start it: the context belongs to the thread that does.
    if hasattr(gpu, "init") and threading.current_thread() is threading.main_thread():
        try:
            gpu.init()
        except (SystemError, RuntimeError) as error:
            return False, str(error)
    try:
        gpu.types.GPUTexture((1, 1), format="R32F")
    except (SystemError, RuntimeError) as error:
        return False, str(error)
    return True, ""


class BlenderTexture:
    def __init__(self, device: BlenderDevice, size: tuple[int, int], format: str, data: checks.Texels | None):
        self.size, self.format = size, format
        given = data if isinstance(data, np.ndarray) else None
        if data is not None and not isinstance(data, np.ndarray):
            data = _written(data, size[0] * size[1], CHANNELS[format])
        if data is not None and format == "RGBA16F":
            # Exact for any driver then: Blender 4.5 would round towards zero.
            data = _rounded_to_half(data.reshape(-1), np.empty(data.size, np.float32) if data is given else data)
        content = {} if data is None else {"data": _buffer(data)}
        self.handle: Any = gpu.types.GPUTexture(size, format=format, **content)
        if hasattr(self.handle, "filter_mode"):
            self.handle.filter_mode(False)
        self.nbytes = size[0] * size[1] * checks.BYTES_PER_PIXEL[format]
        self._alive = device.alive
        self._alive.add(self)

    def release(self) -> None:
        self._alive.discard(self)
        self.handle = None


class BlenderTarget:
    def __init__(self, device: BlenderDevice, colors: Sequence[Texture], depth: bool):
        self.colors: tuple[Texture, ...] = tuple(colors)
        width, height = size = colors[0].size
        self.depth = gpu.types.GPUTexture(size, format="DEPTH_COMPONENT32F") if depth else None
        slots: dict[str, object] = {"color_slots": tuple(texture.handle for texture in colors)}
        if self.depth:
            slots["depth_slot"] = self.depth
        # Not a GPUOffScreen: making one inside view_draw loses all that is drawn after it.
        self.handle: Any = gpu.types.GPUFrameBuffer(**slots)
        self.nbytes = width * height * DEPTH_BYTES if depth else 0
        self._alive = device.alive
        self._alive.add(self)

    def release(self) -> None:
        self._alive.discard(self)
        self.handle = self.depth = None


class BlenderTimer:
    """A timer that measures the wall clock."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._end: float | None = None

    def stop(self) -> None:
        self._end = time.perf_counter()

    def milliseconds(self) -> float:
        return 1000.0 * ((self._end or time.perf_counter()) - self._start)

    def release(self) -> None:
        pass


class BlenderDevice:
    name = "blender_gpu"

    def __init__(self) -> None:
        """Raise DeviceError where this thread has no GPU context."""
        ok, reason = available()
        if not ok:
            raise DeviceError(f"Blender's gpu module cannot draw here: {reason}")
        self.alive: set[BlenderTexture | BlenderTarget] = set()
        self._programs: dict[Interface, gpu.types.GPUShader] = {}
        self._blocks: dict[int, gpu.types.GPUUniformBuf] = {}
        self._batches: dict[str, tuple[int, gpu.types.GPUBatch]] = {}
        self._timing: BlenderTimer | None = None
        renderer = f"{gpu.platform.renderer_get()}, {gpu.platform.backend_type_get()}"
        self.limits = Limits(renderer, gpu.capabilities.max_texture_size_get(), False, False)
        atomics, blend = capabilities(self, compute=True)
        driver = f"{gpu.platform.vendor_get()}, {renderer}, {gpu.platform.version_get()}"
        self.limits = replace(self.limits, image_atomics=atomics, float_blend=blend, driver=f"Blender, {driver}")

    def texture(self, size: tuple[int, int], format: str, data: checks.Texels | None = None) -> BlenderTexture:
        checks.check_texture(size, format, data, self.limits)
        return BlenderTexture(self, size, format, data)

    def target(self, colors: Sequence[Texture], depth: bool = False) -> BlenderTarget:
        checks.check_target(colors)
        return BlenderTarget(self, colors, depth)

    def clear(self, target: Target, color: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        with _saved_state(), target.handle.bind():
            if target.depth:
                target.handle.clear(color=color, depth=1.0)
            else:
                target.handle.clear(color=color)
        for texture in target.colors:
            if texture.format == "R32UI":
                self.fill(texture)

    def fill(self, texture: Texture) -> None:
        texture.handle.clear(format="UINT", value=(-1,))  # larger numbers than 2^31 - 1 are refused

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
        if vertices == 0:
            return
        program = self._program(interface)
        batch = self._batch(primitive, vertices)
        with _saved_state(), target.handle.bind() if target else contextlib.nullcontext():
            # Blender's names for (ONE, ONE) and (ONE, ONE_MINUS_SRC_ALPHA).
            gpu.state.blend_set("ADDITIVE_PREMULT" if blend else "ALPHA_PREMULT" if over else "NONE")
            gpu.state.color_mask_set(*(channel in mask for channel in "RGBA"))
            gpu.state.depth_test_set("LESS" if depth_test else "NONE")
            gpu.state.depth_mask_set(depth_test)
            gpu.state.face_culling_set("BACK" if cull else "NONE")
            gpu.state.program_point_size_set(primitive == "POINTS")
            if primitive == "LINES":
                gpu.state.line_width_set(1.0)
            self._bind(interface, program, uniforms, textures or {})
            batch.draw_range(program, elem_start=0, elem_count=vertices)

    def dispatch(
        self,
        interface: Interface,
        groups: int,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, Texture] | None = None,
        images: Mapping[str, Texture] | None = None,
    ) -> None:
        checks.check_call(interface, None, uniforms, textures or {}, images or {})
        if groups == 0:
            return
        program = self._program(interface)
        self._bind(interface, program, uniforms, textures or {})
        for _, name in interface.images:
            with contextlib.suppress(ValueError):  # declared, but the compiler found no use of it
                program.image(name, (images or {})[name].handle)
        gpu.compute.dispatch(program, *checks.layout_groups(groups), 1)

    def read(self, texture: Texture) -> np.ndarray:
        width, height = texture.size
        pixels = texture.handle.read()
        # Buffers of more than one dimension have reversed strides in Blender 4.5.
        pixels.dimensions = width * height * CHANNELS[texture.format]
        shape = (height, width) if texture.format == "R32UI" else (height, width, CHANNELS[texture.format])
        return np.asarray(pixels).reshape(shape)

    def start_timer(self) -> BlenderTimer:
        if self._timing:
            raise DeviceError("a timer is running already")
        self._timing = BlenderTimer()
        return self._timing

    def stop_timer(self, timer: Timer) -> None:
        timer.stop()
        self._timing = None

    def bytes_allocated(self) -> int:
        return sum(thing.nbytes for thing in self.alive)

    def release(self) -> None:
        for thing in list(self.alive):
            thing.release()
        self._programs.clear()
        self._blocks.clear()
        self._batches.clear()

    def _program(self, interface: Interface) -> gpu.types.GPUShader:
        if interface not in self._programs:
            self._programs[interface] = _compile(interface)
        return self._programs[interface]

    def _batch(self, primitive: str, vertices: int) -> gpu.types.GPUBatch:
        """Returns a batch of at least `vertices`. Blender wants a vertex buffer, although shaders count with
        gl_VertexID."""
        size, batch = self._batches.get(primitive, (0, None))
        if batch is None or size < vertices:
            size = 1 << max(6, (vertices - 1).bit_length())
            format = gpu.types.GPUVertFormat()
            format.attr_add(id="unused", comp_type="F32", len=1, fetch_mode="FLOAT")
            batch = gpu.types.GPUBatch(type=MODES[primitive], buf=gpu.types.GPUVertBuf(format, size))
            self._batches[primitive] = size, batch
        return batch

    def _bind(
        self,
        interface: Interface,
        program: gpu.types.GPUShader,
        uniforms: np.ndarray | None,
        textures: Mapping[str, Texture],
    ) -> None:
        program.bind()
        if interface.block and uniforms is not None:
            data, size = _buffer(np.ascontiguousarray(uniforms).view(np.float32)), uniforms.nbytes
            if size in self._blocks:
                self._blocks[size].update(data)
            else:
                self._blocks[size] = gpu.types.GPUUniformBuf(data)
            with contextlib.suppress(ValueError):  # as for images
                program.uniform_block(interface.block.name, self._blocks[size])
        for _, name in interface.samplers:
            with contextlib.suppress(ValueError):
                program.uniform_sampler(name, textures[name].handle)


def _written(write: checks.WriteTexels, count: int, channels: int) -> np.ndarray:
    """All texels at once: parts of a texture cannot be replaced here."""
    texels = empty_block({"": ((count, channels), np.dtype(np.float32))})[""]  # which goes back to the system at once
    write(texels, slice(0, count))
    return texels.reshape(-1)


def _rounded_to_half(data: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Returns `out`, which may be `data`, with what float16 holds of the numbers. data, out: (n,) float32."""

    def convert(block: slice) -> None:
        out[block] = to_half(data[block])

    each_block(len(data), convert)
    return out


def _buffer(array: np.ndarray) -> gpu.types.Buffer:
    """Returns float32 numbers for the gpu module, which checks neither type nor layout."""
    flat = np.ascontiguousarray(array, np.float32).reshape(-1)
    return gpu.types.Buffer("FLOAT", flat.size, flat)


@contextlib.contextmanager
def _saved_state() -> Iterator[None]:
    """Restores the state that drawing changes. What cannot be asked for goes back to Blender's default."""
    state = gpu.state
    blend, depth_test, depth_mask = state.blend_get(), state.depth_test_get(), state.depth_mask_get()
    line_width = state.line_width_get()
    try:
        yield
    finally:
        state.blend_set(blend)
        state.depth_test_set(depth_test)
        state.depth_mask_set(depth_mask)
        state.line_width_set(line_width)
        state.color_mask_set(True, True, True, True)
        state.face_culling_set("NONE")
        state.program_point_size_set(False)


def _compile(interface: Interface) -> gpu.types.GPUShader:
    if interface.compute:
        files = {"compute": interface.compute}
    else:
        files = {"vertex": interface.vertex, "fragment": interface.fragment}
    loaded = {stage: sources.load(file) for stage, file in files.items()}
    info = _create_info(interface)
    for stage, source in loaded.items():
        getattr(info, f"{stage}_source")(source.text)
    try:
        return gpu.shader.create_from_info(info)
    except Exception as error:  # the gpu module raises a plain one
        log = _explain(_log_of(info), loaded)
        names = ", ".join(files.values())
        raise sources.ShaderError(f"{interface.name}, {names}: {log or error}") from error


def _create_info(interface: Interface) -> gpu.types.GPUShaderCreateInfo:
    """Returns Blender's description of a shader, with the declarations that Interface.header prints."""
    info = gpu.types.GPUShaderCreateInfo()
    for name, value in interface.defines:
        info.define(name, value)
    if interface.block:
        info.typedef_source(interface.block.struct())
        info.uniform_buf(0, interface.block.type, interface.block.name)
    for slot, (kind, name) in enumerate(interface.samplers):
        info.sampler(slot, kind, name)
    if interface.compute:
        info.local_group_size(interface.local_size)
        for slot, (format, name) in enumerate(interface.images):
            info.image(slot, format, IMAGE_TYPES[format], name, qualifiers={"READ", "WRITE"})
        return info
    if interface.varyings:
        stage = gpu.types.GPUStageInterfaceInfo("ps_varyings")
        for how, glsl, name in interface.varyings:
            getattr(stage, how)(glsl.upper(), name)
        info.vertex_out(stage)
    for slot, (glsl, name) in enumerate(interface.outputs):
        info.fragment_out(slot, glsl.upper(), name)
    if interface.depth:
        info.depth_write("ANY")
    return info


def _log_of(info: gpu.types.GPUShaderCreateInfo) -> str:
    """Returns what Blender prints when `info` fails to compile: the exception itself says nothing."""
    with tempfile.TemporaryFile() as file:
        try:
            saved = os.dup(1), os.dup(2)
        except OSError:  # a program without a console
            return ""
        sys.stdout.flush()
        sys.stderr.flush()
        try:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            with contextlib.suppress(Exception):
                gpu.shader.create_from_info(info)
        finally:
            for descriptor, copy in zip((1, 2), saved, strict=True):
                os.dup2(copy, descriptor)
                os.close(copy)
        file.seek(0)
        return file.read().decode(errors="replace")


def _explain(log: str, loaded: Mapping[str, sources.Source]) -> str:
    """Returns Blender's log with the lines of the joined text replaced by those of the files."""
    lines, stage = [], next(iter(loaded))
    for line in log.splitlines():
        heading = LOG_STAGE.search(line)
        if heading:
            stage = next((s for s in loaded if s.startswith(heading.group(1).lower())), stage)
        lines.append(LOG_LINE.sub(lambda match, s=stage: loaded[s].location(int(match.group(1))), line))
    return "\n".join(lines).strip()
