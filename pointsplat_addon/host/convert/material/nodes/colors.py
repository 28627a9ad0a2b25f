"""Nodes that change colours: ramps, curves, channels and adjustments."""

from __future__ import annotations

import bpy
import numpy as np

from .....core.material.expression import Expression
from .....core.material.nodes import color_nodes, ramp_nodes
from .tree import NodeConverter, NodeReader, Outputs

CURVE_STEPS = 256  # Blender keeps its own curves as tables of this many steps


def _color_ramp(node: NodeReader) -> Outputs:
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
    """A curve of a CurveMapping sampled as Blender samples it: CURVE_STEPS + 1 values from end to end.

    The mapping must have been initialised. index: of the curve in `mapping.curves`.
    """
    curve = mapping.curves[index]
    ends = [p.location[0] for p in curve.points]
    low, high = min(mapping.clip_min_x, *ends), max(mapping.clip_max_x, *ends)
    values = [mapping.evaluate(curve, x) for x in np.linspace(low, high, CURVE_STEPS + 1).tolist()]
    slopes = values[0] - mapping.evaluate(curve, low - 1), mapping.evaluate(curve, high + 1) - values[-1]
    return ramp_nodes.CurveTable(low, high, tuple(values), slopes)


def _curves(value: str, factor: str, output: str, channels: int) -> NodeConverter:
    """A converter of curve nodes with inputs and an output of these identifiers."""

    def convert(node: NodeReader) -> Outputs:
        mapping = node.node.mapping
        mapping.initialize()
        tables = tuple(curve_table(mapping, i) for i in range(channels))
        combined = curve_table(mapping, 3) if len(mapping.curves) > 3 else None
        return {output: ramp_nodes.Curves(node[factor], node[value], tables, combined)}

    return convert


def _separate(model: str, names: tuple[str, str, str], source: str) -> NodeConverter:
    """A converter of nodes that split the input `source` into three outputs; model: where the node has no mode."""

    def convert(node: NodeReader) -> Outputs:
        mode = getattr(node.node, "mode", model)
        value = node[source]
        if mode != "RGB":
            value = color_nodes.ColorModel(value, f"{mode}_FROM_RGB")
        return {name: color_nodes.Component(value, i) for i, name in enumerate(names)}

    return convert


def _combine(model: str, names: tuple[str, str, str], output: str) -> NodeConverter:
    """A converter of nodes that join three inputs into one output; model: where the node has no mode."""

    def convert(node: NodeReader) -> Outputs:
        mode = getattr(node.node, "mode", model)
        value: Expression = color_nodes.Combine(*(node[name] for name in names))
        return {output: value if mode == "RGB" else color_nodes.ColorModel(value, f"RGB_FROM_{mode}")}

    return convert


def _hue_saturation(node: NodeReader) -> Outputs:
    return {"Color": color_nodes.HueSaturation(*(node[n] for n in ("Hue", "Saturation", "Value", "Fac", "Color")))}


RGB_SOCKETS, XYZ_SOCKETS, HSV_SOCKETS = ("Red", "Green", "Blue"), ("X", "Y", "Z"), ("H", "S", "V")


COLORS: dict[str, NodeConverter] = {
    "ShaderNodeValToRGB": _color_ramp,
    "ShaderNodeRGBCurve": _curves("Color", "Fac", "Color", 3),
    "ShaderNodeVectorCurve": _curves("Vector", "Fac", "Vector", 3),
    "ShaderNodeFloatCurve": _curves("Value", "Factor", "Value", 1),
    "ShaderNodeSeparateColor": _separate("RGB", RGB_SOCKETS, "Color"),
    "ShaderNodeSeparateXYZ": _separate("RGB", XYZ_SOCKETS, "Vector"),
    "ShaderNodeSeparateRGB": _separate("RGB", ("R", "G", "B"), "Image"),
    "ShaderNodeSeparateHSV": _separate("HSV", HSV_SOCKETS, "Color"),
    "ShaderNodeCombineColor": _combine("RGB", RGB_SOCKETS, "Color"),
    "ShaderNodeCombineXYZ": _combine("RGB", XYZ_SOCKETS, "Vector"),
    "ShaderNodeCombineRGB": _combine("RGB", ("R", "G", "B"), "Image"),
    "ShaderNodeCombineHSV": _combine("HSV", HSV_SOCKETS, "Color"),
    "ShaderNodeRGBToBW": lambda node: {"Val": color_nodes.Gray(node["Color"])},
    "ShaderNodeInvert": lambda node: {"Color": color_nodes.Invert(node["Fac"], node["Color"])},
    "ShaderNodeGamma": lambda node: {"Color": color_nodes.Gamma(node["Color"], node["Gamma"])},
    "ShaderNodeBrightContrast": lambda node: {
        "Color": color_nodes.BrightContrast(node["Color"], node["Bright"], node["Contrast"])
    },
    "ShaderNodeHueSaturation": _hue_saturation,
    "ShaderNodeBlackbody": lambda node: {"Color": color_nodes.Blackbody(node["Temperature"])},
}
