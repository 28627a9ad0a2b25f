"""Reads Blender's node trees: follows links through groups and reroutes, and turns inputs into expressions."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from .....core.material.expression import Expression
from .....core.material.nodes import color_nodes, input_nodes
from .....core.numeric.record import value_record

Path = tuple[bpy.types.Node, ...]  # the group nodes that lead to a tree, outermost first
Outputs = dict[str, Expression]  # output identifier to its value
SCALAR_SOCKETS = ("VALUE", "INT", "BOOLEAN")


@value_record
class Placement:
    """The one place in which a material is shown, and the one object that shows it."""

    world_from_object: tuple[tuple[float, ...], ...]  # three rows of four
    color: tuple[float, ...]
    index: int
    random: float | None  # None: an instancer chose it


FindPlacement = Callable[[], Placement | None]


def nowhere() -> Placement | None:
    """The placement of what is not shown in one place."""
    return None


class UnsupportedNodeError(Exception):
    """A node, or a setting of it, that cannot be evaluated per sample; the text completes "node X ..."."""


@value_record
class HairConstants:
    """Constants of a Principled Hair BSDF, as in core.scene.materials.HairTable."""

    radial: float = 0.3
    coat: float = 0.0
    tilt: float = 0.0349066
    lobes: tuple[float, ...] = (1.0, 1.0, 1.0)


class TreeReader:
    """Reads the inputs of one material's nodes as expressions, and collects warnings about those it cannot read.

    converters: what turns a node into the values of its outputs, by the node's bl_idname. Each node is converted once.
    placement: returns where the material is shown; it is asked by nodes that read that.
    pass_index: the material's.
    """

    kind = "Material"  # of what has the tree, in warnings

    def __init__(
        self,
        material_name: str,
        converters: dict[str, NodeConverter],
        placement: FindPlacement = nowhere,
        pass_index: int = 0,
    ) -> None:
        self.material_name = material_name
        self.placement = placement
        self.pass_index = pass_index
        self.warnings: list[str] = []
        self.normal: Expression | None = (
            None  # what inputs of normals have while nothing is linked; None: the surface's
        )
        self.hair: HairConstants | None = None  # set by a shader for strands
        self.glass = False  # set by shaders that transmit light
        self._converters = converters
        self._warned: set[int] = set()
        self._known: dict[tuple, Outputs | None] = {}

    def warn(self, node: bpy.types.Node, text: str) -> None:
        """Add a warning that names the material and the node; only the first warning of each node is kept."""
        pointer = node.as_pointer()
        if pointer not in self._warned:
            self._warned.add(pointer)
            self.warnings.append(f'{self.kind} "{self.material_name}": node "{node.label or node.name}" {text}')

    def read(self, socket: bpy.types.NodeSocket, path: Path) -> Expression:
        """The value of an input: that of the linked output, converted to the input's type, else its own value."""
        found = resolve(socket, path)
        if found is None:
            unlinked = self.normal if socket.identifier == "Normal" else None
            return default_value(socket) if unlinked is None else unlinked
        output, path = found
        if output.is_output:
            value = self._output(output, path)
            return default_value(socket) if value is None else convert_socket_type(value, output.type, socket.type)
        # A group's or a muted node's input that is not linked
        return convert_socket_type(default_value(output), output.type, socket.type)

    def _output(self, output: bpy.types.NodeSocket, path: Path) -> Expression | None:
        """The value of a node's output; None, and a warning, if it cannot be evaluated."""
        node = output.node
        key = (*(group.as_pointer() for group in path), node.as_pointer())
        if key not in self._known:
            self._known[key] = self._outputs(node, path)
        outputs = self._known[key]
        if outputs is None:
            return None
        value = outputs.get(output.identifier)
        if value is None:
            self.warn(node, f'cannot be evaluated ("{output.name}"); inputs that use it keep their own values')
        return value

    def _outputs(self, node: bpy.types.Node, path: Path) -> Outputs | None:
        """The values of all outputs of a node; None, and a warning, if it cannot be evaluated."""
        convert = self._converters.get(node.bl_idname)
        try:
            if convert is None:
                raise UnsupportedNodeError("cannot be evaluated")
            return convert(NodeReader(self, node, path))
        except UnsupportedNodeError as reason:
            self.warn(node, f"{reason}; inputs that use it keep their own values")
            return None


