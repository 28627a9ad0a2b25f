"""Looks of scans: materials that show one of their attributes, as Cycles and geometry nodes can read them, too.

Lit ones are Lambert's: what a scan shows has no gloss of its own. Unlit ones emit what they show.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ...core.material.color_models import linear_from_srgb
from ..convert import arrays
from .objects import COLOR

LOOKS = {  # attribute ("": chosen by the person), whether its values pass a colour ramp, label, tooltip
    "COLOR": (COLOR, False, "Colour", "The colours of the file"),
    "INTENSITY": (
        "intensity",
        False,
        "Intensity",
        "How much came back, as grey from the lowest to the highest per cent",
    ),
    "HEIGHT": ("position", True, "Height", "Height above the lowest points, from blue to red"),
    "CLASS": (
        "classification",
        True,
        "Class",
        "The class of the standard (LAS): ground brown, vegetation green, buildings red",
    ),
    "RETURN": ("return_number", True, "Return", "Which of a pulse's echoes a point is"),
    "TIME": ("gps_time", True, "Time", "When the point was measured"),
    "SOURCE": ("point_source_id", True, "Source", "Which flight line or file the point is from"),
    "ATTRIBUTE": ("", True, "Attribute", "Any attribute of the points"),
    "PLAIN": (None, False, "Plain", "One grey for all points"),
}
TURBO = ((0.0, (0.19, 0.07, 0.23)), (0.13, (0.27, 0.39, 0.90)), (0.26, (0.15, 0.68, 0.93)), (0.39, (0.10, 0.89, 0.72)),
         (0.52, (0.45, 0.99, 0.40)), (0.65, (0.82, 0.91, 0.21)), (0.77, (0.99, 0.66, 0.19)), (0.89, (0.92, 0.31, 0.05)),
         (1.0, (0.48, 0.02, 0.01)))  # fmt: skip  # Mikhailov (2019), sRGB
CLASSES = ((0.62, 0.62, 0.62), (0.78, 0.78, 0.78), (0.60, 0.42, 0.24), (0.55, 0.76, 0.35), (0.30, 0.60, 0.22),
           (0.10, 0.42, 0.14), (0.80, 0.25, 0.20), (0.95, 0.20, 0.75), (0.93, 0.85, 0.35), (0.20, 0.45, 0.85),
           (0.45, 0.35, 0.55), (0.35, 0.35, 0.38), (0.70, 0.70, 0.60), (0.95, 0.75, 0.20), (0.95, 0.60, 0.15),
           (0.55, 0.45, 0.75), (0.85, 0.65, 0.45), (0.60, 0.80, 0.85), (0.90, 0.40, 0.60))  # fmt: skip  # 0 to 18, sRGB
QUANTILES = 0.01, 0.99  # of an attribute's values: what lies beyond is shown as these
SAMPLE = 1 << 17  # points that tell them


def available(data: Any) -> list[str]:
    """Returns the looks that a point cloud's attributes allow."""
    return [key for key, (name, *_) in LOOKS.items() if not name or name in data.attributes]


def default_look(columns: Sequence[str]) -> str:
    """Returns the look of a new scan."""
    return "COLOR" if COLOR in columns else "INTENSITY" if "intensity" in columns else "PLAIN"


def look_material(ob: bpy.types.Object, look: str, attribute: str = "", lit: bool = True) -> bpy.types.Material:
    """Returns a new material that shows an attribute of a scan. Raises KeyError where it has none of that name."""
    own, ramp, label, _ = LOOKS[look]
    name = attribute if own == "" else own
    made = bpy.data.materials.new(f"{ob.name} {label}")
    if not made.node_tree:
        made.use_nodes = True
    tree = made.node_tree
    shader = tree.nodes["Principled BSDF"]
    target = shader.inputs["Base Color"]
    if lit:
        shader.inputs["Roughness"].default_value = 1.0
        shader.inputs["Specular IOR Level"].default_value = 0.0
    else:
        output = tree.get_output_node("ALL")
        tree.nodes.remove(shader)
        shader = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(shader.outputs["Emission"], output.inputs["Surface"])
        target = shader.inputs["Color"]
    if name is None:
        return made
    source = tree.nodes.new("ShaderNodeAttribute")
    source.attribute_name = name
    source.location = -900, 300
    if not ramp and look == "COLOR":
        tree.links.new(source.outputs["Color"], target)
        return made
    value = source.outputs["Fac"]
    if look == "HEIGHT":
        separate = tree.nodes.new("ShaderNodeSeparateXYZ")
        separate.location = -700, 300
        tree.links.new(source.outputs["Vector"], separate.inputs["Vector"])
        value = separate.outputs["Z"]
    scale = tree.nodes.new("ShaderNodeMapRange")
    scale.location = -500, 300
    low, high = (-0.5, len(CLASSES) - 0.5) if look == "CLASS" else _range(ob.data.attributes[name], look == "HEIGHT")
    scale.inputs["From Min"].default_value, scale.inputs["From Max"].default_value = low, high
    tree.links.new(value, scale.inputs["Value"])
    if not ramp:
        tree.links.new(scale.outputs["Result"], target)
        return made
    colors = tree.nodes.new("ShaderNodeValToRGB")
    colors.location = -300, 300
    stops = [(i / len(CLASSES), color) for i, color in enumerate(CLASSES)] if look == "CLASS" else TURBO
    colors.color_ramp.interpolation = "CONSTANT" if look == "CLASS" else "LINEAR"
    elements = colors.color_ramp.elements
    while len(elements) < len(stops):
        elements.new(1.0)
    for element, (position, color) in zip(elements, stops, strict=True):
        element.position, element.color = position, (*linear_from_srgb(np.array(color)).tolist(), 1.0)
    tree.links.new(scale.outputs["Result"], colors.inputs["Fac"])
    tree.links.new(colors.outputs["Color"], target)
    return made


def _range(attribute: Any, height: bool) -> tuple[float, float]:
    """The range of most values of an attribute."""
    values = arrays.attribute_as_color(attribute)[:, 2 if height else 0]
    values = values[:: len(values) // SAMPLE + 1]
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, QUANTILES) if len(values) else (0.0, 1.0)
    return float(low), float(high if high > low else low + 1.0)
