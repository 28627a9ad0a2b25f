"""Blender's shader nodes to core expressions: one small function for each kind of node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ....core.material.expression import Expression
from ....core.material.hair_color import strand_attribute
from ....core.material.nodes import (
    color_nodes,
    input_nodes,
    math_functions,
    math_nodes,
    normal_nodes,
    ramp_nodes,
    texture_nodes,
)
from .images import convert_image

Path = tuple[bpy.types.Node, ...]  # the group nodes that lead to a tree, outermost first
Outputs = dict[str, Expression]  # output identifier to its value

SCALARS = ("VALUE", "INT", "BOOLEAN")
CURVE_STEPS = 256  # Blender keeps its own curves as tables of this many steps


class UnsupportedNodeError(Exception):
    """A node, or a setting of it, that cannot be evaluated per sample; the text completes "node X ..."."""


@dataclass(frozen=True)
class Hair:
    """Constants of a Principled Hair BSDF, as in core.scene.HairTable."""

    radial: float = 0.3
    coat: float = 0.0
    tilt: float = 0.0349066
    lobes: tuple[float, ...] = (1.0, 1.0, 1.0)


class Walker:
    """Reads the inputs of one material's nodes as expressions; what it cannot read becomes a warning."""

    def __init__(self, material_name: str) -> None:
        self.material_name = material_name
        self.warnings: list[str] = []
        self.hair: Hair | None = None  # set by a shader for strands
        self._warned: set[int] = set()
        self._known: dict[tuple, Outputs | None] = {}

    def warn(self, node: bpy.types.Node, text: str) -> None:
        """One warning for each node, with the material's name."""
        pointer = node.as_pointer()
        if pointer not in self._warned:
            self._warned.add(pointer)
            self.warnings.append(f'Material "{self.material_name}": node "{node.label or node.name}" {text}')

    def read(self, socket: bpy.types.NodeSocket, path: Path) -> Expression:
        """The value of an input: what is linked to it, converted to its type, else its own value."""
        found = resolve(socket, path)
        if found is None:
            return default(socket)
        output, path = found
        if output.is_output:
            value = self._output(output, path)
            return default(socket) if value is None else converted(value, output.type, socket.type)
        # A group's or a muted node's input that is not linked
        return converted(default(output), output.type, socket.type)

    def _output(self, output: bpy.types.NodeSocket, path: Path) -> Expression | None:
        """The value of a node's output, None (and a warning) where it cannot be evaluated."""
        node = output.node
        key = (*(group.as_pointer() for group in path), node.as_pointer())
        if key not in self._known:
            self._known[key] = self._outputs(node, path)
        outputs = self._known[key]
        if outputs is None:
            return None
        value = outputs.get(output.identifier)
        if value is None:
            self.warn(node, f'cannot be evaluated ("{output.name}"); inputs that use it keep their own values')
        return value

    def _outputs(self, node: bpy.types.Node, path: Path) -> Outputs | None:
        build = NODES.get(node.bl_idname)
        try:
            if build is None:
                raise UnsupportedNodeError("cannot be evaluated")
            return build(Reader(self, node, path))
        except UnsupportedNodeError as reason:
            self.warn(node, f"{reason}; inputs that use it keep their own values")
            return None


class Reader:
    """One node: `reader[identifier]` is the value of that input."""

    def __init__(self, walker: Walker, node: bpy.types.Node, path: Path) -> None:
        self.walker, self.node, self.path = walker, node, path

    def __getitem__(self, identifier: str) -> Expression:
        return self.walker.read(self.socket(identifier), self.path)

    def socket(self, identifier: str) -> bpy.types.NodeSocket:
        return next(s for s in self.node.inputs if s.identifier == identifier)

    def linked(self, identifier: str) -> bool:
        found = resolve(self.socket(identifier), self.path)
        return found is not None and found[0].is_output

    def used(self, identifier: str) -> bool:
        """Whether an output has a link."""
        return any(s.is_linked for s in self.node.outputs if s.identifier == identifier)

    def warn(self, text: str) -> None:
        self.walker.warn(self.node, text)


def resolve(socket: bpy.types.NodeSocket, path: Path) -> tuple[bpy.types.NodeSocket, Path] | None:
    """The output that feeds an input, looking through reroutes, muted nodes and groups, with its path.

    None when nothing is linked. Where the way ends at an unlinked input of a group node or a muted node,
    that input is returned.
    """
    link = next((x for x in socket.links if x.is_valid and not x.is_muted), None)
    if link is None:
        return None
    output, node = link.from_socket, link.from_node
    if node.bl_idname == "NodeReroute":
        return resolve(node.inputs[0], path)
    if node.mute:
        inner = next((x.from_socket for x in node.internal_links if x.to_socket == output), None)
        return None if inner is None else resolve(inner, path) or (inner, path)
    if node.bl_idname == "NodeGroupInput" and path:
        outer = next((s for s in path[-1].inputs if s.identifier == output.identifier), None)
        return None if outer is None else resolve(outer, path[:-1]) or (outer, path[:-1])
    if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
        ends = [n for n in node.node_tree.nodes if n.bl_idname == "NodeGroupOutput" and n.is_active_output]
        inner = next((s for n in ends for s in n.inputs if s.identifier == output.identifier), None)
        if inner is not None:
            return resolve(inner, (*path, node)) or (inner, (*path, node))
    return output, path