class NodeReader:
    """Reads one node of a tree: `reader[identifier]` is the value of the input with that identifier."""

    def __init__(self, tree: TreeReader, node: bpy.types.Node, path: Path) -> None:
        self.tree, self.node, self.path = tree, node, path

    def __getitem__(self, identifier: str) -> Expression:
        return self.tree.read(self.socket(identifier), self.path)

    def socket(self, identifier: str) -> bpy.types.NodeSocket:
        """The input socket with this identifier. Raises StopIteration if the node has none."""
        return next(s for s in self.node.inputs if s.identifier == identifier)

    def linked(self, identifier: str) -> bool:
        """Whether another node's output feeds the input."""
        found = resolve(self.socket(identifier), self.path)
        return found is not None and found[0].is_output

    def used(self, identifier: str) -> bool:
        """Whether the output with this identifier has a link."""
        return any(s.is_linked for s in self.node.outputs if s.identifier == identifier)

    def warn(self, text: str) -> None:
        """Add a warning about this node; the text completes "node X ..."."""
        self.tree.warn(self.node, text)


NodeConverter = Callable[[NodeReader], Outputs]


def resolve(socket: bpy.types.NodeSocket, path: Path) -> tuple[bpy.types.NodeSocket, Path] | None:
    """The output that feeds an input, with the path to its tree, looking through reroutes, muted nodes and groups.

    Returns None if nothing is linked. Where the links end at an unlinked input of a group node or of a muted node,
    that input is returned.
    """
    link = next((x for x in socket.links if x.is_valid and not x.is_muted), None)
    if link is None:
        return None
    output, node = link.from_socket, link.from_node
    if node.bl_idname == "NodeReroute":
        return resolve(node.inputs[0], path)
    if node.mute:
        inner = next((x.from_socket for x in node.internal_links if x.to_socket == output), None)
        return None if inner is None else resolve(inner, path) or (inner, path)
    if node.bl_idname == "NodeGroupInput" and path:
        outer = next((s for s in path[-1].inputs if s.identifier == output.identifier), None)
        return None if outer is None else resolve(outer, path[:-1]) or (outer, path[:-1])
    if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
        ends = [n for n in node.node_tree.nodes if n.bl_idname == "NodeGroupOutput" and n.is_active_output]
        inner = next((s for n in ends for s in n.inputs if s.identifier == output.identifier), None)
        if inner is not None:
            return resolve(inner, (*path, node)) or (inner, (*path, node))
    return output, path


def default_value(socket: bpy.types.NodeSocket) -> Expression:
    """The value that an input has while nothing is linked; for an empty normal input, the surface's normal."""
    if socket.identifier == "Normal":
        return input_nodes.Coordinates("normal")
    value = getattr(socket, "default_value", 0.0)
    if socket.type in SCALAR_SOCKETS:
        return input_nodes.Constant((float(value),))
    if socket.type in ("VECTOR", "RGBA"):
        return input_nodes.Constant(tuple(np.array(value, float)[:3].tolist()))
    return input_nodes.Constant((0.0, 0.0, 0.0))


def constant_input(node: NodeReader, identifier: str) -> Expression:
    """The value of an input that must not vary over the surface: with a varying link, a warning and the own value."""
    if not node[identifier].varies:
        return node[identifier]
    node.warn(f'has a varying "{identifier}"; its own value is used')
    return default_value(node.socket(identifier))


def convert_socket_type(value: Expression, source: str, target: str) -> Expression:
    """`value` with Blender's implicit conversion from one type of socket to another."""
    if target in SCALAR_SOCKETS and source not in SCALAR_SOCKETS:
        return color_nodes.Gray(value, mean=source == "VECTOR")
    if target not in SCALAR_SOCKETS and source in SCALAR_SOCKETS:
        return color_nodes.Color(value)
    return value
