"""Colours, roughness and normals that no picture over a UV map shows: within the triangles of polygons as in Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture

CUBE = [(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def place(tree, kind: str, axis: int):
    coordinates = node(tree, "ShaderNodeTexCoord").outputs[kind]
    return node(tree, "ShaderNodeSeparateXYZ", {"Vector": coordinates}).outputs[axis]


def function(tree, value, operation: str, by: float = 0.0):
    return node(tree, "ShaderNodeMath", {"Value": value, "Value_001": by}, operation=operation).outputs[0]


def stripes(tree):
    """Two colours that jump."""
    wave = function(tree, function(tree, place(tree, "Object", 0), "MULTIPLY", 9.0), "SINE")
    ramp = node(tree, "ShaderNodeValToRGB", {"Fac": wave})
    ramp.color_ramp.interpolation = "CONSTANT"
    first, second = ramp.color_ramp.elements
    first.color, second.color, second.position = (0.8, 0.1, 0.1, 1), (0.1, 0.1, 0.8, 1), 0.2
    return {"Base Color": ramp.outputs["Color"]}


def rough(tree):
    wave = function(tree, place(tree, "Generated", 1), "PINGPONG", 0.3)
    return {"Roughness": wave, "Metallic": 0.8, "Base Color": (0.7, 0.6, 0.5, 1)}


def image(tree):
    """An image that is mapped by places in the object."""
    made = bpy.data.images.new("image", 8, 8)
    texels = np.random.default_rng(4).random((8, 8, 4))
    texels[..., 3] = 1
    made.pixels.foreach_set(texels.astype(np.float32).ravel())
    made.update()
    made.pack()
    turned = {"Vector": node(tree, "ShaderNodeTexCoord").outputs["Object"], "Rotation": (0.3, 0.2, 0.5)}
    mapped = node(tree, "ShaderNodeMapping", turned).outputs[0]
    return {"Base Color": node(tree, "ShaderNodeTexImage", {"Vector": mapped}, image=made).outputs["Color"]}


def bumps(tree):
    wave = function(tree, function(tree, place(tree, "Object", 0), "MULTIPLY", 25.0), "SINE")
    return {"Normal": node(tree, "ShaderNodeBump", {"Height": wave, "Distance": 0.03}).outputs[0]}


def material(inputs):
    made = new_material(inputs.__name__)
    tree = made.node_tree
    shader = node(tree, "ShaderNodeBsdfPrincipled", inputs(tree))
    node(tree, "ShaderNodeOutputMaterial", {"Surface": shader.outputs[0]})
    return made


@pytest.fixture
def scene(empty_file):
    """A floor of two triangles, cubes of several materials, of which one is mirrored and one an instance, and a mesh of
    so many triangles that it is drawn in chunks."""
    scene = bpy.context.scene
    made = {inputs.__name__: material(inputs) for inputs in (stripes, rough, image, bumps)}
    floor = mesh_object("floor", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    floor.data.materials.append(made["stripes"])
    several = mesh_object("several", CUBE, FACES)
    for name in ("rough", "image"):
        several.data.materials.append(made[name])
    several.data.polygons.foreach_set("material_index", [0, 1, 0, 1, 0, 1])
    several.location, several.rotation_euler, several.scale = (-1.2, 0, 0.8), (0.2, 0.3, 0.5), (1.2, 1.2, 1.2)
    bumpy = mesh_object("bumpy", CUBE, FACES)
    bumpy.data.materials.append(made["bumps"])
    bumpy.location, bumpy.scale = (2.2, -1.2, 0.3), (-0.6, 0.6, 0.6)
    again = bpy.data.objects.new("again", bumpy.data)
    again.location, again.rotation_euler = (0, -1.5, 0.5), (0, 0, 0.6)
    scene.collection.objects.link(again)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(1, 0.3, 0.9), segments=128, ring_count=96)
    bpy.context.object.data.materials.append(made["image"])
    bpy.context.object.data.shade_smooth()
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 3, 0
    shining = bpy.data.objects.new("sun", sun)
    shining.rotation_euler = 0.6, 0.4, 0
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.camera.location, scene.camera.rotation_euler = (3, -6, 3), (1.19, 0, 0.464)
    for item in (scene.camera, shining):
        scene.collection.objects.link(item)
    draw_beside_cycles(scene, (192, 144), 128)
    return scene


def drawn(scene, engine: str, folder, seed: int = 0) -> np.ndarray:
    scene.render.engine, scene.cycles.seed = engine, seed
    return picture(scene, folder)[..., :3].astype(np.float64)


def test_graphs_change_within_triangles_as_in_cycles(scene, tmp_path):
    first, second = (drawn(scene, "CYCLES", tmp_path, seed) for seed in (1, 2))
    found = drawn(scene, "POINTSPLAT", tmp_path)
    squared = ((found - first) * (found - second)).mean()
    # Measured: 0.00925 and 1.0066, most of it along the edges of stripes, which are one pixel softer, and in bumps.
    # By values at corners: 0.107 and 1.03.
    assert np.sqrt(squared) < 0.0095
    assert abs(found.mean() / first.mean() - 1) < 0.0075
