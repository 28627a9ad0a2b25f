"""What fills the volume of a material: its volume shaders as one core.scene.Medium."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ....core.material import expression
from ....core.material.expression import Expression
from ....core.material.nodes import color_nodes, input_nodes, math_nodes
from ....core.scene.volume import Medium
from .nodes import Path, Reader, UnsupportedNodeError, Walker, default, resolve


@dataclass(frozen=True, eq=False)
class Coefficients:
    """A medium by its coefficients per unit of length, which add up where media do."""

    scattering: np.ndarray  # (3,) float64
    absorption: np.ndarray  # (3,) float64
    emission: np.ndarray = field(default_factory=lambda: np.zeros(3))
    density_grid: str = ""  # scattering and absorption are multiplied by it
    anisotropy: float = 0.0
    # The colour that a grid multiplies, and black bodies, have no coefficients: they are kept as the shader has them.
    shader: Medium | None = None

    def medium(self) -> Medium:
        """As Blender's Principled Volume has it: scattering d c and absorption d (1 - c) (1 - sqrt(a))."""
        if self.shader is not None:
            return self.shader
        density = float((self.scattering + self.absorption).max())
        if density <= 0:
            return Medium(density=0.0, density_grid="", emission=self.emission)
        color = self.scattering / density
        rest = density - self.scattering
        kept = 1 - np.divide(self.absorption, rest, out=np.zeros(3), where=rest > 0)
        return Medium(
            density=density,
            density_grid=self.density_grid,
            color=color,
            absorption=np.clip(kept, 0, 1) ** 2,
            anisotropy=self.anisotropy,
            emission=self.emission,
            temperature_grid="",
        )


def medium_of(walker: Walker, socket: bpy.types.NodeSocket) -> Medium | None:
    """The medium that feeds a material's volume input; None where there is none, or none that can be drawn."""
    try:
        found = _volume(walker, socket, ())
    except UnsupportedNodeError as reason:
        walker.warnings.append(f'Material "{walker.material_name}": {reason} in a volume, which is left out')
        return None
    return None if found is None else found.medium()


def _volume(walker: Walker, socket: bpy.types.NodeSocket, path: Path) -> Coefficients | None:
    found = resolve(socket, path)
    if found is None or not found[0].is_output:
        return None
    output, path = found
    build = VOLUMES.get(output.node.bl_idname)
    if build is None:
        raise UnsupportedNodeError(f'node "{output.node.label or output.node.name}" is not supported')
    return build(Reader(walker, output.node, path))


# Inputs


def _linear(value: Expression) -> tuple[np.ndarray, str] | None:
    """(factor, grid): the value as a constant (3,) float64 times a grid; no name: the same everywhere. Else None."""
    constant = expression.constant(value)
    if constant is not None:
        return np.broadcast_to(constant.astype(np.float64), (3,)), ""
    if isinstance(value, input_nodes.Attribute):
        return np.ones(3), value.name
    if isinstance(value, color_nodes.Color | color_nodes.Component | color_nodes.Gray):
        return _linear(value.source)
    product = isinstance(value, math_nodes.Math | math_nodes.VectorMath) and value.operation in (
        "MULTIPLY",
        "SCALE",
        "DIVIDE",
    )
    product |= isinstance(value, color_nodes.Mix) and value.blend == "MULTIPLY" and _is_one(value.factor)
    if not product or getattr(value, "clamp", False):
        return None
    a = _linear(value.a)  # pyright: ignore[reportAttributeAccessIssue]
    b = _linear(value.scale if getattr(value, "operation", "") == "SCALE" else value.b)  # pyright: ignore[reportAttributeAccessIssue]
    if a is None or b is None or (a[1] and b[1]):
        return None
    if getattr(value, "operation", "") != "DIVIDE":
        return a[0] * b[0], a[1] or b[1]
    return None if b[1] or not b[0].all() else (a[0] / b[0], a[1])


def _is_one(value: Expression) -> bool:
    found = expression.constant(value)
    return found is not None and bool((found == 1).all())


def _input(node: Reader, identifier: str) -> tuple[np.ndarray, str]:
    """An input as a constant (3,) times a grid; its own value, and a warning, where it is anything else."""
    found = _linear(node[identifier])
    if found is not None:
        return found
    node.warn(f'has a "{identifier}" that is not a grid times a constant; its own value is used')
    constant = expression.constant(default(node.socket(identifier)))
    assert constant is not None
    return np.broadcast_to(constant.astype(np.float64), (3,)), ""


def _constant(node: Reader, identifier: str) -> np.ndarray:
    """(3,) an input that must be the same everywhere."""
    value, grid = _input(node, identifier)
    if grid:
        node.warn(f'has a "{identifier}" that varies; it is taken as the same everywhere')
    return value


def _string(node: Reader, identifier: str) -> str:
    """The name in an input, also where a group's input feeds it."""
    found = resolve(node.socket(identifier), node.path)
    socket = node.socket(identifier) if found is None or found[0].is_output else found[0]
    return str(socket.default_value)


# Shaders


