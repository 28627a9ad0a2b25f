"""Nodes that read world space or the object."""

from __future__ import annotations

import numpy as np

from .....core.material.expression import Expression
from .....core.material.nodes import color_nodes, input_nodes, world_nodes
from .....core.material.object_values import SPACE, attribute_value
from .tree import NodeConverter, NodeReader, Outputs


def _matrix(node: NodeReader) -> Expression:
    """world_from_object, (N, 12): known where all that shows the material is in one place."""
    placement = node.tree.placement()
    if placement is None:
        return input_nodes.ObjectValue("matrix")
    return input_nodes.Constant(tuple(np.ravel(placement.world_from_object).tolist()))


def _geometry(node: NodeReader) -> Outputs:
    """Position and Normal in world space, and which side is seen; other outputs cannot be evaluated."""
    matrix = _matrix(node)
    position, normal = (input_nodes.Coordinates(kind) for kind in ("position", "normal"))
    return {
        "Position": world_nodes.Transformed(position, matrix),
        "Normal": world_nodes.Transformed(normal, matrix, normal=True),
        "Backfacing": input_nodes.Backfacing(),
    }


def in_space_of(node: NodeReader, number: int) -> Expression:
    """The position in the space of an object with this session_uid."""
    position = world_nodes.Transformed(input_nodes.Coordinates("position"), _matrix(node))
    return world_nodes.Transformed(position, input_nodes.ObjectValue(f"{SPACE}{number}"))


def object_attribute(node: NodeReader) -> Outputs:
    """A property of the object, of its instancer or of the view layer."""
    name = attribute_value(node.node.attribute_type, node.node.attribute_name)
    value = input_nodes.ObjectValue(name)
    color = color_nodes.Color(value)
    return {
        "Color": color,
        "Vector": color,
        "Fac": color_nodes.Gray(color, mean=True),
        "Alpha": color_nodes.Component(value, 3),
    }


def _object_info(node: NodeReader) -> Outputs:
    """Location, colour, alpha, index and random number of the object: constants, if one alone shows the material."""
    placement = node.tree.placement()
    read = input_nodes.ObjectValue
    out: Outputs = {"Material Index": input_nodes.Constant((float(node.tree.pass_index),)), "Random": read("random")}
    if placement is None:
        color = read("color")
        return {
            **out,
            "Location": read("location"),
            "Color": color_nodes.Color(color),
            "Alpha": color_nodes.Component(color, 3),
            "Object Index": read("index"),
        }
    if placement.random is not None:
        out["Random"] = input_nodes.Constant((placement.random,))
    return {
        **out,
        "Location": input_nodes.Constant(tuple(row[3] for row in placement.world_from_object)),
        "Color": input_nodes.Constant(placement.color[:3]),
        "Alpha": input_nodes.Constant(placement.color[3:]),
        "Object Index": input_nodes.Constant((float(placement.index),)),
    }


WORLD_SPACE: dict[str, NodeConverter] = {"ShaderNodeNewGeometry": _geometry, "ShaderNodeObjectInfo": _object_info}
