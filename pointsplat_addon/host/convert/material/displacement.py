"""Displacement of materials, as bumps: what Blender's method "Bump Only" makes of it."""

from __future__ import annotations

import bpy
import numpy as np

from ....core.material.expression import Expression
from ....core.material.nodes import input_nodes, math_nodes, normal_nodes
from .nodes.tree import NodeReader, TreeReader, resolve

ONE, ZERO = input_nodes.Constant((1.0,)), input_nodes.Constant((0.0,))


def read_displacement(tree: TreeReader, material: bpy.types.Material, output: bpy.types.Node) -> Expression | None:
    """The normal of the surface that the material's displacement raises; None if it raises nothing.

    As Cycles does, it goes to all inputs of normals to which nothing is linked.
    """
    found = resolve(output.inputs["Displacement"], ())
    if found is None or not found[0].is_output:
        return None
    socket, path = found
    if socket.node.bl_idname != "ShaderNodeDisplacement":
        tree.warn(socket.node, "cannot be evaluated; its displacement is left out")
        return None
    node = NodeReader(tree, socket.node, path)
    height, scale = node["Height"], node["Scale"]
    if not (height.varies or scale.varies):
        return None
    if material.displacement_method != "BUMP":
        node.warn("is drawn as a bump")
    raised = math_nodes.Math(math_nodes.Math(height, node["Midlevel"], ZERO, "SUBTRACT"), scale, ZERO, "MULTIPLY")
    distance, of_object = ONE, False
    if socket.node.space == "OBJECT":
        placement = tree.placement()
        of_object = placement is None
        if placement is not None:
            size = abs(np.linalg.det(np.array(placement.world_from_object)[:, :3])) ** (1 / 3)
            distance = input_nodes.Constant((float(size),))
    return normal_nodes.Bump(raised, ONE, distance, node["Normal"], of_object)