def default(socket: bpy.types.NodeSocket) -> Expression:
    """The value of an input that is not linked; an empty normal is the surface's."""
    if socket.identifier == "Normal":
        return input_nodes.Coordinates("normal")
    value = getattr(socket, "default_value", 0.0)
    if socket.type in SCALARS:
        return input_nodes.Constant((float(value),))
    if socket.type in ("VECTOR", "RGBA"):
        return input_nodes.Constant(tuple(np.array(value, float)[:3].tolist()))
    return input_nodes.Constant((0.0, 0.0, 0.0))


def converted(value: Expression, source: str, target: str) -> Expression:
    """Blender's implicit conversion between socket types."""
    if target in SCALARS and source not in SCALARS:
        return color_nodes.Gray(value, mean=source == "VECTOR")
    if target not in SCALARS and source in SCALARS:
        return color_nodes.Color(value)
    return value


# Sources


def _uv(node: Reader) -> Outputs:
    if node.node.from_instancer:
        raise UnsupportedNodeError("reads the instancer")
    return {"UV": input_nodes.UV(node.node.uv_map or None)}


def _color_attribute(node: Reader) -> Outputs:
    color = input_nodes.ColorAttribute(node.node.layer_name or None)
    return {"Color": color_nodes.Color(color), "Alpha": color_nodes.Component(color, 3)}


def _attribute(node: Reader) -> Outputs:
    if node.node.attribute_type != "GEOMETRY":
        raise UnsupportedNodeError(f"reads an attribute of the {node.node.attribute_type.lower()}")
    value = input_nodes.Attribute(node.node.attribute_name)
    color = color_nodes.Color(value)
    return {
        "Color": color,
        "Vector": color,
        "Fac": color_nodes.Component(value, 4),
        "Alpha": color_nodes.Component(value, 3),
    }


def _coordinates(node: Reader) -> Outputs:
    if node.node.from_instancer:
        raise UnsupportedNodeError("reads the instancer")
    out: Outputs = {
        "Generated": input_nodes.Coordinates("generated"),
        "Normal": input_nodes.Coordinates("normal"),
        "UV": input_nodes.UV(),
    }
    if node.node.object is None:
        out["Object"] = input_nodes.Coordinates("position")
    return out


def _image(node: Reader) -> Outputs:
    texture = node.node
    if texture.projection != "FLAT":
        raise UnsupportedNodeError(f"projects its image as {texture.projection.lower()}")
    image, problem = convert_image(texture.image)
    if problem is not None:
        node.warn(problem)
    interpolation = "Cubic" if texture.interpolation == "Smart" else texture.interpolation
    uv = node["Vector"] if node.linked("Vector") else input_nodes.UV()
    value = texture_nodes.ImageTexture(uv, image, interpolation, texture.extension, straight=node.used("Alpha"))
    return {"Color": color_nodes.Color(value), "Alpha": color_nodes.Component(value, 3)}


def _volume_info(node: Reader) -> Outputs:
    color: Outputs = {"Color": color_nodes.Color(input_nodes.Attribute("color"))}
    return color | {
        name: color_nodes.Component(input_nodes.Attribute(name.lower()), 4)
        for name in ("Density", "Flame", "Temperature")
    }


def of_strand(name: str) -> Expression:
    """What strands tell of themselves (host.convert.curves); 0 on everything else."""
    return color_nodes.Component(input_nodes.Attribute(strand_attribute(name)), 4)


def _hair_info(node: Reader) -> Outputs:
    names = ("Is Strand", "Intercept", "Length", "Thickness", "Random")
    return {name: of_strand(name.lower().replace(" ", "_")) for name in names}


def _light_path(node: Reader) -> Outputs:
    """Rays that come from the camera and have met nothing yet."""
    names = (s.identifier for s in node.node.outputs)
    return {name: input_nodes.Constant((float(name == "Is Camera Ray"),)) for name in names if name != "Ray Length"}


def _value(node: Reader) -> Outputs:
    return {"Value": input_nodes.Constant((float(node.node.outputs[0].default_value),))}


def _rgb(node: Reader) -> Outputs:
    return {"Color": input_nodes.Constant(tuple(float(v) for v in node.node.outputs[0].default_value)[:3])}


# Mathematics


