"""What receivers gather from a light tree of surfels."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.indirect.surfels import Surfels
from pointsplat_addon.core.indirect.tree import build_tree
from pointsplat_addon.core.light.light_table import light_texture
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.passes.indirect.gather import GATHER_BLOCK, Gather, gather_program
from pointsplat_addon.render.passes.indirect.pages import NODE_WIDTH, node_rows, paged_texture, receiver_texture
from scripts.scenes import drawing


def gathered(
    surfels: Surfels,
    radiance: np.ndarray,
    position: np.ndarray,
    normal: np.ndarray,
    sky: float = 0.0,
    coarseness: float = 1.0,
    inside: float = 1.0,
    shining: bool = False,
    bodies: bool = False,
) -> np.ndarray:
    """(N,): irradiance over pi at places with normals (N, 3); radiance: of surfels, (n,), and of their other sides
    `inside` times as much. `shining`, `bodies`: by the variants for scenes in which something emits light, and that
    have fine triangles."""
    device = drawing.opengl().device
    tree = build_tree(surfels)
    sides = np.repeat(radiance[:, None], 3, axis=1)
    nodes = paged_texture(device, node_rows(tree, tree.radiance(surfels, sides, inside * sides)), NODE_WIDTH)
    rows = light_texture((), World(np.full(3, sky)), np.eye(4))
    lights = device.texture((rows.shape[1], rows.shape[0]), "RGBA32F", rows.reshape(-1))
    normal = np.broadcast_to(normal, position.shape)
    receivers = receiver_texture(device, position, normal, normal, np.ones(len(position)))
    record = GATHER_BLOCK.record(root=len(tree) - 1, coarseness=coarseness, sky=1.0, cube=tuple(tree.cube.tolist()))
    world, textures = (("PS_HAS_WORLD",), {"ps_lights": lights}) if sky else ((), {})
    program = gather_program(world, glossy=False, shining=shining, bodies=bodies)
    found = Gather(device, receivers, program, record, {"ps_nodes": nodes, **textures})
    result = device.read(found.diffuse).reshape(-1, 4)[: len(position), 0].astype(float)
    for item in (found, receivers, lights, nodes):
        item.release()
    return result
