"""Nodes that read world space or the object."""

from __future__ import annotations

from .....core.material.nodes import input_nodes, world_nodes
from .tree import NodeConverter, NodeReader, Outputs, UnsupportedNodeError


def _geometry(node: NodeReader) -> Outputs:
    """Position and Normal in world space; other outputs cannot be evaluated."""
    placement = node.tree.placement()
    if placement is None:
        raise UnsupportedNodeError("reads world space, but its material is shown in several places")
    matrix = placement.world_from_object
    position, normal = (input_nodes.Coordinates(kind) for kind in ("position", "normal"))
    return {
        "Position": world_nodes.ToWorld(position, matrix),
        "Normal": world_nodes.ToWorld(normal, matrix, normal=True),
    }


def _object_info(node: NodeReader) -> Outputs:
    """Location, colour, alpha, index and random number of the one object that shows the material."""
    placement = node.tree.placement()
    if placement is None:
        raise UnsupportedNodeError("reads the object, but several objects or instances show its material")
    out: Outputs = {
        "Location": input_nodes.Constant(tuple(row[3] for row in placement.world_from_object)),
        "Color": input_nodes.Constant(placement.color[:3]),
        "Alpha": input_nodes.Constant(placement.color[3:]),
        "Object Index": input_nodes.Constant((float(placement.index),)),
    }
    if placement.random is not None:
        out["Random"] = input_nodes.Constant((placement.random,))
    return out


WORLD_SPACE: dict[str, NodeConverter] = {"ShaderNodeNewGeometry": _geometry, "ShaderNodeObjectInfo": _object_info}
