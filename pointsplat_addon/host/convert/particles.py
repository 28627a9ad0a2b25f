"""Particle systems that Blender itself draws as halos, as points.

Those that put objects or collections in their places are instances like any others, and hair is hair.
"""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np

from . import arrays
from .pointcloud import Points

HIDDEN = {1: "use_dead", 2: "show_unborn"}  # Particle.alive_state: the setting that shows such particles all the same


class Particles(NamedTuple):
    points: Points  # in world space
    material: bpy.types.Material | None


def read_particles(ob: bpy.types.Object, final: bool) -> list[Particles]:
    """The particles of an evaluated object's systems; a particle's size is its radius. final: a final render."""
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
    """Slots count from 1; beyond the last one Blender takes the last."""
    slots = ob.material_slots
    return slots[min(settings.material, len(slots)) - 1].material if len(slots) else None
