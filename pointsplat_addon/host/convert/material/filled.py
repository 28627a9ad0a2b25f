"""Meshes whose materials have a volume: what fills them is a source of its own, beside their surface if any."""

from __future__ import annotations

import bpy
import numpy as np

from .materials import output_node

Materials = tuple[bpy.types.Material | None, ...]


def filling_material(materials: Materials) -> bpy.types.Material | None:
    """Returns the first of an object's materials that has a volume; None if none has."""
    return next((m for m in materials if m is not None and _is_linked(m, "Volume")), None)


def has_surface(materials: Materials) -> bool:
    """Whether any of an object's materials has a surface: one with a volume alone has none."""
    return any(m is None or _is_linked(m, "Surface") or not _is_linked(m, "Volume") for m in materials)


def axis_lengths(world_from_object: np.ndarray) -> tuple[float, ...]:
    """Returns the lengths of an object's three axes in world space, rounded, so that equal ones are found equal."""
    lengths = np.linalg.norm(world_from_object[:3, :3], axis=0)
    return tuple(float(f"{length:.6g}") for length in lengths)


def _is_linked(material: bpy.types.Material, name: str) -> bool:
    output = output_node(material)
    return output is not None and output.inputs[name].is_linked
