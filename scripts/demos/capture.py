"""Build a scene of captured Gaussian splats in which a mesh stands, which shadows them and is lit as they are.

python -m scripts.demos.capture SPLATS MESH.obj --output out/capture.blend [--texture PICTURE] [--at X Y]
    [--heading DEGREES] [--height METRES]

--at: where the mesh stands, on the lowest splats there. Render it by
`python scripts/render.py out/capture.blend --output out/capture.png`.
"""

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

import pointsplat_addon
from scripts.common.process import run

NEAR = 0.08  # around the feet, the splats that are the ground
EYE, AIM = Vector((0.6, -2.2, 1.0)), Vector((0.05, -0.05, 0.3))


def captured_object(path: Path) -> tuple[bpy.types.Object, np.ndarray]:
    """The capture, which light that is kept away darkens, and its splats' positions (N, 3) in world space."""
    bpy.ops.pointsplat.import_splats(filepath=str(path))
    ob = bpy.context.object
    ob.pointsplat.lighting = "SHADOWED"
    found = np.empty(3 * len(ob.data.points), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", found)
    bpy.context.view_layer.update()
    matrix = np.array(ob.matrix_world)
    return ob, found.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def standing_mesh(path: Path, texture: Path | None, height: float, heading: float, at: Vector) -> None:
    """The mesh, with its lowest point at a place."""
    bpy.ops.wm.obj_import(filepath=str(path))
    ob = bpy.context.object
    bpy.ops.object.shade_smooth()
    bpy.context.view_layer.update()
    corners = np.array([ob.matrix_world @ Vector(corner) for corner in ob.bound_box])
    scale = height / float(np.ptp(corners[:, 2]))
    ob.scale = (scale,) * 3
    ob.rotation_euler.z += np.radians(heading)
    bpy.context.view_layer.update()
    lowest = min((ob.matrix_world @ Vector(corner)).z for corner in ob.bound_box)
    ob.location = at - Vector((0, 0, lowest))
    material = bpy.data.materials.new("Mesh")
    if not material.node_tree:
        material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = 0.5
    if texture is not None:
        image = material.node_tree.nodes.new("ShaderNodeTexImage")
        image.image = bpy.data.images.load(str(texture))
        material.node_tree.links.new(image.outputs["Color"], shader.inputs["Base Color"])
    ob.data.materials.clear()
    ob.data.materials.append(material)


def light(scene: bpy.types.Scene) -> None:
    """A lamp from the left, and a dim world."""
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.data.shape, lamp.data.size, lamp.data.energy, lamp.data.color = "DISK", 0.1, 40.0, (0.9, 0.97, 1.0)
    lamp.location = (-1.3, -0.5, 1.0)
    lamp.rotation_euler = (Vector((0.3, -0.4, 0.1)) - lamp.location).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(lamp)
    world = scene.world = bpy.data.worlds.new("World")
    if not world.node_tree:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.02, 0.03, 0.04, 1.0)


def build(arguments: argparse.Namespace) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    scene = bpy.context.scene
    _, points = captured_object(arguments.splats)
    around = np.linalg.norm(points[:, :2] - arguments.at, axis=1) < NEAR
    ground = float(np.median(points[around, 2])) if around.any() else 0.0
    at = Vector((*arguments.at, ground))
    standing_mesh(arguments.mesh, arguments.texture, arguments.height, arguments.heading, at)
    light(scene)
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.lens = EYE, 40.0
    camera.rotation_euler = (AIM - EYE).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.view_settings.view_transform = "Standard"
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = 800, 450


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("splats", type=Path)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--texture", type=Path)
    parser.add_argument("--at", type=float, nargs=2, default=(0.3, -0.35))
    parser.add_argument("--heading", type=float, default=0.0)
    parser.add_argument("--height", type=float, default=0.35)
    arguments = parser.parse_args(sys.argv[1:])
    build(arguments)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(arguments.output.resolve()))


if __name__ == "__main__":
    run(main)