def _principled(node: Reader) -> Coefficients:
    density, linked = _input(node, "Density")
    named = _string(node, "Density Attribute")
    if linked and named:
        node.warn(f'multiplies the grids "{linked}" and "{named}"; only "{linked}" is used')
    color, color_grid = _input(node, "Color")
    temperature, temperature_grid = _input(node, "Temperature")
    strength, color_of_light = _constant(node, "Emission Strength"), _constant(node, "Emission Color")
    medium = Medium(
        density=max(float(density[0]), 0.0),
        density_grid=linked or named,
        color=np.maximum(color, 0),
        color_grid=color_grid or _string(node, "Color Attribute"),
        absorption=np.maximum(_constant(node, "Absorption Color"), 0),
        anisotropy=_anisotropy(node),
        emission=np.maximum(strength * color_of_light, 0),
        blackbody=float(np.clip(_constant(node, "Blackbody Intensity")[0], 0, 1)),
        blackbody_tint=np.maximum(_constant(node, "Blackbody Tint"), 0),
        temperature=float(temperature[0]),
        temperature_grid=temperature_grid or _string(node, "Temperature Attribute"),
    )
    scattering = medium.density * medium.color
    absorbed = np.maximum(1 - medium.color, 0) * np.maximum(1 - np.sqrt(medium.absorption), 0)
    return Coefficients(
        scattering, medium.density * absorbed, medium.emission, medium.density_grid, medium.anisotropy, shader=medium
    )


def _absorption(node: Reader) -> Coefficients:
    density, grid = _input(node, "Density")
    absorbed = np.maximum(density, 0) * np.clip(1 - _constant(node, "Color"), 0, 1)
    return Coefficients(np.zeros(3), absorbed, density_grid=grid)


def _scatter(node: Reader) -> Coefficients:
    density, grid = _input(node, "Density")
    scattered = np.maximum(density, 0) * np.maximum(_constant(node, "Color"), 0)
    return Coefficients(scattered, np.zeros(3), density_grid=grid, anisotropy=_anisotropy(node))


def _coefficients(node: Reader) -> Coefficients:
    absorbed, grid = _input(node, "Absorption Coefficients")
    scattered, other = _input(node, "Scatter Coefficients")
    if grid != other and absorbed.any() and scattered.any():
        node.warn(f'reads the grids "{grid}" and "{other}"; only "{other or grid}" is used')
    emitted = np.maximum(_constant(node, "Emission Coefficients"), 0)
    return Coefficients(
        np.maximum(scattered, 0), np.maximum(absorbed, 0), emitted, other or grid, anisotropy=_anisotropy(node)
    )


def _emission(node: Reader) -> Coefficients:
    strength, color = _constant(node, "Strength"), _constant(node, "Color")
    return Coefficients(np.zeros(3), np.zeros(3), np.maximum(strength * color, 0))


def _anisotropy(node: Reader) -> float:
    if getattr(node.node, "phase", "HENYEY_GREENSTEIN") != "HENYEY_GREENSTEIN":
        node.warn("scatters by Henyey and Greenstein's phase function here")
    return float(np.clip(_constant(node, "Anisotropy")[0], -0.99, 0.99))


def _parts(node: Reader) -> tuple[Coefficients | None, Coefficients | None]:
    a, b = (_volume(node.walker, node.socket(name), node.path) for name in ("Shader", "Shader_001"))
    return a, b


def _add(node: Reader) -> Coefficients | None:
    return _sum(node, *_parts(node))


def _mix(node: Reader) -> Coefficients | None:
    factor = float(np.clip(_constant(node, "Fac")[0], 0, 1))
    a, b = _parts(node)
    return _sum(node, _scaled(a, 1 - factor), _scaled(b, factor))


def _scaled(part: Coefficients | None, factor: float) -> Coefficients | None:
    if part is None or factor == 0:
        return None
    shader = part.shader
    if shader is not None and factor != 1:
        fire = shader.blackbody_tint * factor
        shader = replace(
            shader, density=shader.density * factor, emission=shader.emission * factor, blackbody_tint=fire
        )
    return replace(
        part,
        scattering=part.scattering * factor,
        absorption=part.absorption * factor,
        emission=part.emission * factor,
        shader=shader,
    )


def _sum(node: Reader, a: Coefficients | None, b: Coefficients | None) -> Coefficients | None:
    if a is None or b is None:
        return a or b
    if _only_shines(a):
        a, b = b, a
    emission = a.emission + b.emission
    if _only_shines(b):
        shader = a.shader and replace(a.shader, emission=emission)
        return replace(a, emission=emission, shader=shader)
    for part in (a, b):
        if part.shader is not None and (part.shader.color_grid or part.shader.blackbody > 0):
            node.warn("mixes volumes whose colour grids and black bodies are left out")
    if a.density_grid != b.density_grid:
        node.warn(f'mixes volumes of the grids "{a.density_grid}" and "{b.density_grid}"; only the first is used')
    scattered = a.scattering.sum(), b.scattering.sum()
    weight = scattered[1] / max(sum(scattered), 1e-30)
    return Coefficients(
        a.scattering + b.scattering,
        a.absorption + b.absorption,
        emission,
        a.density_grid,
        (1 - weight) * a.anisotropy + weight * b.anisotropy,
    )


def _only_shines(part: Coefficients) -> bool:
    glows = part.shader is not None and part.shader.blackbody > 0
    return not (part.scattering.any() or part.absorption.any() or glows)


VOLUMES: dict[str, Callable[[Reader], Coefficients | None]] = {
    "ShaderNodeVolumePrincipled": _principled,
    "ShaderNodeVolumeAbsorption": _absorption,
    "ShaderNodeVolumeScatter": _scatter,
    "ShaderNodeVolumeCoefficients": _coefficients,
    "ShaderNodeEmission": _emission,
    "ShaderNodeAddShader": _add,
    "ShaderNodeMixShader": _mix,
}
