"""Volume shaders of a material as one participating medium (core.scene.volume.Medium)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace

import bpy
import numpy as np

from ....core.material import expression
from ....core.material.expression import Expression
from ....core.material.nodes import color_nodes, input_nodes, math_nodes
from ....core.numeric.record import record
from ....core.scene.volume import Medium
from .nodes.tree import NodeReader, Path, TreeReader, UnsupportedNodeError, default_value, resolve


@record
class Coefficients:
    """Coefficients of a medium per unit of length; those of a sum of media are the sums of theirs."""

    scattering: np.ndarray  # (3,) float64
    absorption: np.ndarray  # (3,) float64
    emission: np.ndarray = field(default_factory=lambda: np.zeros(3))
    density_grid: str = ""  # multiplies scattering and absorption
    anisotropy: float = 0.0
    # A colour that a grid multiplies and black-body emission have no coefficients: the shader's own medium has them.
    shader: Medium | None = None

    def medium(self) -> Medium:
        """The medium in terms of Blender's Principled Volume, of density d, colour c and absorption colour a.

        Its scattering is d c, its absorption d (1 - c) (1 - sqrt(a)).
        """
        if self.shader is not None:
            return self.shader
        density = float((self.scattering + self.absorption).max())
        if density <= 0:
            return Medium(density=0.0, density_grid="", emission=self.emission)
        color = self.scattering / density
        rest = density - self.scattering
        root = 1 - np.divide(self.absorption, rest, out=np.zeros(3), where=rest > 0)
        return Medium(
            density=density,
            density_grid=self.density_grid,
            color=color,
            absorption=np.clip(root, 0, 1) ** 2,
            anisotropy=self.anisotropy,
            emission=self.emission,
            temperature_grid="",
        )


def read_medium(tree: TreeReader, socket: bpy.types.NodeSocket) -> Medium | None:
    """The medium that feeds a material's volume input; None, perhaps with a warning, if there is none to draw."""
    try:
        found = _read_volume_shader(tree, socket, ())
    except UnsupportedNodeError as reason:
        tree.warnings.append(f'Material "{tree.material_name}": {reason} in a volume, which is left out')
        return None
    return None if found is None else found.medium()


def _read_volume_shader(tree: TreeReader, socket: bpy.types.NodeSocket, path: Path) -> Coefficients | None:
    """The volume shader that feeds an input; None if nothing does. Raises UnsupportedNodeError, naming the node."""
    found = resolve(socket, path)
    if found is None or not found[0].is_output:
        return None
    output, path = found
    convert = VOLUMES.get(output.node.bl_idname)
    if convert is None:
        raise UnsupportedNodeError(f'node "{output.node.label or output.node.name}" is not supported')
    return convert(NodeReader(tree, output.node, path))


# Inputs


def _factor_and_grid(value: Expression) -> tuple[np.ndarray, str] | None:
    """An expression as a constant factor (3,) float64 times the grid of a name, which is empty for no grid.

    Returns None if the expression is not such a product.
    """
    constant = expression.constant(value)
    if constant is not None:
        return np.broadcast_to(constant.astype(np.float64), (3,)), ""
    if isinstance(value, input_nodes.Attribute):
        return np.ones(3), value.name
    if isinstance(value, color_nodes.Color | color_nodes.Component | color_nodes.Gray):
        return _factor_and_grid(value.source)
    product = isinstance(value, math_nodes.Math | math_nodes.VectorMath) and value.operation in (
        "MULTIPLY",
        "SCALE",
        "DIVIDE",
    )
    product |= isinstance(value, color_nodes.Mix) and value.blend == "MULTIPLY" and _is_one(value.factor)
    if not product or getattr(value, "clamp", False):
        return None
    a = _factor_and_grid(value.a)  # pyright: ignore[reportAttributeAccessIssue]
    b = _factor_and_grid(value.scale if getattr(value, "operation", "") == "SCALE" else value.b)  # pyright: ignore[reportAttributeAccessIssue]
    if a is None or b is None or (a[1] and b[1]):
        return None
    if getattr(value, "operation", "") != "DIVIDE":
        return a[0] * b[0], a[1] or b[1]
    return None if b[1] or not b[0].all() else (a[0] / b[0], a[1])


def _is_one(value: Expression) -> bool:
    found = expression.constant(value)
    return found is not None and bool((found == 1).all())


def _linear_input(node: NodeReader, identifier: str) -> tuple[np.ndarray, str]:
    """An input as a constant (3,) times the grid of a name; if it is anything else, its own value, with a warning."""
    found = _factor_and_grid(node[identifier])
    if found is not None:
        return found
    node.warn(f'has a "{identifier}" that is not a grid times a constant; its own value is used')
    constant = expression.constant(default_value(node.socket(identifier)))
    assert constant is not None
    return np.broadcast_to(constant.astype(np.float64), (3,)), ""


def _constant_input(node: NodeReader, identifier: str) -> np.ndarray:
    """(3,) float64: an input that must not depend on a grid; if it does, the factor of the grid, with a warning."""
    value, grid = _linear_input(node, identifier)
    if grid:
        node.warn(f'has a "{identifier}" that varies; it is taken as the same everywhere')
    return value


def _string_input(node: NodeReader, identifier: str) -> str:
    """The text in an input, or in the input of the group that feeds it."""
    found = resolve(node.socket(identifier), node.path)
    socket = node.socket(identifier) if found is None or found[0].is_output else found[0]
    return str(socket.default_value)


# Shaders


