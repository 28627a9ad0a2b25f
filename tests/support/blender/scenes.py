"""Objects, materials and renders of Blender's, made as a person would make them there."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from pointsplat_addon.host.sync import Synchronizer


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


def glowing(scene, count):
    """`count` materials, each of one red, green or blue, so that neighbours can be told apart."""
    materials = []
    for i in range(count):
        material = bpy.data.materials.new(f"glow {i}")
        if not material.node_tree:
            material.use_nodes = True
        tree = material.node_tree
        node = tree.nodes.new("ShaderNodeEmission")
        node.inputs["Color"].default_value = (*np.eye(3)[i], 1)
        tree.links.new(node.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
        materials.append(material)
    return materials


def draw_beside_cycles(scene, size: tuple[int, int], samples: int) -> None:
    """Sets a scene up for `picture` by either engine: direct light, float32, and of Cycles so many samples, unfiltered
    by denoising."""
    render, cycles = scene.render, scene.cycles
    render.resolution_x, render.resolution_y = size
    if bpy.app.version >= (5, 0, 0):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", samples, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False


def picture(scene, folder: Path) -> np.ndarray:
    scene.render.filepath = str(folder / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], -1)


def alpha(scene, folder: Path, engine: str) -> np.ndarray:
    """(H, W) float32."""
    scene.render.engine = engine
    scene.render.filepath = str(folder / f"{engine}.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[..., 3]


def sync(synchronizer=None, **options) -> Any:

    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return (synchronizer or Synchronizer()).scene(depsgraph, **options)


def mesh_object(name, vertices, faces, edges=()):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, edges, faces)
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(ob)
    return ob


def pointcloud(name, positions, **attributes):
    """A PointCloud object. Attributes: name to (type, key, array)."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions, [], [])
    for attribute, (kind, key, values) in attributes.items():
        mesh.attributes.new(attribute, kind, "POINT").data.foreach_set(key, np.asarray(values, np.float32).ravel())
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(ob)
    with bpy.context.temp_override(active_object=ob, object=ob, selected_objects=[ob], selected_editable_objects=[ob]):
        bpy.context.view_layer.objects.active = ob
        ob.select_set(True)
        bpy.ops.object.convert(target="POINTCLOUD")
    return bpy.context.view_layer.objects.active
