"""The Principled BSDF's coat beside Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture

SIZE = 48, 36
HALF = 4.0  # of the plane's side
TINT = (0.9, 0.5, 0.2, 1)
COATS = {
    "smooth": {"Coat Roughness": 0.15},
    "rough, in part": {"Coat Weight": 0.6, "Coat Roughness": 0.4},
    "dense": {"Coat Roughness": 0.2, "Coat IOR": 2.0},
    "tinted": {"Coat Roughness": 0.2, "Coat Tint": TINT},
    "tinted, in part, on metal": {"Coat Weight": 0.5, "Coat Roughness": 0.25, "Coat Tint": TINT, "Metallic": 1.0},
}


def linked(data):
    made = bpy.data.objects.new(data.name, data)
    bpy.context.collection.objects.link(made)
    return made


def drawn(empty_file, tmp_path, lamp: bool, **inputs) -> tuple[np.ndarray, np.ndarray]:
    """A coated plane below an area lamp, seen aslant: (H, W, 4) of Cycles and of PointSplat."""
    given = {"Base Color": (0.6, 0.3, 0.2, 1), "Roughness": 0.5, "Coat Weight": 1.0, **inputs}
    coated = new_material("coated")
    surface = node(coated.node_tree, "ShaderNodeBsdfPrincipled", given).outputs[0]
    node(coated.node_tree, "ShaderNodeOutputMaterial", {"Surface": surface})
    corners = [(-HALF, -HALF, 0), (HALF, -HALF, 0), (HALF, HALF, 0), (-HALF, HALF, 0)]
    plane = mesh_object("plane", corners, [(0, 1, 2, 3)])
    plane.data.materials.append(coated)
    if lamp:
        above = linked(bpy.data.lights.new("lamp", "AREA"))
        above.data.energy, above.data.size = 300, 1.5
        above.location = 0.3, 1.5, 3.0
    scene = bpy.context.scene
    scene.camera = linked(bpy.data.cameras.new("camera"))
    scene.camera.location, scene.camera.rotation_euler = (0, -3.0, 3.5), (0.72, 0, 0)
    draw_beside_cycles(scene, SIZE, 400)
    shown = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        shown.append(picture(scene, tmp_path).astype(float))
    return shown[0], shown[1]


@pytest.mark.parametrize("name", COATS)
def test_a_coat_reflects_and_dims_as_in_cycles(empty_file, tmp_path, name):
    cycles, found = drawn(empty_file, tmp_path, True, **COATS[name])
    lit = cycles[..., :3].sum(axis=2) > 0
    ratio = found[lit][:, :3].mean(axis=0) / cycles[lit][:, :3].mean(axis=0)
    assert np.abs(ratio - 1).max() < 0.02  # measured 0.0115, on metal; of others 0.002
    assert np.sqrt(np.mean((found - cycles)[lit][:, :3] ** 2)) < 0.08 * cycles[lit][:, :3].mean()  # measured 0.052


def test_what_shines_below_a_coat_is_dimmed_by_it_without_any_light(empty_file, tmp_path):
    shining = {"Emission Strength": 1.0, "Emission Color": (1, 1, 1, 1), "Coat Roughness": 0.2, "Coat Tint": TINT}
    cycles, found = drawn(empty_file, tmp_path, False, **shining)
    inside = slice(2, SIZE[1] // 2), slice(12, 36)  # where the plane fills the picture
    wrong = np.abs(found[inside] / cycles[inside] - 1)[..., :3]
    assert wrong.max() < 0.001  # measured 0.0003
