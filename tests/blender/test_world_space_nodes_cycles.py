"""The Geometry, Object Info and Point Info nodes: the values of Cycles where one object shows a material.

Several objects: test_object_values_cycles.py.
"""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.host.sync import Synchronizer
from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture, pointcloud, sync

OUTPUTS = [
    ("NewGeometry", "Position"),
    ("NewGeometry", "Normal"),
    *(("ObjectInfo", name) for name in ("Location", "Color", "Alpha", "Object Index", "Material Index", "Random")),
]


def material(kind: str, output: str):
    """Emits half of an output plus 1/2, so that nothing is negative."""
    made = new_material()
    tree = made.node_tree
    half = (0.5, 0.5, 0.5)
    inputs = {"Vector": node(tree, f"ShaderNode{kind}").outputs[output], "Vector_001": half, "Vector_002": half}
    raised = node(tree, "ShaderNodeVectorMath", inputs, operation="MULTIPLY_ADD").outputs[0]
    shown = node(tree, "ShaderNodeEmission", {"Color": raised}).outputs[0]
    node(tree, "ShaderNodeOutputMaterial", {"Surface": shown})
    return made


def square(name="Ünïcode square"):
    made = mesh_object(name, [(0, 0, 0), (4, 0, 0), (4, 2, 0), (0, 2, 0)], [(0, 1, 2, 3)])
    made.location, made.rotation_euler, made.scale = (0.3, 0.2, 0.1), (0.1, 0.2, 0.3), (1, 1.2, 0.7)
    made.color, made.pass_index = (0.2, 0.4, 0.6, 0.8), 3
    return made


@pytest.fixture
def scene(empty_file):
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = 2, 1.5, 5
    scene.collection.objects.link(scene.camera)
    draw_beside_cycles(scene, (8, 4), 1)
    scene.render.filter_size = scene.cycles.filter_width = 0.01
    return scene


@pytest.mark.parametrize(("kind", "output"), OUTPUTS)
def test_one_object_has_the_values_of_cycles(scene, tmp_path, kind, output):
    shown = square()
    shown.data.materials.append(material(kind, output))
    shown.data.materials[0].pass_index = 2
    drawn = []
    for scene.render.engine in ("CYCLES", "POINTSPLAT"):
        drawn.append(picture(scene, tmp_path)[..., :3])
    # Measured: 0.0005, of half floats
    assert np.abs(drawn[1] - drawn[0]).max() < 0.001


@pytest.mark.parametrize("output", ["Position", "Radius", "Random"])
def test_points_have_the_values_of_cycles(scene, tmp_path, output):
    """A ball within each pixel, of a cloud that is scaled alike along all axes."""
    y, x = np.divmod(np.arange(32), 8)
    place = np.stack([1.125 + 0.25 * x, 1.125 + 0.25 * y, np.zeros(32)], axis=1)
    radius = np.random.default_rng(2).uniform(0.08, 0.12, 32)
    shown = pointcloud("points", place / 1.25, radius=("FLOAT", "value", radius / 1.25))
    shown.scale = (1.25,) * 3
    shown.data.materials.append(material("PointInfo", output))
    drawn = []
    for scene.render.engine in ("CYCLES", "POINTSPLAT"):
        drawn.append(picture(scene, tmp_path)[..., :3])
    assert np.ptp(drawn[0]) > 0.015
    assert np.abs(drawn[1] - drawn[0]).max() < 0.001


def test_an_object_that_moves_has_another_position(scene):
    shown = square()
    shown.data.materials.append(material("NewGeometry", "Position"))
    synchronizer, emissions = Synchronizer(), []
    for x in (0.0, 0.0, 1.0):
        shown.location.x = x
        table = sync(synchronizer).materials
        emissions.append(next(graph for graph in table.graphs if graph is not None).digest)
    assert emissions[0] == emissions[1]
    assert emissions[1] != emissions[2]
