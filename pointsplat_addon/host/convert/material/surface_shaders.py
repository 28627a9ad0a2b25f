"""Shader nodes of surfaces, and of mixtures of them, as one Surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy

from ....core.material.expression import Expression
from ....core.material.nodes import input_nodes, math_nodes
from .hair_shaders import HAIR_SHADERS
from .nodes.tree import NodeReader, Path, TreeReader, UnsupportedNodeError, constant_input, resolve
from .surface import (
    BLACK,
    ONE,
    WHITE,
    ZERO,
    Surface,
    divide_color,
    faded,
    is_constant,
    mix_surfaces,
    multiply,
    only_emits,
    scale_color,
    thin_glass,
)


def read_surface(tree: TreeReader, socket: bpy.types.NodeSocket, path: Path) -> Surface:
    """The surface that feeds a shader input, black if nothing does. Raises UnsupportedNodeError, naming the node."""
    found = resolve(socket, path)
    if found is None or not found[0].is_output:
        return Surface()
    output, path = found
    convert = SHADERS.get(output.node.bl_idname)
    if convert is None:
        raise UnsupportedNodeError(f'node "{output.node.label or output.node.name}" is not supported')
    return convert(NodeReader(tree, output.node, path))


LEFT_OUT = {"Sheen Weight": "sheen", "Subsurface Weight": "subsurface scattering"}


def _principled(node: NodeReader) -> Surface:
    if layers := [layer for weight, layer in LEFT_OUT.items() if not is_constant(node[weight], 0)]:
        node.warn(f"is drawn without its {' and '.join(layers)}")
    solid = Surface(
        base_color=node["Base Color"],
        roughness=node["Roughness"],
        metallic=node["Metallic"],
        emission=scale_color(node["Emission Color"], node["Emission Strength"]),
        normal=node["Normal"],
        ior=constant_input(node, "IOR"),
        specular=constant_input(node, "Specular IOR Level"),
        **_coat(node),
    )
    weight = math_nodes.Clamp(node["Transmission Weight"], ZERO, ONE)
    if is_constant(weight, 0):
        return faded(solid, node["Alpha"])
    node.tree.glass = True
    # The metallic layer lies above the transmissive one, as in OpenPBR and Blender
    weight = multiply(weight, math_nodes.Math(ONE, solid.metallic, ZERO, "SUBTRACT"))
    # Light crosses two faces of a solid, hence the root
    tint = math_nodes.VectorMath(
        math_nodes.Clamp(solid.base_color, ZERO, ONE), input_nodes.Constant((0.5,) * 3), BLACK, ZERO, "POWER"
    )
    mixed = mix_surfaces(solid, thin_glass(tint, solid), weight)
    # Transmission does not weaken the emission, which the alpha is going to scale
    emission = divide_color(solid.emission, mixed.alpha)
    return faded(replace(mixed, emission=emission), node["Alpha"])


def _coat(node: NodeReader) -> dict[str, Expression]:
    """The parameters of Surface of a Principled BSDF's coat; none where there is none."""
    weight = constant_input(node, "Coat Weight")
    if is_constant(weight, 0):
        return {}
    if node.linked("Coat Normal"):
        node.warn('has a "Coat Normal", in whose place its own normal is used')
    names = {"coat_roughness": "Coat Roughness", "coat_ior": "Coat IOR", "coat_tint": "Coat Tint"}
    return {"coat": weight, **{name: constant_input(node, identifier) for name, identifier in names.items()}}


def _diffuse(node: NodeReader) -> Surface:
    return Surface(base_color=node["Color"], normal=node["Normal"])


def _glossy(node: NodeReader) -> Surface:
    return Surface(base_color=node["Color"], roughness=node["Roughness"], metallic=ONE, normal=node["Normal"])


def _emission(node: NodeReader) -> Surface:
    return Surface(emission=scale_color(node["Color"], node["Strength"]))


def _transparent(node: NodeReader) -> Surface:
    tint = math_nodes.Clamp(node["Color"], ZERO, ONE)
    return Surface(alpha=ZERO) if is_constant(tint, 1) else thin_glass(tint, Surface(), reflects=False)


def _glass(node: NodeReader) -> Surface:
    node.tree.glass = True
    reflects = node.node.bl_idname == "ShaderNodeBsdfGlass"
    like = Surface(
        roughness=node["Roughness"],
        normal=node["Normal"],
        ior=constant_input(node, "IOR"),
        specular=input_nodes.Constant((0.5 if reflects else 0.0,)),
    )
    return thin_glass(math_nodes.Clamp(node["Color"], ZERO, ONE), like, reflects=reflects)


def _translucent(node: NodeReader) -> Surface:
    return replace(_diffuse(node), backlit=WHITE)


def _mix_shader(node: NodeReader) -> Surface:
    a, b = (read_surface(node.tree, node.socket(name), node.path) for name in ("Shader", "Shader_001"))
    return mix_surfaces(a, b, math_nodes.Clamp(node["Fac"], ZERO, ONE))


def _add_shader(node: NodeReader) -> Surface:
    """The sum of two shaders, of which at least one must only emit. Raises UnsupportedNodeError otherwise."""
    a, b = (read_surface(node.tree, node.socket(name), node.path) for name in ("Shader", "Shader_001"))
    if not only_emits(b):
        a, b = b, a
    if not only_emits(b):
        raise UnsupportedNodeError(f'node "{node.node.label or node.node.name}" adds two reflecting shaders')
    if not is_constant(a.alpha, 1):
        raise UnsupportedNodeError(f'node "{node.node.label or node.node.name}" adds light to a transparent shader')
    return replace(a, emission=math_nodes.VectorMath(a.emission, b.emission, BLACK, ZERO, "ADD"))


SHADERS: dict[str, Callable[[NodeReader], Surface]] = {
    "ShaderNodeBsdfPrincipled": _principled,
    "ShaderNodeBsdfDiffuse": _diffuse,
    "ShaderNodeBsdfAnisotropic": _glossy,
    "ShaderNodeBsdfGlossy": _glossy,
    "ShaderNodeEmission": _emission,
    "ShaderNodeBsdfTransparent": _transparent,
    "ShaderNodeBsdfGlass": _glass,
    "ShaderNodeBsdfRefraction": _glass,
    "ShaderNodeBsdfTranslucent": _translucent,
    "ShaderNodeMixShader": _mix_shader,
    "ShaderNodeAddShader": _add_shader,
    **HAIR_SHADERS,
}
