"""Build a scene of 200 x 200 towers of 350,000 triangles each, objects that share one mesh.

python -m scripts.demos.towers --output out/towers.blend [--side 200]
"""

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from scripts.common import tower
from scripts.common.process import run


def tower_object():
    """The tower as an object that is drawn by its instances alone."""
    position, triangles, kind = tower.tower()
    mesh = bpy.data.meshes.new("Tower")
    mesh.from_pydata(position.tolist(), [], triangles.tolist())
    for name, color in zip(("Wall", "Glass", "Lit", "Roof"), tower.COLORS, strict=True):
        material = bpy.data.materials.new(name)
        if not material.node_tree:
            material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*color, 1.0)
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", kind.astype(np.int32))
    return bpy.data.objects.new("Tower", mesh)


def build(side):
    """The field, a sun, a sky, and a camera that sees all of it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, source = bpy.context.scene, tower_object()
    for i, matrix in enumerate(tower.grid(side)):
        item = source if i == 0 else bpy.data.objects.new(f"Tower {i}", source.data)
        item.matrix_world = Matrix(matrix.tolist())
        scene.collection.objects.link(item)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy = 3.0
    sun.rotation_euler = (0.7, 0.4, 0.3)
    world = scene.world = bpy.data.worlds.new("Sky")
    if not world.node_tree:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.25, 0.3, 0.4, 1.0)
    extent = side * tower.SPACING
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.43 * extent, -0.79 * extent, 0.6 * extent)
    camera.rotation_euler = (np.radians(54), 0.0, np.radians(28.6))
    camera.data.clip_end = 10 * extent
    for item in (sun, camera):
        scene.collection.objects.link(item)
    scene.render.resolution_x, scene.render.resolution_y = 500, 400


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--side", type=int, default=200)
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else None)
    build(options.side)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(options.output.resolve()))


if __name__ == "__main__":
    run(main)