def _known(operation: str, table: dict) -> str:
    if operation not in table:
        raise UnsupportedNodeError(f"uses the operation {operation}, which cannot be evaluated")
    return operation


def _math(node: Reader) -> Outputs:
    operation = _known(node.node.operation, math_functions.MATH)
    a, b, c = (node[name] for name in ("Value", "Value_001", "Value_002"))
    return {"Value": math_nodes.Math(a, b, c, operation, node.node.use_clamp)}


def _vector_math(node: Reader) -> Outputs:
    operation = _known(node.node.operation, math_functions.VECTOR_MATH)
    a, b, c, scale = (node[name] for name in ("Vector", "Vector_001", "Vector_002", "Scale"))
    value = math_nodes.VectorMath(a, b, c, scale, operation)
    return {"Value" if operation in ("DOT_PRODUCT", "DISTANCE", "LENGTH") else "Vector": value}


def _mix(node: Reader) -> Outputs:
    kind = node.node.data_type
    if kind == "ROTATION":
        raise UnsupportedNodeError("mixes rotations")
    suffix = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}[kind]
    uniform = kind != "VECTOR" or node.node.factor_mode == "UNIFORM"
    factor, a, b = (
        node[name] for name in ("Factor_Float" if uniform else "Factor_Vector", f"A_{suffix}", f"B_{suffix}")
    )
    color = kind == "RGBA"
    blend = _known(node.node.blend_type, color_nodes.BLEND) if color else "MIX"
    mixed = color_nodes.Mix(factor, a, b, blend, node.node.clamp_factor, color and node.node.clamp_result)
    return {f"Result_{suffix}": mixed}


def _mix_rgb(node: Reader) -> Outputs:
    blend = _known(node.node.blend_type, color_nodes.BLEND)
    return {"Color": color_nodes.Mix(node["Fac"], node["Color1"], node["Color2"], blend, True, node.node.use_clamp)}


def _clamp(node: Reader) -> Outputs:
    ordered = node.node.clamp_type == "RANGE"
    return {"Result": math_nodes.Clamp(node["Value"], node["Min"], node["Max"], ordered)}


def _map_range(node: Reader) -> Outputs:
    vector = node.node.data_type == "FLOAT_VECTOR"
    names = ["Value", "From Min", "From Max", "To Min", "To Max", "Steps"]
    if vector:
        names = ["Vector", *(f"{name.replace(' ', '_')}_FLOAT3" for name in names[1:])]
    value, low, high, to_low, to_high, steps = (node[name] for name in names)
    kind = node.node.interpolation_type
    mapped = math_nodes.MapRange(value, low, high, to_low, to_high, steps, kind, node.node.clamp, vector)
    return {"Vector" if vector else "Result": mapped}


def _mapping(node: Reader) -> Outputs:
    vector, location, rotation, scale = (_input_or_zero(node, n) for n in ("Vector", "Location", "Rotation", "Scale"))
    return {"Vector": math_nodes.Mapping(vector, location, rotation, scale, node.node.vector_type)}


def _input_or_zero(node: Reader, identifier: str) -> Expression:
    """Types without translation hide their location socket."""
    found = any(s.identifier == identifier for s in node.node.inputs)
    return node[identifier] if found else input_nodes.Constant((0.0, 0.0, 0.0))


# Colour


def _ramp(node: Reader) -> Outputs:
    ramp = node.node.color_ramp
    stops = sorted(ramp.elements, key=lambda e: e.position)
    value = ramp_nodes.ColorRamp(
        node["Fac"],
        np.array([e.position for e in stops], np.float32),
        np.array([tuple(e.color) for e in stops], np.float32),
        ramp.interpolation,
        ramp.color_mode,
        ramp.hue_interpolation,
    )
    return {"Color": color_nodes.Color(value), "Alpha": color_nodes.Component(value, 3)}


def curve_table(mapping: bpy.types.CurveMapping, index: int) -> ramp_nodes.CurveTable:
    """One curve of a mapping, which has been initialised, at the abscissas of Blender's own table."""
    curve = mapping.curves[index]
    ends = [p.location[0] for p in curve.points]
    low, high = min(mapping.clip_min_x, *ends), max(mapping.clip_max_x, *ends)
    values = [mapping.evaluate(curve, x) for x in np.linspace(low, high, CURVE_STEPS + 1).tolist()]
    slopes = values[0] - mapping.evaluate(curve, low - 1), mapping.evaluate(curve, high + 1) - values[-1]
    return ramp_nodes.CurveTable(low, high, tuple(values), slopes)


def _curves(value: str, factor: str, output: str, channels: int) -> Callable[[Reader], Outputs]:
    def build(node: Reader) -> Outputs:
        mapping = node.node.mapping
        mapping.initialize()
        tables = tuple(curve_table(mapping, i) for i in range(channels))
        combined = curve_table(mapping, 3) if len(mapping.curves) > 3 else None
        return {output: ramp_nodes.Curves(node[factor], node[value], tables, combined)}

    return build


