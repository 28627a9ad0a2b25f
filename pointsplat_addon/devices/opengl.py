"""Device on an OpenGL context of its own, made by moderngl. Works with and without Blender.

In Blender it must live on a thread of its own: a context made on the main thread would take the
place of Blender's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import moderngl
import numpy as np

from ..render.device import EMPTY, DeviceError, Limits
from ..shading import sources
from ..shading.interface import Interface

FORMATS = {"RGBA32F": (4, "f4"), "RGBA16F": (4, "f2"), "RG32F": (2, "f4"), "R32F": (1, "f4"), "R32UI": (1, "u4")}
MODES = {"TRIANGLES": moderngl.TRIANGLES, "LINES": moderngl.LINES, "POINTS": moderngl.POINTS}
MAX_GROUPS = 65535


class OpenGLTexture:
    def __init__(self, device: OpenGLDevice, size: tuple[int, int], format: str, data: bytes | None):
        components, kind = FORMATS[format]
        self.size, self.format = size, format
        self.handle = device.context.texture(size, components, data, dtype=kind, alignment=1)
        self.handle.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.handle.repeat_x = self.handle.repeat_y = False
        self.nbytes = size[0] * size[1] * components * np.dtype(kind).itemsize
        self._device = device
        device.textures.add(self)

    def release(self) -> None:
        if self in self._device.textures:
            self._device.textures.remove(self)
            self.handle.release()


class OpenGLTarget:
    def __init__(self, device: OpenGLDevice, colors: Sequence[OpenGLTexture], depth: bool):
        self.depth = device.context.depth_renderbuffer(colors[0].size) if depth else None
        self.handle = device.context.framebuffer([c.handle for c in colors], self.depth)

    def release(self) -> None:
        self.handle.release()
        if self.depth:
            self.depth.release()


class OpenGLTimer:
    def __init__(self, context: moderngl.Context):
        self.query = context.query(time=True)
        self.query.mglo.begin()

    def milliseconds(self) -> float:
        return self.query.elapsed / 1e6


class OpenGLDevice:
    name = "opengl"

    def __init__(self) -> None:
        """Raise DeviceError where no context of OpenGL 4.1 or newer can be made."""
        self.context = _make_context()
        self.version = 430 if self.context.version_code >= 430 else 410
        self.textures: set[OpenGLTexture] = set()
        self._programs: dict[Interface, tuple[moderngl.Program | moderngl.ComputeShader, object]] = {}
        self._blocks: dict[int, moderngl.Buffer] = {}
        self._empty: moderngl.Buffer | None = None
        self._atomics_probe: bool | None = None
        info = self.context.info
        self.limits = Limits(
            renderer=info["GL_RENDERER"],
            texture_size=info["GL_MAX_TEXTURE_SIZE"],
            image_atomics=self.version >= 430,
            float_blend=True,  # core since OpenGL 3.0
        )

    def texture(self, size: tuple[int, int], format: str, data: np.ndarray | None = None) -> OpenGLTexture:
        if max(size) > self.limits.texture_size:
            raise DeviceError(f"a texture of {size[0]} x {size[1]} exceeds this GPU's {self.limits.texture_size}")
        raw = None
        if data is not None:
            raw = np.ascontiguousarray(data, np.float16 if FORMATS[format][1] == "f2" else np.float32)
        return OpenGLTexture(self, size, format, raw)  # pyright: ignore[reportArgumentType]

    def target(self, colors: Sequence[OpenGLTexture], depth: bool = False) -> OpenGLTarget:
        return OpenGLTarget(self, colors, depth)

    def clear(self, target: OpenGLTarget, color: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        target.handle.clear(*color, depth=1.0)

    def fill(self, texture: OpenGLTexture) -> None:
        size = texture.nbytes
        if self._empty is None or self._empty.size < size:
            self._empty = self.context.buffer(np.full(size // 4, EMPTY, np.uint32))
        texture.handle.write(self._empty)

    def draw(
        self,
        interface: Interface,
        target: OpenGLTarget,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, OpenGLTexture] | None = None,
        vertices: int = 3,
        primitive: str = "TRIANGLES",
        blend: bool = False,
        depth_test: bool = False,
        cull: bool = False,
    ) -> None:
        program, array = self._program(interface)
        self._bind(interface, program, uniforms, textures or {})
        target.handle.use()
        context = self.context
        context.enable_only(
            (moderngl.BLEND if blend else 0)
            | (moderngl.DEPTH_TEST if depth_test else 0)
            | (moderngl.CULL_FACE if cull else 0)
        )
        context.blend_func = moderngl.ONE, moderngl.ONE
        context.depth_func = "<"
        array.render(MODES[primitive], vertices=vertices)  # type: ignore[attr-defined]

    def dispatch(
        self,
        interface: Interface,
        groups: int,
        *,
        uniforms: np.ndarray | None = None,
        textures: Mapping[str, OpenGLTexture] | None = None,
        images: Mapping[str, OpenGLTexture] | None = None,
    ) -> None:
        if groups == 0:
            return
        program, _ = self._program(interface)
        self._bind(interface, program, uniforms, textures or {})
        for unit, (_, name) in enumerate(interface.images):
            if name in program and images:
                images[name].handle.bind_to_image(unit)
                program[name] = unit
        columns = min(groups, MAX_GROUPS)
        program.run(columns, -(-groups // columns))  # type: ignore[union-attr]
        self.context.memory_barrier()

    def read(self, texture: OpenGLTexture) -> np.ndarray:
        components, kind = FORMATS[texture.format]
        width, height = texture.size
        array = np.frombuffer(texture.handle.read(alignment=1), kind)
        if kind == "u4":
            return array.reshape(height, width)
        return array.reshape(height, width, components).astype(np.float32)

    def start_timer(self) -> OpenGLTimer:
        return OpenGLTimer(self.context)

    def stop_timer(self, timer: OpenGLTimer) -> None:
        timer.query.mglo.end()

    def bytes_allocated(self) -> int:
        return sum(texture.nbytes for texture in self.textures)

    def release(self) -> None:
        self.textures.clear()
        self._programs.clear()
        self.context.release()

    def _program(self, interface: Interface):
        if interface not in self._programs:
            self._programs[interface] = self._compile(interface)
        return self._programs[interface]

    def _compile(self, interface: Interface):
        stages = (
            {"compute": interface.compute}
            if interface.compute
            else {
                "vertex": interface.vertex,
                "fragment": interface.fragment,
            }
        )
        loaded = {stage: sources.load(file) for stage, file in stages.items()}
        text = {stage: interface.header(stage, self.version) + source.text for stage, source in loaded.items()}
        try:
            if interface.compute:
                return self.context.compute_shader(text["compute"]), None
            program = self.context.program(vertex_shader=text["vertex"], fragment_shader=text["fragment"])
            return program, self.context.vertex_array(program, [])
        except moderngl.Error as error:
            stage = "vertex" if "vertex_shader" in str(error) else list(stages)[-1]
            raise sources.ShaderError(f"{interface.name}: {loaded[stage].explain(str(error))}") from error

    def _bind(self, interface: Interface, program, uniforms: np.ndarray | None, textures: Mapping[str, OpenGLTexture]):
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


def _make_context() -> moderngl.Context:
    """A context off any screen: EGL where there is one (no display server needed), else the platform's own."""
    failures = []
    for options in ({"backend": "egl"}, {}):
        try:
            return moderngl.create_context(standalone=True, require=410, **options)
        except Exception as error:  # noqa: BLE001 - glcontext raises plain Exception, and OSError for a missing library
            failures.append(str(error))
    raise DeviceError("no OpenGL 4.1 context: " + "; ".join(failures))
