"""Blender's world: one colour, or an environment texture."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Euler

from ...core.material.color_models import linear_from_srgb
from ...core.material.image import Image
from ...core.scene.world import World
from .lights import constant
from .material.images import convert_image
from .material.nodes import Path, resolve

DIRECTIONS = {("ShaderNodeTexCoord", "Generated"), ("ShaderNodeNewGeometry", "Position")}


def convert_world(depsgraph: bpy.types.Depsgraph) -> tuple[World, list[str]]:
    """The world of an evaluated scene, a view layer's override included, and warnings."""
    override = getattr(depsgraph.view_layer_eval, "world_override", None)
    return from_world(override or depsgraph.scene_eval.world)


def from_world(world: bpy.types.World | None) -> tuple[World, list[str]]:
    """An evaluated world (None: black) and warnings. What cannot be read falls back to its viewport colour."""
    if world is None:
        return World(), []
    plain = World(color=np.array(world.color, float))
    if world.node_tree is None or (bpy.app.version < (5, 0) and not world.use_nodes):
        return plain, []
    output = world.node_tree.get_output_node("ALL")
    found = resolve(output.inputs["Surface"], ()) if output else None
    if found is None:
        return World(), []
    node, path = found[0].node, found[1]
    if node.bl_idname not in {"ShaderNodeBackground", "ShaderNodeEmission"}:
        return plain, [_fallback(world, node)]
    strength, color = (constant(node.inputs[key], path) for key in ("Strength", "Color"))
    if strength is None:
        return plain, [_fallback(world, _feed(node.inputs["Strength"], path)[0])]
    if color is not None:
        return World(color=np.array(color) * strength[0]), []

    texture, path = _feed(node.inputs["Color"], path)
    if texture.bl_idname != "ShaderNodeTexEnvironment" or texture.projection != "EQUIRECTANGULAR":
        return plain, [_fallback(world, texture)]
    rotation, blocker = _rotation(texture, path)
    if rotation is None:
        return plain, [_fallback(world, blocker)]
    image, problem = convert_image(texture.image)
    warnings = [f'World "{world.name}": node "{texture.label or texture.name}" {problem}'] if problem else []
    return World(image=_linear(image) * np.float32(strength[0]), world_rotation=rotation), warnings


def _linear(image: Image) -> np.ndarray:
    """(H, W, 3) float32 scene-linear."""
    texels = image.texels[..., :3]
    if texels.dtype == np.uint8:
        codes = np.arange(256, dtype=np.float32) / 255
        return (linear_from_srgb(codes) if image.srgb else codes)[texels]
    return linear_from_srgb(texels) if image.srgb else texels


def _feed(socket: bpy.types.NodeSocket, path: Path) -> tuple[bpy.types.Node, Path]:
    """The node that feeds an input which is not constant."""
    found = resolve(socket, path)
    assert found is not None
    return found[0].node, found[1]


def _rotation(texture: bpy.types.Node, path: Path) -> tuple[np.ndarray | None, bpy.types.Node]:
    """image_from_world (3, 3) of an environment texture, or None and the node that is in the way."""
    found = resolve(texture.inputs["Vector"], path)
    rotation = np.eye(3)
    if found is not None and found[0].node.bl_idname == "ShaderNodeMapping":
        mapping, path = found[0].node, found[1]
        angles, scale = (constant(mapping.inputs[key], path) for key in ("Rotation", "Scale"))
        moves = mapping.vector_type in {"POINT", "TEXTURE"}
        location = constant(mapping.inputs["Location"], path) if moves else (0.0, 0.0, 0.0)
        # A scale common to all axes does not change a direction.
        simple = angles and scale and location and not any(location) and scale[0] > 0 and np.ptp(scale) < 1e-6
        if not simple:
            return None, mapping
        rotation = np.array(Euler(angles).to_matrix())
        if mapping.vector_type == "TEXTURE":
            rotation = rotation.T
        found = resolve(mapping.inputs["Vector"], path)
        if found is None or not found[0].is_output:
            return None, mapping
    # The texture's own coordinates, those of Texture Coordinate and of Geometry, are the direction.
    if found is None or (found[0].node.bl_idname, found[0].identifier) in DIRECTIONS:
        return rotation, texture
    return None, found[0].node


def _fallback(world: bpy.types.World, node: bpy.types.Node) -> str:
    label = node.label or node.name
    return f'World "{world.name}": node "{label}" is not supported; the world\'s viewport colour is used'
