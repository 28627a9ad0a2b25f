"""Blender's world as core's: one colour, an environment texture, or the picture of a graph of nodes."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from mathutils import Euler

from ....core.material.color_models import linear_from_srgb
from ....core.material.image import Image
from ....core.scene.lights import Light
from ....core.scene.volume import Volume
from ....core.scene.world import Fog, World
from ....core.volume.optics import voxel_optics
from ..material.images import convert_image
from ..material.media import read_medium
from ..material.nodes.table import constant_value, tree_reader
from ..material.nodes.tree import Path, resolve
from .world_surface import EMITTERS, graph_world

DIRECTIONS = {("ShaderNodeTexCoord", "Generated"), ("ShaderNodeNewGeometry", "Position")}


def convert_world(depsgraph: bpy.types.Depsgraph) -> tuple[World, list[Light], list[str]]:
    """The world of an evaluated scene, a view layer's override included, the suns of its skies, and warnings."""
    override = getattr(depsgraph.view_layer_eval, "world_override", None)
    return from_world(override or depsgraph.scene_eval.world)


def from_world(world: bpy.types.World | None) -> tuple[World, list[Light], list[str]]:
    """An evaluated world as a World, the suns of its skies, and warnings; None is a black world."""
    found, suns, warnings = _surface(world)
    if world is not None:
        found = replace(found, occlusion_distance=world.light_settings.distance)
    if world is None or (output := _output(world)) is None or not output.inputs["Volume"].is_linked:
        return found, suns, warnings
    fog, messages = _fog(world.name, output.inputs["Volume"])
    return replace(found, fog=fog), suns, [*warnings, *messages]


def _output(world: bpy.types.World) -> bpy.types.Node | None:
    """The world's output node; None if it has none, or uses no nodes."""
    if world.node_tree is None or (bpy.app.version < (5, 0) and not world.use_nodes):
        return None
    return world.node_tree.get_output_node("ALL")


def _fog(name: str, socket: bpy.types.NodeSocket) -> tuple[Fog | None, list[str]]:
    """What the volume of a world is, and warnings: one fog, the same everywhere. None if it changes nothing."""
    tree = tree_reader(name)
    medium = read_medium(tree, socket)
    warnings = [w.replace('Material "', 'World "', 1) for w in tree.warnings]
    if medium is None:
        return None, warnings
    one = Volume("", name, np.zeros((1, 3), np.int32), np.eye(4), share=np.ones(1, np.float32))
    optics, more = voxel_optics(one, medium)
    extinction = np.broadcast_to(optics.extinction[0], (3,)).astype(float)
    emission = np.zeros(3) if optics.emission is None else optics.emission[0].astype(float)
    emission = np.where(extinction > 0, emission, 0.0)  # it would have no bound
    if not (extinction.any() or emission.any()):
        return None, [*warnings, *more]
    return Fog(extinction, extinction * optics.albedo[0], emission, medium.anisotropy), [*warnings, *more]


def _surface(world: bpy.types.World | None) -> tuple[World, list[Light], list[str]]:
    """The world without its volume, the suns of its skies, and warnings."""
    if world is None:
        return World(), [], []
    if world.node_tree is None or (bpy.app.version < (5, 0) and not world.use_nodes):
        return World(color=np.array(world.color, float)), [], []
    output = _output(world)
    if output is None:
        return World(), [], []
    turned = _turned_picture(world.name, output.inputs["Surface"])
    if turned is not None:
        return turned[0], [], turned[1]
    return graph_world(world.name, output.inputs["Surface"])


def _turned_picture(name: str, socket: bpy.types.NodeSocket) -> tuple[World, list[str]] | None:
    """The world, and warnings, if it is one environment texture that is turned, whose texels are then its own; else
    None."""
    found = resolve(socket, ())
    if found is None or found[0].node.bl_idname not in EMITTERS:
        return None
    node, path = found[0].node, found[1]
    strength = constant_value(node.inputs["Strength"], path)
    found = resolve(node.inputs["Color"], path)
    if strength is None or found is None:
        return None
    texture, path = found[0].node, found[1]
    if texture.bl_idname != "ShaderNodeTexEnvironment" or texture.projection != "EQUIRECTANGULAR":
        return None
    rotation = _rotation(texture, path)
    if rotation is None:
        return None
    image, problem = convert_image(texture.image)
    warnings = [f'World "{name}": node "{texture.label or texture.name}" {problem}'] if problem else []
    return World(image=_linear(image) * np.float32(strength[0]), world_rotation=rotation), warnings


def _linear(image: Image) -> np.ndarray:
    """Texels of an image as (H, W, 3) float32, scene-linear."""
    texels = image.texels[..., :3]
    if texels.dtype == np.uint8:
        codes = np.arange(256, dtype=np.float32) / 255
        return (linear_from_srgb(codes) if image.srgb else codes)[texels]
    return linear_from_srgb(texels) if image.srgb else texels


def _rotation(texture: bpy.types.Node, path: Path) -> np.ndarray | None:
    """Rotation image_from_world (3, 3) of an environment texture; None if it is no rotation."""
    found = resolve(texture.inputs["Vector"], path)
    rotation = np.eye(3)
    if found is not None and found[0].node.bl_idname == "ShaderNodeMapping":
        mapping, path = found[0].node, found[1]
        angles, scale = (constant_value(mapping.inputs[key], path) for key in ("Rotation", "Scale"))
        translates = mapping.vector_type in {"POINT", "TEXTURE"}
        location = constant_value(mapping.inputs["Location"], path) if translates else (0.0, 0.0, 0.0)
        # A scale common to all axes does not change a direction.
        rotates_only = angles and scale and location and not any(location) and scale[0] > 0 and np.ptp(scale) < 1e-6
        if not rotates_only:
            return None
        rotation = np.array(Euler(angles).to_matrix())
        if mapping.vector_type == "TEXTURE":
            rotation = rotation.T
        found = resolve(mapping.inputs["Vector"], path)
        if found is None or not found[0].is_output:
            return None
    # The texture's own coordinates, those of Texture Coordinate and of Geometry, are the direction.
    if found is None or (found[0].node.bl_idname, found[0].identifier) in DIRECTIONS:
        return rotation
    return None
