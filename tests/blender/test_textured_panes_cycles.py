"""Translucent meshes whose alpha and colours are functions and images, and their shadows, beside Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture

SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]


def function(tree, value, operation: str, by: float = 0.0):
    return node(tree, "ShaderNodeMath", {"Value": value, "Value_001": by}, operation=operation).outputs[0]


def wave(tree, axis: int, number: float):
    """Between 0 and 1 along an axis of the object."""
    coordinates = node(tree, "ShaderNodeTexCoord").outputs["Object"]
    at = node(tree, "ShaderNodeSeparateXYZ", {"Vector": coordinates}).outputs[axis]
    sine = function(tree, function(tree, at, "MULTIPLY", number), "SINE")
    return function(tree, function(tree, sine, "MULTIPLY", 0.5), "ADD", 0.5)


def painted(tree):
    """Paint that thins out in stripes."""
    clear = node(tree, "ShaderNodeBsdfTransparent")
    paint = node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.3, 0.1, 1)})
    shaders = {"Shader": clear.outputs[0], "Shader_001": paint.outputs[0]}
    return node(tree, "ShaderNodeMixShader", {"Fac": wave(tree, 0, 7.0), **shaders}).outputs[0]


def stained(tree):
    """Glass whose colour changes."""
    colors = {"Red": wave(tree, 0, 3.0), "Green": wave(tree, 1, 4.0), "Blue": 0.4}
    color = node(tree, "ShaderNodeCombineColor", colors).outputs[0]
    return node(tree, "ShaderNodeBsdfTransparent", {"Color": color}).outputs[0]


def pictured(tree):
    """An image in colour and alpha, mapped by UV."""
    made = bpy.data.images.new("image", 16, 16, alpha=True)
    texels = np.random.default_rng(5).uniform(0.1, 0.9, (16, 16, 4)).astype(np.float32)
    made.pixels.foreach_set(texels.ravel())
    made.update()
    made.pack()
    image = node(tree, "ShaderNodeTexImage", image=made)
    looks = {"Base Color": image.outputs["Color"], "Alpha": image.outputs["Alpha"], "Roughness": 0.7}
    return node(tree, "ShaderNodeBsdfPrincipled", looks).outputs[0]


def pane(shader, location, rotation=(0.0, 0.0, 0.0)):
    made = mesh_object(shader.__name__, SQUARE, [(0, 1, 2, 3)])
    made.data.uv_layers.new().data.foreach_set("uv", np.ravel([(0, 0), (1, 0), (1, 1), (0, 1)]))
    material = new_material(shader.__name__)
    tree = material.node_tree
    node(tree, "ShaderNodeOutputMaterial", {"Surface": shader(tree)})
    made.data.materials.append(material)
    made.location, made.rotation_euler = location, rotation


@pytest.fixture
def scene(empty_file):
    """A floor under a sun without size, and a camera."""
    scene = bpy.context.scene
    floor = mesh_object("floor", [(8 * x, 8 * y, z) for x, y, z in SQUARE], [(0, 1, 2, 3)])
    floor.data.materials.append(new_material("floor"))
    tree = floor.data.materials[0].node_tree
    gray = node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0.6, 0.6, 0.6, 1)})
    node(tree, "ShaderNodeOutputMaterial", {"Surface": gray.outputs[0]})
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 3, 0
    shining = bpy.data.objects.new("sun", sun)
    shining.rotation_euler = 0.4, 0.3, 0
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.camera.location, scene.camera.rotation_euler = (0.5, -5.5, 4.5), (0.9, 0, 0.09)
    for made in (shining, scene.camera):
        scene.collection.objects.link(made)
    draw_beside_cycles(scene, (120, 90), 256)
    return scene


def both(scene, folder):
    found = []
    for scene.render.engine in ("CYCLES", "POINTSPLAT"):
        found.append(picture(scene, folder)[..., :3].astype(float))
    return found


# Measured 0.0024, 0.0022 and 0.0035; the noise of Cycles is in them.
@pytest.mark.parametrize(("shader", "rmse"), [(painted, 0.003), (stained, 0.003), (pictured, 0.0045)])
def test_a_pane_and_its_shadow(scene, tmp_path, shader, rmse):
    pane(shader, (0, 0, 1.2), (0.1, 0.2, 0.3))
    truth, found = both(scene, tmp_path)
    assert abs(found.mean() / truth.mean() - 1) < 0.003
    assert np.sqrt(np.square(found - truth).mean()) < rmse


def test_panes_behind_each_other(scene, tmp_path):
    for height, shader in enumerate((painted, stained, pictured)):
        pane(shader, (0.1 * height, 0, 0.7 + 0.3 * height), (0.1, 0.05 * height, 0.2))
    truth, found = both(scene, tmp_path)
    assert abs(found.mean() / truth.mean() - 1) < 0.003
    assert np.sqrt(np.square(found - truth).mean()) < 0.0045  # measured 0.0033
