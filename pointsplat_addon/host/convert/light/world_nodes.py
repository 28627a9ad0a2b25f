"""Nodes that mean something else in a world than in a material: the position is the direction that is looked in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....core.material.expression import Expression
from ....core.material.nodes import color_nodes, direction_nodes, input_nodes, texture_nodes, world_nodes
from ....core.sky.medium import Atmosphere
from ....core.sky.sky import Disc, Sky
from ..material.images import convert_image
from ..material.nodes.table import NODES
from ..material.nodes.tree import NodeConverter, NodeReader, Outputs, TreeReader, UnsupportedNodeError
from ..material.nodes.world_space import fresnel, layer_weight

DIRECTION, BACK = input_nodes.Coordinates("position"), input_nodes.Coordinates("normal")
ZERO, ONE, TWO, BLACK = (input_nodes.Constant(value) for value in ((0.0,), (1.0,), (2.0,), (0.0, 0.0, 0.0)))
MODELS = {"NISHITA": "SINGLE_SCATTERING"}  # names before Blender 5
SCATTERED = ("SINGLE_SCATTERING", "MULTIPLE_SCATTERING")
CAMERA, DIFFUSE, GLOSSY = "Is Camera Ray", "Is Diffuse Ray", "Is Glossy Ray"  # kinds of rays, by their output's name


class WorldReader(TreeReader):
    """A reader for the nodes of a world of this name, as rays of one kind see them: CAMERA, DIFFUSE or GLOSSY.

    suns: whether skies show the sun's disc.
    """

    kind = "World"

    def __init__(self, name: str, ray: str, suns: bool) -> None:
        super().__init__(name, NODES | WORLD_NODES | {"ShaderNodeLightPath": light_path(ray)})
        self.suns = suns
        self.discs: list[Disc] = []  # that skies have, whether or not they show them


def _texture_coordinates(node: NodeReader) -> Outputs:
    other = node.node.object
    here: Expression = DIRECTION
    if other is not None:
        matrix = np.linalg.pinv(np.array(other.matrix_world))[:3]
        here = world_nodes.Transformed(DIRECTION, input_nodes.Constant(tuple(matrix.ravel().tolist())))
    return {"Generated": DIRECTION, "Object": here, "Normal": BACK, "Reflection": BACK, "UV": BLACK}


def _geometry(node: NodeReader) -> Outputs:
    dark = ("Backfacing", "Pointiness", "Random Per Island")
    return {
        "Position": DIRECTION,
        "Normal": BACK,
        "True Normal": BACK,
        "Incoming": BACK,
        "Parametric": input_nodes.Constant((1.0, 0.0, 0.0)),
        **dict.fromkeys(dark, ZERO),
    }


def light_path(ray: str) -> NodeConverter:
    """A converter of Light Path as rays of one kind, CAMERA, DIFFUSE or GLOSSY, see it."""

    def convert(node: NodeReader) -> Outputs:
        """Values of rays from the camera, or that one surface has reflected."""
        found: Outputs = dict.fromkeys((s.identifier for s in node.node.outputs if s.identifier != "Ray Length"), ZERO)
        found |= {ray: ONE, "Ray Depth": ONE}
        if ray != CAMERA:
            found |= {"Is Reflection Ray": ONE, "Ray Depth": TWO, f"{ray.split()[1]} Depth": ONE}
        return found

    return convert


def _environment(node: NodeReader) -> Outputs:
    texture = node.node
    image, problem = convert_image(texture.image)
    if problem is not None:
        node.warn(problem)
    vector = node["Vector"] if node.linked("Vector") else DIRECTION
    project = direction_nodes.MirrorBall if texture.projection == "MIRROR_BALL" else direction_nodes.Equirectangular
    interpolation = "Cubic" if texture.interpolation == "Smart" else texture.interpolation
    return {"Color": color_nodes.Color(texture_nodes.ImageTexture(project(vector), image, interpolation))}


def _sky(node: NodeReader) -> Outputs:
    texture, tree = node.node, node.tree
    kind = str(MODELS.get(texture.sky_type, texture.sky_type))
    elevation, rotation = texture.sun_elevation, texture.sun_rotation
    if kind in SCATTERED:
        flat = np.cos(elevation)
        sun = (flat * np.sin(rotation), flat * np.cos(rotation), np.sin(elevation))
    else:
        sun = np.array(texture.sun_direction, float)
        sun = sun / np.linalg.norm(sun) if sun.any() else np.array([0.0, 0.0, 1.0])
    aerosol = texture.aerosol_density if hasattr(texture, "aerosol_density") else texture.dust_density
    air = Atmosphere(texture.altitude, texture.air_density, aerosol, texture.ozone_density)
    toward = float(sun[0]), float(sun[1]), float(sun[2])
    # What a model does not read is left out, so that it changes no picture.
    sky = Sky(kind, toward, atmosphere=air) if kind in SCATTERED else Sky(kind, toward, texture.turbidity)
    if kind == "HOSEK_WILKIE":
        node.warn("shows the sky of Preetham, not of Hosek and Wilkie, whose tables are not there")
    vector = node["Vector"] if node.linked("Vector") else DIRECTION
    disc = None
    if kind in SCATTERED and texture.sun_disc and texture.sun_size > 0:
        disc = Disc(sky, texture.sun_size / 2, texture.sun_intensity)
        assert isinstance(tree, WorldReader)
        tree.discs.append(disc)
        disc = disc if tree.suns else None
    return {"Color": direction_nodes.SkyTexture(vector, sky, disc)}


def _nothing(*names: str) -> Callable[[NodeReader], Outputs]:
    """A converter of nodes that read objects, of which worlds know nothing: all is 0, as in Cycles."""

    def convert(node: NodeReader) -> Outputs:
        found: Outputs = {s.identifier: BLACK if s.type in ("VECTOR", "RGBA") else ZERO for s in node.node.outputs}
        return found | dict.fromkeys(names, ONE)

    return convert


def _attribute(node: NodeReader) -> Outputs:
    if node.node.attribute_type == "VIEW_LAYER":
        raise UnsupportedNodeError("reads a property of the view layer")
    return _nothing()(node)


def _facing(convert: Callable[[NodeReader, Expression, Expression], Outputs]) -> NodeConverter:
    """A converter of nodes that depend on the angle to the eye: a world's normal points back to it."""

    def facing(node: NodeReader) -> Outputs:
        if node.linked("Normal"):
            raise UnsupportedNodeError("reads a normal")
        return convert(node, ONE, ZERO)

    return facing


def _without_camera(node: NodeReader) -> Outputs:
    raise UnsupportedNodeError("cannot be evaluated")


WORLD_NODES: dict[str, NodeConverter] = {
    "ShaderNodeTexCoord": _texture_coordinates,
    "ShaderNodeNewGeometry": _geometry,
    "ShaderNodeTexEnvironment": _environment,
    "ShaderNodeTexSky": _sky,
    "ShaderNodeFresnel": _facing(fresnel),
    "ShaderNodeLayerWeight": _facing(layer_weight),
    "ShaderNodeCameraData": _without_camera,
    "ShaderNodeObjectInfo": _nothing(),
    "ShaderNodePointInfo": _nothing(),
    "ShaderNodeParticleInfo": _nothing(),
    "ShaderNodeHairInfo": _nothing(),
    "ShaderNodeVertexColor": _nothing(),
    "ShaderNodeUVMap": _nothing(),
    "ShaderNodeAttribute": _attribute,
}
