"""All supported shader nodes by their bl_idname, and what reads trees of them."""

from __future__ import annotations

import bpy

from .....core.material.expression import constant
from .colors import COLORS
from .inputs import INPUTS
from .mathematics import MATHEMATICS
from .normals import NORMALS
from .procedural import PROCEDURAL
from .tree import FindPlacement, NodeConverter, Path, TreeReader, nowhere
from .world_space import WORLD_SPACE

NODES: dict[str, NodeConverter] = INPUTS | MATHEMATICS | COLORS | NORMALS | PROCEDURAL | WORLD_SPACE


def tree_reader(material_name: str, placement: FindPlacement = nowhere, pass_index: int = 0) -> TreeReader:
    """A reader for the nodes of one material, whose name appears in the warnings. The others: see TreeReader."""
    return TreeReader(material_name, NODES, placement, pass_index)


def constant_value(socket: bpy.types.NodeSocket, path: Path) -> tuple[float, ...] | None:
    """The value of an input; None if it varies or cannot be evaluated. path: the groups that lead to its tree."""
    tree = tree_reader("")
    value = constant(tree.read(socket, path))
    return None if value is None or tree.warnings else tuple(value.tolist())
