"""Shader nodes of surfaces, and of mixtures of them, as one Surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import bpy
import numpy as np

from ....core.light.bsdf import f82_of_conductor
from ....core.material.expression import Expression, constant
from ....core.material.nodes import color_nodes, input_nodes, math_nodes, normal_nodes
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


NINE_TENTHS = input_nodes.Constant((0.9,))
LEFT_OUT = {  # inputs that are 0 where there is none
    "Subsurface Weight": "subsurface scattering",
    "Thin Film Thickness": "thin film",
}


def _warn_of_left_out(node: NodeReader) -> None:
    """Warn of what the node has and no surface shows."""
    names = {socket.identifier for socket in node.node.inputs} & LEFT_OUT.keys()
    if layers := [LEFT_OUT[name] for name in LEFT_OUT if name in names and not is_constant(node[name], 0)]:
        node.warn(f"is drawn without its {' and '.join(layers)}")


def _principled(node: NodeReader) -> Surface:
    _warn_of_left_out(node)
    solid = Surface(
        base_color=node["Base Color"],
        roughness=node["Roughness"],
        metallic=node["Metallic"],
        emission=scale_color(node["Emission Color"], node["Emission Strength"]),
        normal=node["Normal"],
        ior=constant_input(node, "IOR"),
        specular=constant_input(node, "Specular IOR Level"),
        tint=constant_input(node, "Specular Tint"),
        diffuse_roughness=constant_input(node, "Diffuse Roughness"),
        tangent=_tangent(node, "Anisotropic", "Anisotropic Rotation"),
        **_coat(node),
        **_sheen(node),
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


def _sheen(node: NodeReader) -> dict[str, Expression]:
    """The parameters of Surface of a Principled BSDF's sheen; none where there is none."""
    weight = constant_input(node, "Sheen Weight")
    if is_constant(weight, 0):
        return {}
    color = scale_color(constant_input(node, "Sheen Tint"), math_nodes.Clamp(weight, ZERO, ONE))
    return {"sheen": color, "sheen_roughness": constant_input(node, "Sheen Roughness")}


def _sheen_bsdf(node: NodeReader) -> Surface:
    if node.node.distribution != "MICROFIBER":
        node.warn("is drawn with microfibers")
    color, roughness = (constant_input(node, name) for name in ("Color", "Roughness"))
    return Surface(sheen=color, sheen_roughness=roughness, normal=node["Normal"])


def _diffuse(node: NodeReader) -> Surface:
    rough = constant_input(node, "Roughness")
    return Surface(base_color=node["Color"], diffuse_roughness=rough, normal=node["Normal"])


def _toon(node: NodeReader) -> Surface:
    if node.node.component != "DIFFUSE":
        raise UnsupportedNodeError(f'node "{node.node.label or node.node.name}" is glossy')
    size, smooth = (math_nodes.Clamp(constant_input(node, name), ZERO, ONE) for name in ("Size", "Smooth"))
    return Surface(base_color=node["Color"], toon=color_nodes.Combine(size, smooth, ONE), normal=node["Normal"])


def _number(node: NodeReader, identifier: str) -> np.ndarray:
    """The value (C,) of an input that must not vary over the surface, as constant_input has it."""
    value = constant(constant_input(node, identifier))
    assert value is not None
    return value


def _metallic(node: NodeReader) -> Surface:
    _warn_of_left_out(node)
    if node.node.fresnel_type == "F82":
        color, tint = node["Base Color"], math_nodes.Clamp(constant_input(node, "Edge Tint"), ZERO, ONE)
    else:
        found = f82_of_conductor(_number(node, "IOR"), _number(node, "Extinction"))
        color, tint = (input_nodes.Constant(tuple(values.tolist())) for values in found)
    tangent = _tangent(node, "Anisotropy", "Rotation")
    return Surface(
        base_color=color, roughness=node["Roughness"], metallic=ONE, tint=tint, tangent=tangent, normal=node["Normal"]
    )


