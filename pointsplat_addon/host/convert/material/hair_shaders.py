"""Shader nodes of hair as surfaces, with constants for the table of hair."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....core.material.expression import constant
from ....core.material.nodes import input_nodes, math_nodes
from ....core.material.nodes.hair_nodes import HairColor
from .nodes.inputs import strand_value
from .nodes.tree import HairConstants, NodeReader, constant_input
from .surface import ONE, ZERO, Surface, is_constant, multiply


def _principled_hair(node: NodeReader) -> Surface:
    """A surface with the colour that the hair's absorption gives; its other constants go to `node.tree.hair`."""
    if node.tree.hair is not None:
        node.warn(
            "is one of several hair shaders in its material; the roughness and coat of one of them are used for all"
        )
    huang = getattr(node.node, "model", "CHIANG") == "HUANG"
    if huang:
        node.warn("uses Huang's model, which is shaded as a round fibre")
    random = node["Random"] if node.linked("Random") else strand_value("random")
    amount = math_nodes.Clamp(node["Random Roughness"], ZERO, ONE)
    roughness = node["Roughness"]
    if not is_constant(amount, 0):
        deviation = math_nodes.Math(multiply(input_nodes.Constant((2.0,)), random), ONE, ZERO, "SUBTRACT")
        roughness = multiply(roughness, math_nodes.Math(ONE, multiply(deviation, amount), ZERO, "ADD"))
    radial = constant_input(node, "Roughness" if huang else "Radial Roughness")
    names = {"COLOR": "Color", "MELANIN": "Melanin", "ABSORPTION": "Absorption Coefficient"}
    kind = node.node.parametrization
    melanin = kind == "MELANIN"
    # Only melanin is random: what is not read must not make the colour vary
    use = {name: node[name] if melanin else ZERO for name in ("Melanin Redness", "Tint", "Random Color")}
    varied = melanin and not is_constant(use["Random Color"], 0)
    value = node[names[kind]]
    color = HairColor(
        value, use["Melanin Redness"], use["Tint"], use["Random Color"], random if varied else ZERO, radial, kind
    )
    numbers = {
        name: _constant_number(node, name) for name in ("Coat", "IOR", "Offset", "R lobe", "TT lobe", "TRT lobe")
    }
    lobes = tuple(max(numbers[f"{name} lobe"], 0.0) if huang else 1.0 for name in ("R", "TT", "TRT"))
    fibre = constant(radial)
    node.tree.hair = HairConstants(
        radial=0.3 if fibre is None else float(np.clip(fibre[0], 0, 1)),
        coat=0.0 if huang else min(max(numbers["Coat"], 0.0), 1.0),
        tilt=numbers["Offset"],
        lobes=lobes,
    )
    ior, specular = input_nodes.Constant((numbers["IOR"],)), input_nodes.Constant((0.5,))
    return Surface(base_color=color, roughness=roughness, ior=ior, specular=specular)


def _constant_number(node: NodeReader, identifier: str) -> float:
    """The value of an input that must not vary; 0 if it cannot be evaluated."""
    value = constant(constant_input(node, identifier))
    return 0.0 if value is None else float(np.nan_to_num(value[0]))


def _hair(node: NodeReader) -> Surface:
    node.warn("is drawn like a diffuse surface of its colour")
    return Surface(base_color=node["Color"])


HAIR_SHADERS: dict[str, Callable[[NodeReader], Surface]] = {
    "ShaderNodeBsdfHairPrincipled": _principled_hair,
    "ShaderNodeBsdfHair": _hair,
}
