"""The G-buffer: a texel of surface attributes for each pixel. Layout: shaders/lib/geometry/surfel.glsl."""

from __future__ import annotations

from ...core.numeric.record import value_record
from ..device.protocol import Device, Target, Texture


@value_record
class Variant:
    """What the G-buffer of a scene holds beyond geometry; each True is a `#define` and a texture."""

    normal: bool = True  # something shines, or a pass asks for positions or normals
    color: bool = False  # colour varies within a material
    surface: bool = False  # so do roughness and metallic; they ride with normal and colour, which this implies
    emission: bool = False
    owner: bool = False  # a pass asks which instance a pixel shows
    velocity: bool = False  # a pass asks how points move, and some do; it rides with owner, which this implies
    wide: bool = False  # more materials than half floats count
    tangent: bool = False  # the GGX lobe is stretched somewhere
    spread: bool = False  # groups of sub-samples keep the spread of their normals, in the centre's second channel
    front: bool = True  # a pyramid asks for the depth of the near end

    @property
    def defines(self) -> tuple[str, ...]:
        named = {
            "PS_NORMAL": self.normal, "PS_COLOR": self.color, "PS_SURFACE": self.surface,
            "PS_EMISSION": self.emission, "PS_OWNER": self.owner, "PS_VELOCITY": self.velocity,
            "PS_SPREAD": self.spread, "PS_TANGENT": self.tangent,
        }  # fmt: skip
        return tuple(name for name, on in named.items() if on)

    @property
    def channels(self) -> tuple[tuple[str, str, str], ...]:
        """The (name, texture format, GLSL type) of each texture."""
        found = [
            ("centre", "RGBA32F", "vec4"),
            ("shape", "RGBA32F" if self.wide else "RGBA16F", "vec4"),
        ]
        if self.normal:
            found.append(("normal", "RGBA16F", "vec4"))
        if self.color:
            found.append(("color", "RGBA16F", "vec4"))
        if self.emission:
            found.append(("emission", "RGBA16F", "vec4"))
        if self.tangent:
            found.append(("tangent", "RGBA16F", "vec4"))
        if self.owner:
            found.append(("owner", "RGBA32F", "vec4") if self.velocity else ("owner", "R32UI", "uint"))
        return tuple(found)

    def outputs(self) -> tuple[tuple[str, str], ...]:
        """Returns (GLSL type, name) of the fragment outputs of all channels."""
        return tuple((glsl, f"out_{name}") for name, _, glsl in self.channels)

    @property
    def front_outputs(self) -> tuple[tuple[str, str], ...]:
        """The outputs of passes that write a level anew: the channels and the depth of the near end."""
        return (*self.outputs(), *((("float", "out_front"),) if self.front else ()))

    @property
    def front_defines(self) -> tuple[tuple[str, str], ...]:
        return tuple((name, "1") for name in (*self.defines, *(("PS_FRONT",) if self.front else ())))

    def samplers(self, prefix: str = "ps_", only: tuple[str, ...] = ()) -> tuple[tuple[str, str], ...]:
        kinds = {"vec4": "FLOAT_2D", "uint": "UINT_2D"}
        return tuple((kinds[glsl], prefix + name) for name, _, glsl in self.channels if not only or name in only)


class GBuffer:
    """One level of surfels.

    `target` takes them together with `front`, the depth of their near end; `fill_target` takes them alone, so that the
    pass that fills holes can read `front` while it writes the rest. Without a pyramid there is neither.
    """

    def __init__(self, device: Device, variant: Variant, size: tuple[int, int], depth: bool = False) -> None:
        self.size = size
        self.textures: dict[str, Texture] = {name: device.texture(size, format) for name, format, _ in variant.channels}
        near_ends = [device.texture(size, "R32F")] if variant.front else []
        self.target: Target = device.target([*self.textures.values(), *near_ends], depth=depth)
        # Where centre and front are zero nothing else is read.
        self._cleared = self.target if depth else device.target([self.textures["centre"], *near_ends])
        self._owned: list[Target | Texture] = [self.target, *self.textures.values(), *near_ends]
        self._owned += [] if depth else [self._cleared]
        if variant.front:
            self.front = near_ends[0]
            self.fill_target: Target = device.target(list(self.textures.values()))
            self._owned.append(self.fill_target)
        self._device = device

    def clear(self) -> None:
        """Empties all pixels."""
        self._device.clear(self._cleared)

    def bound(self, prefix: str = "ps_") -> dict[str, Texture]:
        """Returns the textures by sampler name."""
        return {prefix + name: texture for name, texture in self.textures.items()}

    def release(self) -> None:
        for item in self._owned:
            item.release()
