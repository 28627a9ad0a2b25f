"""Materials and their nodes, made as a person would in Blender."""

import bpy


def new_material(name="Material"):
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    material.node_tree.nodes.clear()
    return material


def node(tree, kind, inputs=None, **properties):
    """A new node; inputs are by identifier, either values or the outputs to link."""
    made = tree.nodes.new(kind)
    for name, value in properties.items():
        setattr(made, name, value)
    for identifier, value in (inputs or {}).items():
        socket = next(s for s in made.inputs if s.identifier == identifier)
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return made
