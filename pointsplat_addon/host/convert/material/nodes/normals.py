"""Nodes that change the normal."""

from __future__ import annotations

from .....core.material.nodes import input_nodes, math_nodes, normal_nodes
from .tree import NodeConverter, NodeReader, Outputs, UnsupportedNodeError, constant_input

ZERO = input_nodes.Constant((0.0,))


def _normal_map(node: NodeReader) -> Outputs:
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


def _bump(node: NodeReader) -> Outputs:
    height, normal = node["Height"], node["Normal"]
    if not height.varies:
        return {"Normal": normal}
    distance = constant_input(node, "Distance")
    if node.node.invert:
        distance = math_nodes.Math(ZERO, distance, ZERO, "SUBTRACT")
    return {"Normal": normal_nodes.Bump(height, node["Strength"], distance, normal)}


def _normal(node: NodeReader) -> Outputs:
    """A constant direction, and the cosine of its angle to the input."""
    direction = input_nodes.Constant(tuple(float(v) for v in node.node.outputs["Normal"].default_value))
    unit, given = (math_nodes.VectorMath(v, v, v, ZERO, "NORMALIZE") for v in (direction, node["Normal"]))
    return {"Normal": unit, "Dot": math_nodes.VectorMath(unit, given, unit, ZERO, "DOT_PRODUCT")}


NORMALS: dict[str, NodeConverter] = {
    "ShaderNodeNormalMap": _normal_map,
    "ShaderNodeBump": _bump,
    "ShaderNodeNormal": _normal,
}
