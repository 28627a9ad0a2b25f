"""Nodes without inputs that vary: coordinates, attributes, image textures and constants."""

from __future__ import annotations

from .....core.material.expression import Expression
from .....core.material.hair_color import strand_attribute
from .....core.material.nodes import color_nodes, input_nodes, projection_nodes, texture_nodes
from ..images import convert_image
from .tree import NodeConverter, NodeReader, Outputs, UnsupportedNodeError
from .world_space import in_space_of, object_attribute, seen_at


def _uv_map(node: NodeReader) -> Outputs:
    if node.node.from_instancer:
        raise UnsupportedNodeError("reads the instancer")
    return {"UV": input_nodes.UV(node.node.uv_map or None)}


def _color_attribute(node: NodeReader) -> Outputs:
    color = input_nodes.ColorAttribute(node.node.layer_name or None)
    return {"Color": color_nodes.Color(color), "Alpha": color_nodes.Component(color, 3)}


def _attribute(node: NodeReader) -> Outputs:
    if node.node.attribute_type != "GEOMETRY":
        return object_attribute(node)
    value = input_nodes.Attribute(node.node.attribute_name)
    color = color_nodes.Color(value)
    return {
        "Color": color,
        "Vector": color,
        "Fac": color_nodes.Component(value, 4),
        "Alpha": color_nodes.Component(value, 3),
    }


def _texture_coordinates(node: NodeReader) -> Outputs:
    if node.node.from_instancer:
        raise UnsupportedNodeError("reads the instancer")
    out: Outputs = {
        "Generated": input_nodes.Coordinates("generated"),
        "Normal": input_nodes.Coordinates("normal"),
        "UV": input_nodes.UV(),
        **seen_at(node),
    }
    other = node.node.object
    out["Object"] = (
        input_nodes.Coordinates("position") if other is None else in_space_of(node, other.original.session_uid)
    )
    return out


def _image_texture(node: NodeReader) -> Outputs:
    texture = node.node
    image, problem = convert_image(texture.image)
    if problem is not None:
        node.warn(problem)
    interpolation = "Cubic" if texture.interpolation == "Smart" else texture.interpolation
    uv = node["Vector"] if node.linked("Vector") else input_nodes.UV()

    def shown(at: Expression) -> Expression:
        return texture_nodes.ImageTexture(at, image, interpolation, texture.extension, straight=node.used("Alpha"))

    if texture.projection == "BOX":
        normal = input_nodes.Coordinates("normal")
        x, y, z = (shown(projection_nodes.FromSide(uv, normal, axis)) for axis in range(3))
        value: Expression = projection_nodes.FromSixSides(x, y, z, normal, float(texture.projection_blend))
    elif texture.projection == "FLAT":
        value = shown(uv)
    else:
        value = shown(projection_nodes.Wrapped(uv, texture.projection == "SPHERE"))
    return {"Color": color_nodes.Color(value), "Alpha": color_nodes.Component(value, 3)}


def _volume_info(node: NodeReader) -> Outputs:
    color: Outputs = {"Color": color_nodes.Color(input_nodes.Attribute("color"))}
    return color | {
        name: color_nodes.Component(input_nodes.Attribute(name.lower()), 4)
        for name in ("Density", "Flame", "Temperature")
    }


def strand_value(name: str) -> Expression:
    """A property that strands have of themselves, such as "intercept" (convert.strands.conversion); 0 elsewhere."""
    return color_nodes.Component(input_nodes.Attribute(strand_attribute(name)), 4)


def _curves_info(node: NodeReader) -> Outputs:
    names = ("Is Strand", "Intercept", "Length", "Thickness", "Random")
    return {name: strand_value(name.lower().replace(" ", "_")) for name in names}


def _light_path(node: NodeReader) -> Outputs:
    """Values of rays that come from the camera and have met nothing yet: surfaces are shaded for no others."""
    names = (s.identifier for s in node.node.outputs)
    return {name: input_nodes.Constant((float(name == "Is Camera Ray"),)) for name in names if name != "Ray Length"}


def _value(node: NodeReader) -> Outputs:
    return {"Value": input_nodes.Constant((float(node.node.outputs[0].default_value),))}


def _rgb(node: NodeReader) -> Outputs:
    return {"Color": input_nodes.Constant(tuple(float(v) for v in node.node.outputs[0].default_value)[:3])}


INPUTS: dict[str, NodeConverter] = {
    "ShaderNodeUVMap": _uv_map,
    "ShaderNodeVertexColor": _color_attribute,
    "ShaderNodeAttribute": _attribute,
    "ShaderNodeTexCoord": _texture_coordinates,
    "ShaderNodeTexImage": _image_texture,
    "ShaderNodeVolumeInfo": _volume_info,
    "ShaderNodeHairInfo": _curves_info,
    "ShaderNodeLightPath": _light_path,
    "ShaderNodeValue": _value,
    "ShaderNodeRGB": _rgb,
}