def _principled(node: NodeReader) -> Coefficients:
    density, linked = _linear_input(node, "Density")
    named = _string_input(node, "Density Attribute")
    if linked and named:
        node.warn(f'multiplies the grids "{linked}" and "{named}"; only "{linked}" is used')
    color, color_grid = _linear_input(node, "Color")
    temperature, temperature_grid = _linear_input(node, "Temperature")
    strength, emission_color = _constant_input(node, "Emission Strength"), _constant_input(node, "Emission Color")
    medium = Medium(
        density=max(float(density[0]), 0.0),
        density_grid=linked or named,
        color=np.maximum(color, 0),
        color_grid=color_grid or _string_input(node, "Color Attribute"),
        absorption=np.maximum(_constant_input(node, "Absorption Color"), 0),
        anisotropy=_anisotropy(node),
        emission=np.maximum(strength * emission_color, 0),
        blackbody=float(np.clip(_constant_input(node, "Blackbody Intensity")[0], 0, 1)),
        blackbody_tint=np.maximum(_constant_input(node, "Blackbody Tint"), 0),
        temperature=float(temperature[0]),
        temperature_grid=temperature_grid or _string_input(node, "Temperature Attribute"),
    )
    scattering = medium.density * medium.color
    absorbed = np.maximum(1 - medium.color, 0) * np.maximum(1 - np.sqrt(medium.absorption), 0)
    return Coefficients(
        scattering, medium.density * absorbed, medium.emission, medium.density_grid, medium.anisotropy, shader=medium
    )


def _absorption(node: NodeReader) -> Coefficients:
    density, grid = _linear_input(node, "Density")
    absorbed = np.maximum(density, 0) * np.clip(1 - _constant_input(node, "Color"), 0, 1)
    return Coefficients(np.zeros(3), absorbed, density_grid=grid)


def _scatter(node: NodeReader) -> Coefficients:
    density, grid = _linear_input(node, "Density")
    scattered = np.maximum(density, 0) * np.maximum(_constant_input(node, "Color"), 0)
    return Coefficients(scattered, np.zeros(3), density_grid=grid, anisotropy=_anisotropy(node))


def _coefficients(node: NodeReader) -> Coefficients:
    absorbed, grid = _linear_input(node, "Absorption Coefficients")
    scattered, other = _linear_input(node, "Scatter Coefficients")
    if grid != other and absorbed.any() and scattered.any():
        node.warn(f'reads the grids "{grid}" and "{other}"; only "{other or grid}" is used')
    emitted = np.maximum(_constant_input(node, "Emission Coefficients"), 0)
    return Coefficients(
        np.maximum(scattered, 0), np.maximum(absorbed, 0), emitted, other or grid, anisotropy=_anisotropy(node)
    )


def _emission(node: NodeReader) -> Coefficients:
    strength, color = _constant_input(node, "Strength"), _constant_input(node, "Color")
    return Coefficients(np.zeros(3), np.zeros(3), np.maximum(strength * color, 0))


def _anisotropy(node: NodeReader) -> float:
    if getattr(node.node, "phase", "HENYEY_GREENSTEIN") != "HENYEY_GREENSTEIN":
        node.warn("scatters by Henyey and Greenstein's phase function instead of its own")
    return float(np.clip(_constant_input(node, "Anisotropy")[0], -0.99, 0.99))


def _read_both_shaders(node: NodeReader) -> tuple[Coefficients | None, Coefficients | None]:
    a, b = (_read_volume_shader(node.tree, node.socket(name), node.path) for name in ("Shader", "Shader_001"))
    return a, b


def _add_shader(node: NodeReader) -> Coefficients | None:
    return _add_coefficients(node, *_read_both_shaders(node))


def _mix_shader(node: NodeReader) -> Coefficients | None:
    factor = float(np.clip(_constant_input(node, "Fac")[0], 0, 1))
    a, b = _read_both_shaders(node)
    return _add_coefficients(node, _scale(a, 1 - factor), _scale(b, factor))


def _scale(part: Coefficients | None, factor: float) -> Coefficients | None:
    if part is None or factor == 0:
        return None
    shader = part.shader
    if shader is not None and factor != 1:
        tint = shader.blackbody_tint * factor
        shader = replace(
            shader, density=shader.density * factor, emission=shader.emission * factor, blackbody_tint=tint
        )
    return replace(
        part,
        scattering=part.scattering * factor,
        absorption=part.absorption * factor,
        emission=part.emission * factor,
        shader=shader,
    )


def _add_coefficients(node: NodeReader, a: Coefficients | None, b: Coefficients | None) -> Coefficients | None:
    """The medium of two media in the same space, with a warning about what one medium cannot hold."""
    if a is None or b is None:
        return a or b
    if _only_emits(a):
        a, b = b, a
    emission = a.emission + b.emission
    if _only_emits(b):
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


def _only_emits(part: Coefficients) -> bool:
    blackbody = part.shader is not None and part.shader.blackbody > 0
    return not (part.scattering.any() or part.absorption.any() or blackbody)


VOLUMES: dict[str, Callable[[NodeReader], Coefficients | None]] = {
    "ShaderNodeVolumePrincipled": _principled,
    "ShaderNodeVolumeAbsorption": _absorption,
    "ShaderNodeVolumeScatter": _scatter,
    "ShaderNodeVolumeCoefficients": _coefficients,
    "ShaderNodeEmission": _emission,
    "ShaderNodeAddShader": _add_shader,
    "ShaderNodeMixShader": _mix_shader,
}
