"""Control points of hair of Blender's particle systems."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np

from ....core.material.color_models import linear_from_srgb
from ....core.material.graph import Needs
from ....core.numeric.record import record
from ....core.strand.curves import AUTO, CATMULL_ROM, Curves
from ..sample_material import SampleMaterial, needs_of_materials
from .control_points import ControlPoints


@record
class ParticleHair:
    """A particle system that is drawn as hair. Its Blender data are valid until the dependency graph changes."""

    ob: bpy.types.Object
    modifier: bpy.types.Modifier
    final: bool  # whether it is read for a final render
    first_strand: int  # number of its first strand among all of the object

    @property
    def system(self) -> bpy.types.ParticleSystem:
        return self.modifier.particle_system

    @property
    def material(self) -> int:
        """The material slot, -1 if the object has none; Blender takes the last slot for numbers beyond it."""
        return min(self.system.settings.material, len(self.ob.material_slots)) - 1

    @property
    def shown(self) -> range:
        """Numbers of the strands that are drawn, parents first: those of children only, if there are any."""
        parents, children = len(self.system.particles), len(self.system.child_particles)
        settings = self.system.settings
        if not self.final:
            children = int(children * settings.display_percentage / 100)
        has_children = settings.child_type != "NONE" and children > 0
        return range(parents if has_children else 0, parents + children)


def hair_systems(ob: bpy.types.Object, final: bool) -> Iterator[ParticleHair]:
    """The particle systems of an evaluated object that are hair and drawn as paths; none in edit modes."""
    first_strand = 0
    if ob.mode in ("EDIT", "PARTICLE_EDIT"):
        return
    for modifier in ob.modifiers:
        if modifier.type == "PARTICLE_SYSTEM" and (modifier.show_render if final else modifier.show_viewport):
            settings = modifier.particle_system.settings
            if settings.type == "HAIR" and settings.render_type == "PATH":
                hair = ParticleHair(ob, modifier, final, first_strand)
                first_strand += len(hair.shown)
                yield hair


def read_hair(hair: ParticleHair, materials: tuple[SampleMaterial, ...]) -> ControlPoints | None:
    """The control points of a particle system in its object's space, as in Cycles; None without strands.

    materials: those that the strands use; attributes of the emitter that they do not read are left out.
    """
    system, settings, shown = hair.system, hair.system.settings, np.array(hair.shown)
    steps = (1 << (settings.render_step if hair.final else settings.display_step)) + 1
    steps += settings.kink_extra_steps if settings.kink == "SPIRAL" else 0
    if len(shown) == 0:
        return None
    # One call for each point: Blender has no other way
    calls = (system.co_hair(hair.ob, particle_no=i, step=k) for i in hair.shown for k in range(steps))
    world = np.fromiter(itertools.chain.from_iterable(calls), np.float64, len(shown) * steps * 3)
    position = _object_from_world(hair.ob, _extend_short_strands(world.reshape(len(shown), steps, 3)))
    # Parents that the viewport hides have no path
    has_path = (position != position[:, :1]).any(axis=(1, 2))
    if not has_path.any():
        return None
    position, shown = position[has_path], shown[has_path]
    length = np.cumsum(np.linalg.norm(np.diff(position, axis=1, prepend=position[:, :1]), axis=2), axis=1)
    whole = length[:, -1:]
    radius = _strand_radius(settings, np.divide(length, whole, out=np.zeros_like(length), where=whole > 0))
    count = len(shown)
    curves = Curves(
        position.reshape(-1, 3).astype(np.float32),
        np.arange(count + 1) * steps,
        np.full(count, CATMULL_ROM, np.uint8),
        np.zeros(count, bool),
        np.full(count, AUTO),
        radius.ravel().astype(np.float32),
    )
    uv, colors = _emitter_attributes(hair, shown.tolist(), needs_of_materials(materials))
    middle, half = (np.array(v, np.float64) for v in (hair.ob.data.texspace_location, hair.ob.data.texspace_size))
    return ControlPoints(
        curves,
        radius.ravel().astype(np.float32),
        colors=colors,
        strand_colors=frozenset(colors),
        uv=uv,
        first_strand=hair.first_strand,
        texture_space=np.stack([middle - half, middle + half]),
    )


def _extend_short_strands(world: np.ndarray) -> np.ndarray:
    """Points (S, K, 3) in which strands that end early, and have zeros from there on, repeat their last point."""
    step = np.arange(world.shape[1])
    known = np.where(world.any(axis=2) | (step == 0), step, 0)
    return np.take_along_axis(world, np.maximum.accumulate(known, axis=1)[..., None], axis=1)


def _object_from_world(ob: bpy.types.Object, world: np.ndarray) -> np.ndarray:
    """World-space points (..., 3) in object space."""
    matrix = np.array(ob.matrix_world.inverted_safe(), np.float64)
    return world @ matrix[:3, :3].T + matrix[:3, 3]


def _strand_radius(settings: bpy.types.ParticleSettings, along: np.ndarray) -> np.ndarray:
    """Radii (S, K) at the fractions `along` (S, K) of each strand's length, by Cycles' formula."""
    root, tip = (settings.radius_scale * 0.5 * r for r in (settings.root_radius, settings.tip_radius))
    shape, remaining = settings.shape, np.clip(1 - along, 0, 1)
    if shape < 0:
        remaining = remaining ** (1 + shape)
    elif shape > 0:
        remaining = remaining ** (1 / (1 - shape)) if shape < 1 else (remaining >= 1).astype(float)
    radius = remaining * (root - tip) + tip
    if settings.use_close_tip:
        radius[:, -1] = 0
    return radius


def _emitter_attributes(
    hair: ParticleHair, shown: list[int], wanted: Needs
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """UV coordinates (S, 2) and colours (S, 4) of the emitter at the roots of these strands, by name.

    Only those that the materials read.
    """
    mesh, system = hair.ob.data, hair.system
    parents = system.particles
    uv, colors = {}, {}
    layers = sorted(enumerate(mesh.uv_layers), key=lambda item: not item[1].active_render)
    for index, layer in layers:
        if layer.name in wanted.uv or (None in wanted.uv and layer.active_render):
            coordinates = (
                system.uv_on_emitter(hair.modifier, particle=_parent_particle(parents, i), particle_no=i, uv_no=index)
                for i in shown
            )
            uv[layer.name] = np.array([tuple(p) for p in coordinates], np.float32).reshape(-1, 2)
    corner = [a for a in mesh.color_attributes if a.domain == "CORNER" and a.data_type == "BYTE_COLOR"]
    for index, layer in enumerate(corner):
        if layer.name in wanted.colors or (
            None in wanted.colors and layer.name == mesh.color_attributes.default_color_name
        ):
            values = (
                system.mcol_on_emitter(hair.modifier, _parent_particle(parents, i), particle_no=i, vcol_no=index)
                for i in shown
            )
            stored = np.array([tuple(c)[:3] for c in values], np.float32).reshape(-1, 3)
            colors[layer.name] = np.concatenate([linear_from_srgb(stored), np.ones((len(stored), 1))], axis=1)
    return uv, colors


def _parent_particle(particles: Any, number: int) -> bpy.types.Particle:
    """The particle of a strand. Blender finds children by their number alone and ignores the particle then."""
    return particles[min(number, len(particles) - 1)]
