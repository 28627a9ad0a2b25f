"""Nodes that read world space, the object or the camera."""

from __future__ import annotations

import numpy as np

from .....core.material.expression import Expression
from .....core.material.nodes import color_nodes, input_nodes, math_nodes, view_nodes, world_nodes
from .....core.material.object_values import POINT_RADIUS, POINT_RANDOM, SPACE, attribute_value
from .tree import NodeConverter, NodeReader, Outputs

ZERO = input_nodes.Constant((0.0,))


def _matrix(node: NodeReader) -> Expression:
    """world_from_object, (N, 12): known where all that shows the material is in one place."""
    placement = node.tree.placement()
    if placement is None:
        return input_nodes.ObjectValue("matrix")
    return input_nodes.Constant(tuple(np.ravel(placement.world_from_object).tolist()))


def _geometry(node: NodeReader) -> Outputs:
    """Position and Normal in world space, and which side is seen; other outputs cannot be evaluated."""
    position = world_position(node)
    return {
        "Position": position,
        "Normal": _world_normal(node, input_nodes.Coordinates("normal")),
        "Incoming": view_nodes.Incoming(position),
        "Backfacing": input_nodes.Backfacing(),
    }


def world_position(node: NodeReader) -> Expression:
    """Where the surface lies in world space."""
    return world_nodes.Transformed(input_nodes.Coordinates("position"), _matrix(node))


def _world_normal(node: NodeReader, normal: Expression) -> Expression:
    return world_nodes.Transformed(normal, _matrix(node), normal=True)


def seen_at(node: NodeReader) -> dict[str, Expression]:
    """Coordinates by the camera: Texture Coordinate's outputs of these names."""
    position, normal = world_position(node), _world_normal(node, input_nodes.Coordinates("normal"))
    return {
        "Camera": view_nodes.InView(position),
        "Window": view_nodes.InWindow(position),
        "Reflection": view_nodes.Reflected(view_nodes.Incoming(position), normal),
    }


def _camera_data(node: NodeReader) -> Outputs:
    at = view_nodes.InView(world_position(node))
    return {
        "View Vector": math_nodes.VectorMath(at, at, at, ZERO, "NORMALIZE"),
        "View Z Depth": color_nodes.Component(at, 2),
        "View Distance": math_nodes.VectorMath(at, at, at, ZERO, "LENGTH"),
    }


def _cosine(node: NodeReader) -> Expression:
    """The cosine of the angle between the normal and the way to the eye, for Fresnel and Layer Weight.

    A normal that is linked is in object space, as those of bumps are, or it is Geometry's.
    """
    normal = node["Normal"] if node.linked("Normal") else input_nodes.Coordinates("normal")
    if not isinstance(normal, world_nodes.Transformed):
        normal = _world_normal(node, normal)
    return view_nodes.Cosine(view_nodes.Incoming(world_position(node)), normal)


def fresnel(node: NodeReader, cosine: Expression, backfacing: Expression) -> Outputs:
    """The outputs of a Fresnel node. cosine: of the angle between the normal and the way to the eye."""
    return {"Fac": view_nodes.Reflectance(cosine, node["IOR"], backfacing)}


def layer_weight(node: NodeReader, cosine: Expression, backfacing: Expression) -> Outputs:
    """The outputs of a Layer Weight node, as of `fresnel`."""
    blend = node["Blend"]
    one, least = (input_nodes.Constant((value,)) for value in (1.0, view_nodes.LEAST_INDEX))
    left = math_nodes.Math(math_nodes.Math(one, blend, ZERO, "SUBTRACT"), least, ZERO, "MAXIMUM")
    index = math_nodes.Math(one, left, ZERO, "DIVIDE")
    return {
        "Fresnel": view_nodes.Reflectance(cosine, index, backfacing),
        "Facing": view_nodes.Facing(cosine, blend),
    }


def in_space_of(node: NodeReader, number: int) -> Expression:
    """The position in the space of an object with this session_uid."""
    return world_nodes.Transformed(world_position(node), input_nodes.ObjectValue(f"{SPACE}{number}"))


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


def _point_info(node: NodeReader) -> Outputs:
    """Place, radius and random number of the point that a sample lies on; 0 on meshes and strands."""
    radius, random = (color_nodes.Component(input_nodes.Attribute(name), 4) for name in (POINT_RADIUS, POINT_RANDOM))
    return {
        "Position": world_position(node),
        "Radius": world_nodes.Lengthened(radius, _matrix(node)),
        "Random": random,
    }


WORLD_SPACE: dict[str, NodeConverter] = {
    "ShaderNodeNewGeometry": _geometry,
    "ShaderNodeObjectInfo": _object_info,
    "ShaderNodePointInfo": _point_info,
    "ShaderNodeCameraData": _camera_data,
    "ShaderNodeFresnel": lambda node: fresnel(node, _cosine(node), input_nodes.Backfacing()),
    "ShaderNodeLayerWeight": lambda node: layer_weight(node, _cosine(node), input_nodes.Backfacing()),
}
