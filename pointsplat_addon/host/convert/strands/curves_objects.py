"""Control points of Blender's Curves objects (the new hair curves)."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ....core.material.graph import Needs
from ....core.strand.curves import AUTO, CATMULL_ROM, MINIMUM_TWIST, NURBS, Curves
from .. import arrays
from ..arrays import COLOR_TYPES, READABLE_TYPES, attribute_as_color
from ..sample_material import SampleMaterial, needs_of_materials
from .control_points import VECTOR_HANDLE, ControlPoints

DEFAULT_RADIUS = 0.005  # Cycles', for curves without a radius attribute
DEFAULT_RESOLUTION = 12  # Blender's, for curves without one
SURFACE_UV = "surface_uv_coordinate"  # attribute: where on the surface each strand is attached
CUSTOM_KNOTS = 4  # Blender's mode of knots that Python cannot read


def read_curves(data: bpy.types.Curves, materials: tuple[SampleMaterial, ...], ribbons: bool) -> ControlPoints | None:
    """The control points of an evaluated Curves object in object space; None if it has none.

    materials: one for each slot; attributes that they do not read are left out. ribbons: whether normals are read.
    """
    count, total, wanted = len(data.curves), len(data.points), needs_of_materials(materials)
    if count == 0 or total == 0:
        return None
    start = arrays.read(data.curve_offset_data, "value", 1, np.int32).astype(np.int64)

    def strand_numbers(name: str, default: int) -> np.ndarray:
        """An attribute of strands, or the default, as (S,) int64."""
        found = _read_attribute(data, name)
        return np.full(count, default) if found is None or len(found) != count else found.astype(np.int64)

    radius = _read_attribute(data, "radius")
    radius = np.full(total, DEFAULT_RADIUS, np.float32) if radius is None or len(radius) != total else radius
    kind = strand_numbers("curve_type", CATMULL_ROM)
    knots = strand_numbers("knots_mode", 0)
    adaptive = kind == CATMULL_ROM if "resolution" not in data.attributes else np.zeros(count, bool)
    handle_types = [_read_attribute(data, f"handle_type_{side}") for side in ("left", "right")]
    curves = Curves(
        arrays.read(data.position_data, "vector", 3, np.float32),
        start,
        kind.astype(np.uint8),
        strand_numbers("cyclic", 0).astype(bool),
        np.where(adaptive, AUTO, np.maximum(strand_numbers("resolution", DEFAULT_RESOLUTION), 1)),
        radius,
        _read_attribute(data, "handle_left"),
        _read_attribute(data, "handle_right"),
        None if handle_types[0] is None else handle_types[0] == VECTOR_HANDLE,
        None if handle_types[1] is None else handle_types[1] == VECTOR_HANDLE,
        strand_numbers("nurbs_order", 4),
        np.where(knots == CUSTOM_KNOTS, 0, knots),
        _read_attribute(data, "nurbs_weight"),
    )
    custom = int(((knots == CUSTOM_KNOTS) & (kind == NURBS)).sum())
    colors, strand_colors = _read_colors(data, wanted)
    found = ControlPoints(
        curves,
        radius,
        colors=colors,
        strand_colors=strand_colors,
        uv=_read_uv(data, wanted),
        messages=(f"{custom} curves with custom knots are drawn with uniform ones",) if custom else (),
    )
    if ribbons:
        mode, custom_normal = strand_numbers("normal_mode", MINIMUM_TWIST), _read_attribute(data, "custom_normal")
        found = replace(found, normal_mode=mode, tilt=_read_attribute(data, "tilt"), normal=custom_normal)
    return found


def _read_attribute(data: bpy.types.Curves, name: str) -> np.ndarray | None:
    """An attribute of numbers or vectors, (N,) or (N, 2 | 3), float32, int32 or bool; None if there is none."""
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


def _read_colors(data: bpy.types.Curves, wanted: Needs) -> tuple[dict[str, np.ndarray], frozenset[str]]:
    """Colours that the materials read, by name, (P, 4) or (S, 4) as stored, and the names of those that are (S, 4)."""
    names = [n for n in sorted(n for n in wanted.colors if n is not None) if n in data.attributes]
    if None in wanted.colors:
        names = [a.name for a in data.attributes if a.data_type in COLOR_TYPES][:1] + names
    found = {n: a for n in names if (a := data.attributes[n]).data_type in READABLE_TYPES}
    return (
        {name: attribute_as_color(attribute) for name, attribute in found.items()},
        frozenset(name for name, attribute in found.items() if attribute.domain == "CURVE"),
    )


def _read_uv(data: bpy.types.Curves, wanted: Needs) -> dict[str, np.ndarray]:
    """UV coordinates of strands that materials read, by name, (S, 2), the active ones first.

    As in Cycles, the active ones are those of the attachment to the surface, which also have the name of the surface's
    UV map, or else the first attribute of two numbers.
    """
    maps = [a for a in data.attributes if a.data_type == "FLOAT2" and a.domain == "CURVE"]
    maps.sort(key=lambda a: a.name != SURFACE_UV)
    found = {a.name: arrays.read(a.data, "vector", 2, np.float32) for a in maps[:1]}
    found |= {a.name: arrays.read(a.data, "vector", 2, np.float32) for a in maps[1:] if a.name in wanted.uv}
    if SURFACE_UV in found and data.surface_uv_map:
        found.setdefault(data.surface_uv_map, found[SURFACE_UV])
    return found