def _separate(model: str, names: tuple[str, str, str], source: str) -> Callable[[Reader], Outputs]:
    def build(node: Reader) -> Outputs:
        mode = getattr(node.node, "mode", model)
        value = node[source]
        if mode != "RGB":
            value = color_nodes.ColorModel(value, f"{mode}_FROM_RGB")
        return {name: color_nodes.Component(value, i) for i, name in enumerate(names)}

    return build


def _combine(model: str, names: tuple[str, str, str], output: str) -> Callable[[Reader], Outputs]:
    def build(node: Reader) -> Outputs:
        mode = getattr(node.node, "mode", model)
        value: Expression = color_nodes.Combine(*(node[name] for name in names))
        return {output: value if mode == "RGB" else color_nodes.ColorModel(value, f"RGB_FROM_{mode}")}

    return build


def _hue_saturation(node: Reader) -> Outputs:
    return {"Color": color_nodes.HueSaturation(*(node[n] for n in ("Hue", "Saturation", "Value", "Fac", "Color")))}


# Normals


def _normal_map(node: Reader) -> Outputs:
    space = node.node.space
    if space in ("WORLD", "BLENDER_WORLD"):
        raise UnsupportedNodeError("holds normals in world space")
    flip = (1.0, 1.0, 1.0)
    if space == "BLENDER_OBJECT":
        flip = (1.0, -1.0, -1.0)
    elif getattr(node.node, "convention", "OPENGL") == "DIRECTX":
        flip = (1.0, -1.0, 1.0)
    uv = input_nodes.UV(node.node.uv_map or None) if space == "TANGENT" else None
    return {"Normal": normal_nodes.NormalMap(node["Strength"], node["Color"], uv, flip)}


def _bump(node: Reader) -> Outputs:
    node.warn("is ignored: bumps need derivatives of their height")
    return {"Normal": node["Normal"]}


RGB, XYZ, HSV = ("Red", "Green", "Blue"), ("X", "Y", "Z"), ("H", "S", "V")
NODES: dict[str, Callable[[Reader], Outputs]] = {
    "ShaderNodeUVMap": _uv,
    "ShaderNodeVertexColor": _color_attribute,
    "ShaderNodeAttribute": _attribute,
    "ShaderNodeTexCoord": _coordinates,
    "ShaderNodeTexImage": _image,
    "ShaderNodeVolumeInfo": _volume_info,
    "ShaderNodeHairInfo": _hair_info,
    "ShaderNodeLightPath": _light_path,
    "ShaderNodeValue": _value,
    "ShaderNodeRGB": _rgb,
    "ShaderNodeMath": _math,
    "ShaderNodeVectorMath": _vector_math,
    "ShaderNodeMix": _mix,
    "ShaderNodeMixRGB": _mix_rgb,
    "ShaderNodeClamp": _clamp,
    "ShaderNodeMapRange": _map_range,
    "ShaderNodeMapping": _mapping,
    "ShaderNodeValToRGB": _ramp,
    "ShaderNodeRGBCurve": _curves("Color", "Fac", "Color", 3),
    "ShaderNodeVectorCurve": _curves("Vector", "Fac", "Vector", 3),
    "ShaderNodeFloatCurve": _curves("Value", "Factor", "Value", 1),
    "ShaderNodeSeparateColor": _separate("RGB", RGB, "Color"),
    "ShaderNodeSeparateXYZ": _separate("RGB", XYZ, "Vector"),
    "ShaderNodeSeparateRGB": _separate("RGB", ("R", "G", "B"), "Image"),
    "ShaderNodeSeparateHSV": _separate("HSV", HSV, "Color"),
    "ShaderNodeCombineColor": _combine("RGB", RGB, "Color"),
    "ShaderNodeCombineXYZ": _combine("RGB", XYZ, "Vector"),
    "ShaderNodeCombineRGB": _combine("RGB", ("R", "G", "B"), "Image"),
    "ShaderNodeCombineHSV": _combine("HSV", HSV, "Color"),
    "ShaderNodeRGBToBW": lambda node: {"Val": color_nodes.Gray(node["Color"])},
    "ShaderNodeInvert": lambda node: {"Color": color_nodes.Invert(node["Fac"], node["Color"])},
    "ShaderNodeGamma": lambda node: {"Color": color_nodes.Gamma(node["Color"], node["Gamma"])},
    "ShaderNodeBrightContrast": lambda node: {
        "Color": color_nodes.BrightContrast(node["Color"], node["Bright"], node["Contrast"])
    },
    "ShaderNodeHueSaturation": _hue_saturation,
    "ShaderNodeNormalMap": _normal_map,
    "ShaderNodeBump": _bump,
}