def _specular(node: NodeReader) -> Surface:
    """EEVEE's Specular BSDF: an opaque Lambertian surface below a reflection whose colour is given. Its clear coat is a
    coat."""
    node.warn("is drawn as in EEVEE; Cycles has no such node, and draws it black")
    color = np.clip(_number(node, "Specular"), 0, 1)
    most = min(float(np.max(color)), 0.99)
    root = most**0.5
    coat = math_nodes.Clamp(constant_input(node, "Clear Coat"), ZERO, ONE)
    solid = Surface(
        base_color=node["Base Color"],
        roughness=node["Roughness"],
        specular=input_nodes.Constant((0.5 if most > 0 else 0.0,)),
        ior=input_nodes.Constant(((1 + root) / (1 - root),)),
        tint=WHITE if most == 0 else input_nodes.Constant(tuple((color / np.max(color)).tolist())),
        emission=node["Emissive Color"],
        normal=node["Normal"],
        coat=coat,
        coat_roughness=constant_input(node, "Clear Coat Roughness"),
    )
    return faded(solid, math_nodes.Math(ONE, math_nodes.Clamp(node["Transparency"], ZERO, ONE), ZERO, "SUBTRACT"))


def _holdout(node: NodeReader) -> Surface:
    return Surface(holdout=ONE)


def _glossy(node: NodeReader) -> Surface:
    return Surface(
        base_color=node["Color"],
        roughness=node["Roughness"],
        metallic=ONE,
        tangent=_glossy_tangent(node),
        normal=node["Normal"],
        gloss=input_nodes.Constant((-1.0, -1.0, -1.0, 1.0)),  # without Fresnel's rise
    )


def _tangent(node: NodeReader, anisotropy: str, rotation: str) -> Expression:
    """Surface.tangent of a Principled BSDF, whose roughness along it is 1 / sqrt(1 - 0.9 a) times the mean one."""
    amount = math_nodes.Clamp(node[anisotropy], ZERO, ONE)
    if is_constant(amount, 0):
        return BLACK
    aspect2 = math_nodes.Math(ONE, math_nodes.Math(NINE_TENTHS, amount, ZERO, "MULTIPLY"), ZERO, "SUBTRACT")
    stretch = math_nodes.Math(ONE, math_nodes.Math(aspect2, ZERO, ZERO, "SQRT"), ZERO, "SUBTRACT")
    return _along(node, stretch, node[rotation])


def _glossy_tangent(node: NodeReader) -> Expression:
    """Surface.tangent of a Glossy BSDF, which is smoother along Blender's tangent by 1 - a where that is above 0."""
    low, high = input_nodes.Constant((-0.99,)), input_nodes.Constant((0.99,))
    amount = math_nodes.Clamp(node["Anisotropy"], low, high)
    if is_constant(amount, 0):
        return BLACK
    positive = math_nodes.Math(amount, ZERO, ZERO, "GREATER_THAN")
    quarter = math_nodes.Math(positive, input_nodes.Constant((0.25,)), ZERO, "MULTIPLY")
    turns = math_nodes.Math(node["Rotation"], quarter, ZERO, "ADD")
    return _along(node, math_nodes.Math(amount, ZERO, ZERO, "ABSOLUTE"), turns)


def _along(node: NodeReader, stretch: Expression, turns: Expression) -> Expression:
    """A tangent around the object's z axis, or as a Tangent node has it."""
    found = resolve(node.socket("Tangent"), node.path)
    axis, uv = 2, None
    if found is not None and found[0].is_output:
        source = found[0].node
        if source.bl_idname != "ShaderNodeTangent":
            node.warn("takes its tangent from another node than Tangent, in whose place the default one is used")
        elif source.direction_type == "UV_MAP":
            uv = input_nodes.UV(source.uv_map or None)
        else:
            axis = "XYZ".index(source.axis)
    return normal_nodes.Tangent(stretch, turns, axis, uv)


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
    return Surface(base_color=node["Color"], normal=node["Normal"], backlit=WHITE)


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
    "ShaderNodeBsdfSheen": _sheen_bsdf,
    "ShaderNodeBsdfToon": _toon,
    "ShaderNodeBsdfMetallic": _metallic,
    "ShaderNodeEeveeSpecular": _specular,
    "ShaderNodeHoldout": _holdout,
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
