"""The shaders of a world, and of lights, as the radiance that they send."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ....core.light.world_picture import picture_of, radiance_at
from ....core.material.expression import Expression, constant
from ....core.material.nodes import color_nodes, math_nodes
from ....core.scene.lights import Light
from ....core.scene.world import World
from ....core.sky.sky import Disc
from ....render.cache.cache import Cache
from ....render.cache.keys import Key, Kind
from ..material.nodes.tree import Path, TreeReader, convert_socket_type, resolve
from ..material.surface import BLACK, ONE, ZERO, is_constant, scale_color
from .world_nodes import CAMERA, DIFFUSE, GLOSSY, WorldReader

CACHE_BYTES = 1 << 28  # of pictures of worlds, so that the same graph is the same picture
EMITTERS = {"ShaderNodeBackground", "ShaderNodeEmission"}

_pictures = Cache(CACHE_BYTES)


def clear() -> None:
    """Forget all pictures."""
    _pictures.clear()


def radiance(tree: TreeReader, socket: bpy.types.NodeSocket, path: Path = ()) -> Expression:
    """The radiance (N | 1, 3) of what feeds a shader's input: black if nothing does.

    Sums and mixes of shaders are those of their radiances. Shaders that do not emit are black, with a warning.
    """
    found = resolve(socket, path)
    if found is None or not found[0].is_output:
        return BLACK
    output, path = found
    node = output.node
    if output.type != "SHADER":  # a colour where a shader belongs is emitted
        return convert_socket_type(tree.read(socket, path), output.type, "RGBA")
    if node.bl_idname in EMITTERS:
        color, strength = (tree.read(node.inputs[name], path) for name in ("Color", "Strength"))
        return color if is_constant(strength, 1) else scale_color(color, strength)
    if node.bl_idname == "ShaderNodeAddShader":
        first, second = (radiance(tree, s, path) for s in node.inputs[:2])
        return math_nodes.VectorMath(first, second, BLACK, ZERO, "ADD")
    if node.bl_idname == "ShaderNodeMixShader":
        factor = math_nodes.Clamp(tree.read(node.inputs[0], path), ZERO, ONE)
        for number, other in ((0, 1), (1, 2)):  # no more of the tree is read than is seen
            if is_constant(factor, number):
                return radiance(tree, node.inputs[other], path)
        first, second = (radiance(tree, s, path) for s in node.inputs[1:3])
        return color_nodes.Mix(factor, first, second)
    tree.warn(node, "emits nothing here")
    return BLACK


def graph_world(name: str, socket: bpy.types.NodeSocket) -> tuple[World, list[Light], list[str]]:
    """The world of a graph of nodes, from the input of its output node, the suns of its skies, and warnings."""
    warnings: list[str] = []
    seen: dict[str, Expression] = {}
    suns: list[Light] = []
    for ray in (DIFFUSE, GLOSSY, CAMERA):
        tree = WorldReader(name, ray, suns=ray == CAMERA)
        seen[ray] = radiance(tree, socket)
        warnings += tree.warnings
        if ray == DIFFUSE and tree.discs:
            shining = radiance(WorldReader(name, ray, suns=True), socket)
            suns = [_sun(disc, seen[ray], shining) for disc in dict.fromkeys(tree.discs)]
    world = _world_of(seen[DIFFUSE])
    if seen[GLOSSY].digest != seen[DIFFUSE].digest:
        world = replace(world, image=_picture(world), mirrored=_picture(_world_of(seen[GLOSSY])))
    if seen[CAMERA].digest != seen[DIFFUSE].digest or world.mirrored is not None:
        world = replace(world, seen=_world_of(seen[CAMERA]))
    return world, [sun for sun in suns if np.any(sun.color > 0)], list(dict.fromkeys(warnings))


def _sun(disc: Disc, sky: Expression, shining: Expression) -> Light:
    """The sun's disc as a light: what it adds to a world, `sky`, that is `shining` with it."""
    directions, solid_angle = disc.directions()
    added = radiance_at(shining, directions).astype(float) - radiance_at(sky, directions)
    slope = directions @ disc.sky.sun
    color = np.maximum((added * slope[:, None]).sum(axis=0) * solid_angle, 0)
    return Light("SUN", color, np.zeros(3), -np.array(disc.sky.sun), min(disc.angle, np.pi / 2), name="Sky")


def _picture(world: World) -> np.ndarray:
    """The picture (H, W, 3) float32 of a world, of one colour, too."""
    return np.full((1, 2, 3), world.color, np.float32) if world.image is None else world.image


def _world_of(value: Expression) -> World:
    """The world of a radiance: of one colour if it does not vary, else a picture."""
    color = constant(value)
    if color is not None:
        return World(color=np.nan_to_num(np.broadcast_to(color[:3], (3,)).astype(float), posinf=0.0, neginf=0.0))
    return World(image=_pictures.lookup(Key(Kind.WORLD, value.digest), lambda: picture_of(value)))
