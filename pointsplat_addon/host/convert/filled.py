"""Meshes whose materials have a volume: what fills them is a source of its own, beside their surface if any."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import bpy
import numpy as np

from .material.materials import output_node

if TYPE_CHECKING:
    from .objects import Source

Materials = tuple[bpy.types.Material | None, ...]


def filling_material(materials: Materials) -> bpy.types.Material | None:
    """Returns the first of an object's materials that has a volume; None if none has."""
    return next((m for m in materials if m is not None and _is_linked(m, "Volume")), None)


def axis_lengths(world_from_object: np.ndarray) -> tuple[float, ...]:
    """Returns the lengths of an object's three axes in world space, rounded, so that equal ones are found equal."""
    lengths = np.linalg.norm(world_from_object[:3, :3], axis=0)
    return tuple(float(f"{length:.6g}") for length in lengths)


def with_filling(source: Source, material: bpy.types.Material, scale: tuple[float, ...]) -> list[Source]:
    """Returns the source of a mesh, if it has a surface, and that of what fills it.

    scale: `axis_lengths` of the instance. Densities are those of world space: instances of other sizes are filled by
    other voxels.
    """
    filled = replace(source, materials=(material, *source.materials), filled=scale, primitive="AUTO")
    return [source, filled] if any(map(_has_surface, source.materials)) else [filled]


def _has_surface(material: bpy.types.Material | None) -> bool:
    """Whether a material has a surface: one with a volume alone has none."""
    return material is None or _is_linked(material, "Surface") or not _is_linked(material, "Volume")


def _is_linked(material: bpy.types.Material, name: str) -> bool:
    output = output_node(material)
    return output is not None and output.inputs[name].is_linked
