"""Particle systems that Blender draws as halos, as points.

Those that draw objects or collections are ordinary instances; hair is read by strands/particle_hair.py.
"""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np

from . import arrays
from .pointcloud import Points

HIDDEN = {1: "use_dead", 2: "show_unborn"}  # Particle.alive_state to the setting that shows such particles


class Particles(NamedTuple):
    """The points of one particle system, with their material."""

    points: Points  # in world space
    material: bpy.types.Material | None


def read_particles(ob: bpy.types.Object, final: bool) -> list[Particles]:
    """The particles of an evaluated object's systems, with their sizes as radii. final: for a final render."""
    found = []
    for modifier in ob.modifiers:
        if modifier.type == "PARTICLE_SYSTEM" and (modifier.show_render if final else modifier.show_viewport):
            settings = modifier.particle_system.settings
            if settings.type == "EMITTER" and settings.render_type == "HALO":
                points = _points(modifier.particle_system)
                if len(points.position):
                    found.append(Particles(points, _material(ob, settings)))
    return found


def _points(system: bpy.types.ParticleSystem) -> Points:
    """The particles that are shown and have a finite position and a size."""
    particles, settings = system.particles, system.settings
    state = arrays.read(particles, "alive_state", 1, np.int32)
    position = arrays.read(particles, "location", 3, np.float32)
    size = arrays.read(particles, "size", 1, np.float32)
    shown = np.isfinite(position).all(axis=1) & (size > 0)
    for number, setting in HIDDEN.items():
        if not getattr(settings, setting):
            shown &= state != number
    return Points(position[shown], size[shown])


def _material(ob: bpy.types.Object, settings: bpy.types.ParticleSettings) -> bpy.types.Material | None:
    """The material of a system: slots count from 1, and Blender takes the last one for numbers beyond it."""
    slots = ob.material_slots
    return slots[min(settings.material, len(slots)) - 1].material if len(slots) else None
