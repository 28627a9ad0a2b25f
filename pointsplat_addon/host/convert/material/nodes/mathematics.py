"""Nodes that compute with numbers and vectors: arithmetic, mixing, ranges and mappings."""

from __future__ import annotations

from .....core.material.expression import Expression
from .....core.material.nodes import color_nodes, input_nodes, math_functions, math_nodes
from .tree import NodeConverter, NodeReader, Outputs, UnsupportedNodeError


def _supported_operation(operation: str, table: dict) -> str:
    """`operation` itself, if `table` has it. Raises UnsupportedNodeError otherwise."""
    if operation not in table:
        raise UnsupportedNodeError(f"uses the operation {operation}, which cannot be evaluated")
    return operation


def _math(node: NodeReader) -> Outputs:
    operation = _supported_operation(node.node.operation, math_functions.MATH)
    a, b, c = (node[name] for name in ("Value", "Value_001", "Value_002"))
    return {"Value": math_nodes.Math(a, b, c, operation, node.node.use_clamp)}


def _vector_math(node: NodeReader) -> Outputs:
    operation = _supported_operation(node.node.operation, math_functions.VECTOR_MATH)
    a, b, c, scale = (node[name] for name in ("Vector", "Vector_001", "Vector_002", "Scale"))
    value = math_nodes.VectorMath(a, b, c, scale, operation)
    return {"Value" if operation in ("DOT_PRODUCT", "DISTANCE", "LENGTH") else "Vector": value}


def _mix(node: NodeReader) -> Outputs:
    kind = node.node.data_type
    if kind == "ROTATION":
        raise UnsupportedNodeError("mixes rotations")
    suffix = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}[kind]
    uniform = kind != "VECTOR" or node.node.factor_mode == "UNIFORM"
    factor, a, b = (
        node[name] for name in ("Factor_Float" if uniform else "Factor_Vector", f"A_{suffix}", f"B_{suffix}")
    )
    color = kind == "RGBA"
    blend = _supported_operation(node.node.blend_type, color_nodes.BLEND) if color else "MIX"
    mixed = color_nodes.Mix(factor, a, b, blend, node.node.clamp_factor, color and node.node.clamp_result)
    return {f"Result_{suffix}": mixed}


def _mix_rgb(node: NodeReader) -> Outputs:
    blend = _supported_operation(node.node.blend_type, color_nodes.BLEND)
    return {"Color": color_nodes.Mix(node["Fac"], node["Color1"], node["Color2"], blend, True, node.node.use_clamp)}


def _clamp(node: NodeReader) -> Outputs:
    ordered = node.node.clamp_type == "RANGE"
    return {"Result": math_nodes.Clamp(node["Value"], node["Min"], node["Max"], ordered)}


def _map_range(node: NodeReader) -> Outputs:
    vector = node.node.data_type == "FLOAT_VECTOR"
    names = ["Value", "From Min", "From Max", "To Min", "To Max", "Steps"]
    if vector:
        names = ["Vector", *(f"{name.replace(' ', '_')}_FLOAT3" for name in names[1:])]
    value, low, high, to_low, to_high, steps = (node[name] for name in names)
    kind = node.node.interpolation_type
    mapped = math_nodes.MapRange(value, low, high, to_low, to_high, steps, kind, node.node.clamp, vector)
    return {"Vector" if vector else "Result": mapped}


def _mapping(node: NodeReader) -> Outputs:
    vector, location, rotation, scale = (_input_or_zero(node, n) for n in ("Vector", "Location", "Rotation", "Scale"))
    return {"Vector": math_nodes.Mapping(vector, location, rotation, scale, node.node.vector_type)}


def _input_or_zero(node: NodeReader, identifier: str) -> Expression:
    """The value of an input, or zero if the node hides it, as mappings without translation do."""
    found = any(s.identifier == identifier for s in node.node.inputs)
    return node[identifier] if found else input_nodes.Constant((0.0, 0.0, 0.0))


MATHEMATICS: dict[str, NodeConverter] = {
    "ShaderNodeMath": _math,
    "ShaderNodeVectorMath": _vector_math,
    "ShaderNodeMix": _mix,
    "ShaderNodeMixRGB": _mix_rgb,
    "ShaderNodeClamp": _clamp,
    "ShaderNodeMapRange": _map_range,
    "ShaderNodeMapping": _mapping,
}
