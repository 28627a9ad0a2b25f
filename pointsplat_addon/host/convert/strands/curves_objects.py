"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ....core.material.graph import Needs
from ....core.strand.curves import AUTO, CATMULL_ROM, MINIMUM_TWIST, NURBS, Curves
from .. import arrays
from ..arrays import COLOR_TYPES, attribute_as_color
from ..sample_material import SampleMaterial, needs_of_materials
from .control_points import VECTOR_HANDLE, ControlPoints

DEFAULT_RADIUS = 0.005  # Cycles', for curves without a radius attribute
DEFAULT_RESOLUTION = 12  # Blender's, for curves without one
SURFACE_UV = "surface_uv_coordinate"  # where hair is attached
CUSTOM_KNOTS = 4  # a mode whose knots Python cannot read
READABLE_TYPES = (*COLOR_TYPES, "FLOAT", "FLOAT_VECTOR")


def read_curves(data: bpy.types.Curves, materials: tuple[SampleMaterial, ...], ribbons: bool) -> ControlPoints | None:
    """An evaluated Curves object, in object space; None where it is empty. ribbons: with normals."""
    count, total, asked = len(data.curves), len(data.points), needs_of_materials(materials)
    if count == 0 or total == 0:
        return None
    start = arrays.read(data.curve_offset_data, "value", 1, np.int32).astype(np.int64)

    def number(name: str, default: int) -> np.ndarray:
        found = _read_attribute(data, name)
        return np.full(count, default) if found is None or len(found) != count else found.astype(np.int64)

    radius = _read_attribute(data, "radius")
    radius = np.full(total, DEFAULT_RADIUS, np.float32) if radius is None or len(radius) != total else radius
    kind = number("curve_type", CATMULL_ROM)
    knots = number("knots_mode", 0)
    free = kind == CATMULL_ROM if "resolution" not in data.attributes else np.zeros(count, bool)
    types = [_read_attribute(data, f"handle_type_{side}") for side in ("left", "right")]
    curves = Curves(
        arrays.read(data.position_data, "vector", 3, np.float32),
        start,
        kind.astype(np.uint8),
        number("cyclic", 0).astype(bool),
        np.where(free, AUTO, np.maximum(number("resolution", DEFAULT_RESOLUTION), 1)),
        radius,
        _read_attribute(data, "handle_left"),
        _read_attribute(data, "handle_right"),
        None if types[0] is None else types[0] == VECTOR_HANDLE,
        None if types[1] is None else types[1] == VECTOR_HANDLE,
        number("nurbs_order", 4),
        np.where(knots == CUSTOM_KNOTS, 0, knots),
        _read_attribute(data, "nurbs_weight"),
    )
    custom = int(((knots == CUSTOM_KNOTS) & (kind == NURBS)).sum())
    colors, of_strand = _read_colors(data, asked, total)
    found = ControlPoints(
        curves,
        radius,
        colors=colors,
        of_strand=of_strand,
        uv=_read_uv(data, asked),
        messages=(f"{custom} curves with knots of their own have uniform ones",) if custom else (),
    )
    if ribbons:
        mode, custom_normal = number("normal_mode", MINIMUM_TWIST), _read_attribute(data, "custom_normal")
        found = replace(found, normal_mode=mode, tilt=_read_attribute(data, "tilt"), normal=custom_normal)
    return found


def _read_attribute(data: bpy.types.Curves, name: str) -> np.ndarray | None:
    """An attribute of numbers or vectors, float32 or int32, None where there is none."""
    attribute = data.attributes.get(name)
    if attribute is None:
        return None
    if attribute.data_type in ("FLOAT_VECTOR", "FLOAT2"):
        return arrays.read(attribute.data, "vector", 3 if attribute.data_type == "FLOAT_VECTOR" else 2, np.float32)
    if attribute.data_type == "BOOLEAN":
        value = np.empty(len(attribute.data), bool)
        attribute.data.foreach_get("value", value)
        return value
    return arrays.read(attribute.data, "value", 1, np.float32 if attribute.data_type == "FLOAT" else np.int32)


def _read_colors(data: bpy.types.Curves, asked: Needs, total: int) -> tuple[dict[str, np.ndarray], frozenset[str]]:
    """Attributes that the materials read, and which of them are one for each strand."""
    names = [n for n in sorted(n for n in asked.colors if n is not None) if n in data.attributes]
    if None in asked.colors:
        names = [a.name for a in data.attributes if a.data_type in COLOR_TYPES][:1] + names
    found = {n: a for n in names if (a := data.attributes[n]).data_type in READABLE_TYPES}
    return (
        {name: attribute_as_color(attribute) for name, attribute in found.items()},
        frozenset(name for name, attribute in found.items() if attribute.domain == "CURVE"),
    )


def _read_uv(data: bpy.types.Curves, asked: Needs) -> dict[str, np.ndarray]:
    """Places on the surface: the attachment's, which also goes by the name of the surface's UV map, or the first
    attribute of two numbers, as in Cycles."""
    maps = [a for a in data.attributes if a.data_type == "FLOAT2" and a.domain == "CURVE"]
    maps.sort(key=lambda a: a.name != SURFACE_UV)
    found = {a.name: arrays.read(a.data, "vector", 2, np.float32) for a in maps[:1]}
    found |= {a.name: arrays.read(a.data, "vector", 2, np.float32) for a in maps[1:] if a.name in asked.uv}
    if SURFACE_UV in found and data.surface_uv_map:
        found.setdefault(data.surface_uv_map, found[SURFACE_UV])
    return found
