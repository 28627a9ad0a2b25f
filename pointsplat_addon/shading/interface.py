"""What a shader reads and writes, declared once.

Shader bodies hold no `#version`, `in`, `out`, `uniform` or `layout`. `header` prints these for plain
OpenGL; a device with its own way of declaring (Blender's GPUShaderCreateInfo) reads the same fields.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from ..core.numeric.record import value_record

# GLSL type: (numpy format, count, alignment in bytes), std140. Types whose array stride or size is
# surprising (vec3, mat3, arrays) are left out on purpose.
STD140 = {
    "float": ("<f4", 1, 4),
    "int": ("<i4", 1, 4),
    "uint": ("<u4", 1, 4),
    "vec2": ("<f4", 2, 8),
    "ivec2": ("<i4", 2, 8),
    "vec4": ("<f4", 4, 16),
    "ivec4": ("<i4", 4, 16),
    "mat4": ("<f4", 16, 16),
}

SAMPLERS = {"FLOAT_2D": "sampler2D", "UINT_2D": "usampler2D"}
IMAGES = {"R32UI": "uimage2D", "RGBA32F": "image2D"}


@value_record
class Block:
    """A uniform block `name` of struct type `type`: both the GLSL struct and the numpy record come from `fields`."""

    type: str
    name: str
    fields: tuple[tuple[str, str], ...]  # (GLSL type, field name)

    @functools.cache  # noqa: B019 - blocks are constants
    def dtype(self) -> np.dtype:
        """The std140 layout as a numpy record; mat4 fields are (16,) column-major."""
        names, formats, offsets, end = [], [], [], 0
        for glsl, name in self.fields:
            base, count, align = STD140[glsl]
            end = -(-end // align) * align
            names.append(name)
            formats.append((base, (count,)) if count > 1 else base)
            offsets.append(end)
            end += 4 * count
        size = max(16, -(-end // 16) * 16)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})

    def extended(self, name: str, *fields: tuple[str, str]) -> Block:
        """A block with further fields at its end. `name`: what the name of its struct type adds."""
        return Block(self.type + name, self.name, self.fields + fields)

    def extend(self, record: np.ndarray, **values: object) -> np.ndarray:
        """A record of this block from one of the block that it extends, and `values` of the further fields."""
        extended = self.record(**values)
        for name in record.dtype.names or ():
            extended[name] = record[name]
        return extended

    def record(self, **values: object) -> np.ndarray:
        """A (1,) record with `values` set; (4, 4) matrices are stored column by column.

        ValueError: an unknown field, or a value of another shape.
        """
        record = np.zeros(1, self.dtype())
        for name, value in values.items():
            array = np.asarray(value)
            record[name][0] = array.T.reshape(-1) if array.ndim == 2 else array
        return record

    def struct(self) -> str:
        body = "".join(f"  {glsl} {name};\n" for glsl, name in self.fields)
        return f"struct {self.type} {{\n{body}}};\n"


@value_record
class Interface:
    """A program: its source files in shaders/ (or at absolute paths) and all that they read and write."""

    name: str  # of the pass, for messages and reports
    fragment: str = ""  # file in shaders/
    vertex: str = "common/fullscreen.vert"
    compute: str = ""  # file; set: a compute program, and the two above are unused
    block: Block | None = None
    samplers: tuple[tuple[str, str], ...] = ()  # (key of SAMPLERS, name)
    images: tuple[tuple[str, str], ...] = ()  # (key of IMAGES, name); compute only, read and written
    varyings: tuple[tuple[str, str, str], ...] = ()  # (smooth | flat, GLSL type, name); integers are flat
    outputs: tuple[tuple[str, str], ...] = ()  # (GLSL type, name), in order of the target's textures
    defines: tuple[tuple[str, str], ...] = ()
    local_size: int = 64  # compute work group
    depth: bool = False  # the fragment shader writes gl_FragDepth

    def with_defines(self, *names: str) -> Interface:
        """The same interface with further defines set to 1."""
        return replace(self, defines=self.defines + tuple((name, "1") for name in names))

    def header(self, stage: str, version: int) -> str:
        """The declarations for one stage (vertex, fragment, compute) in plain GLSL of `version` (410, 430)."""
        lines = [f"#version {version} core\n"]
        lines += [f"#define {name} {value}\n" for name, value in self.defines]
        if stage == "compute":
            lines.append(f"layout(local_size_x = {self.local_size}) in;\n")
        if self.block:
            lines.append(self.block.struct())
            lines.append(
                f"layout(std140) uniform {self.block.type}_block {{ {self.block.type} {self.block.name}; }};\n"
            )
        lines += [f"uniform {SAMPLERS[kind]} {name};\n" for kind, name in self.samplers]
        if stage == "compute":
            lines += [
                f"layout({kind.lower()}, binding = {unit}) uniform {IMAGES[kind]} {name};\n"
                for unit, (kind, name) in enumerate(self.images)
            ]
        direction = {"vertex": "out", "fragment": "in"}.get(stage)
        if direction:
            lines += [f"{how} {direction} {glsl} {name};\n" for how, glsl, name in self.varyings]
        if stage == "fragment":
            lines += [f"layout(location = {i}) out {glsl} {name};\n" for i, (glsl, name) in enumerate(self.outputs)]
        return "".join(lines)
