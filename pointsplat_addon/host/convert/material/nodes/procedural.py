"""Procedural textures: noise, cells and patterns."""

from __future__ import annotations

import bpy

from .....core.material.expression import Expression
from .....core.material.nodes import color_nodes, input_nodes
from .....core.material.nodes.procedural import noise, patterns, voronoi
from .tree import NodeConverter, NodeReader, Outputs

BLENDER_5 = bpy.app.version >= (5, 0, 0)  # which changed some textures
NOWHERE = input_nodes.Constant((0.0, 0.0, 0.0))


def _point(node: NodeReader, dimensions: str = "3D") -> tuple[Expression, int]:
    """The vector at which a texture is read and its number of dimensions; unlinked, generated coordinates as in Cycles.

    In one dimension the vector is not read, so that it must not make the value vary.
    """
    count = int(dimensions[0])
    if count == 1:
        return NOWHERE, count
    return node["Vector"] if node.linked("Vector") else input_nodes.Coordinates("generated"), count


def _noise(node: NodeReader) -> Outputs:
    vector, dimensions = _point(node, node.node.noise_dimensions)
    names = ("W", "Scale", "Detail", "Roughness", "Lacunarity", "Offset", "Gain", "Distortion")
    inputs = (node[name] for name in names)
    texture, colored = node.node, node.used("Color")
    settings = {"kind": texture.noise_type, "normalize": texture.normalize, "colored": colored}
    value = noise.Noise(vector, *inputs, dimensions=dimensions, **settings)
    out: Outputs = {"Fac": color_nodes.Component(value, 0)}
    return out | {"Color": color_nodes.Color(value)} if colored else out


def _white_noise(node: NodeReader) -> Outputs:
    vector, dimensions = _point(node, node.node.noise_dimensions)
    value = noise.WhiteNoise(vector, node["W"], dimensions)
    return {"Value": color_nodes.Component(value, 0), "Color": color_nodes.Color(value)}


def _voronoi(node: NodeReader) -> Outputs:
    vector, dimensions = _point(node, node.node.voronoi_dimensions)
    names = ("W", "Scale", "Detail", "Roughness", "Lacunarity", "Smoothness", "Exponent", "Randomness")
    texture = node.node
    value = voronoi.Voronoi(
        vector,
        *(node[name] for name in names),
        dimensions=dimensions,
        feature=texture.feature,
        metric=texture.distance,
        normalize=texture.normalize,
        congruential=BLENDER_5,
    )
    first = color_nodes.Component(value, 0)
    if texture.feature in ("DISTANCE_TO_EDGE", "N_SPHERE_RADIUS"):
        return {"Distance" if texture.feature == "DISTANCE_TO_EDGE" else "Radius": first}
    color, position = (color_nodes.Combine(*(color_nodes.Component(value, i + k) for k in range(3))) for i in (1, 4))
    return {"Distance": first, "Color": color, "Position": position, "W": color_nodes.Component(value, 7)}


def _checker(node: NodeReader) -> Outputs:
    factor = patterns.Checker(_point(node)[0], node["Scale"])
    return {"Color": color_nodes.Mix(factor, node["Color2"], node["Color1"], "MIX"), "Fac": factor}


def _gradient(node: NodeReader) -> Outputs:
    value = patterns.Gradient(_point(node)[0], node.node.gradient_type)
    return {"Color": color_nodes.Color(value), "Fac": value}


def _wave(node: NodeReader) -> Outputs:
    wave = node.node
    rings = wave.wave_type == "RINGS"
    names = ("Scale", "Distortion", "Detail", "Detail Scale", "Detail Roughness", "Phase Offset")
    direction = wave.rings_direction if rings else wave.bands_direction
    inputs = (node[name] for name in names)
    value = patterns.Wave(_point(node)[0], *inputs, rings=rings, direction=direction, profile=wave.wave_profile)
    return {"Color": color_nodes.Color(value), "Fac": value}


def _magic(node: NodeReader) -> Outputs:
    inputs = _point(node)[0], node["Scale"], node["Distortion"]
    color = patterns.Magic(*inputs, node.node.turbulence_depth, wrapped=BLENDER_5)
    return {"Color": color, "Fac": color_nodes.Gray(color, mean=True)}


def _brick(node: NodeReader) -> Outputs:
    names = (
        *("Color1", "Color2", "Mortar", "Scale", "Mortar Size", "Mortar Smooth"),
        *("Bias", "Brick Width", "Row Height"),
    )
    brick = node.node
    value = patterns.Brick(
        _point(node)[0],
        *(node[name] for name in names),
        offset=brick.offset,
        offset_frequency=brick.offset_frequency,
        squash=brick.squash,
        squash_frequency=brick.squash_frequency,
    )
    return {"Color": color_nodes.Color(value), "Fac": color_nodes.Component(value, 3)}


PROCEDURAL: dict[str, NodeConverter] = {
    "ShaderNodeTexNoise": _noise,
    "ShaderNodeTexWhiteNoise": _white_noise,
    "ShaderNodeTexVoronoi": _voronoi,
    "ShaderNodeTexChecker": _checker,
    "ShaderNodeTexGradient": _gradient,
    "ShaderNodeTexWave": _wave,
    "ShaderNodeTexMagic": _magic,
    "ShaderNodeTexBrick": _brick,
}
