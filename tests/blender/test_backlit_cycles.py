"""The Translucent BSDF beside Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture

SIZE = 64, 48
LEAF, FRONT = (0.2, 0.7, 0.1, 1), (0.7, 0.4, 0.2, 1)
SQUARE = [(-1, -1), (1, -1), (1, 1), (-1, 1)]


def linked(data, location, rotation):
    made = bpy.data.objects.new(data.name, data)
    made.location, made.rotation_euler = location, rotation
    bpy.context.collection.objects.link(made)
    return made


def leaf(mixed: float):
    """Translucent, mixed with a share of diffuse in another colour."""
    made = new_material("leaf")
    tree = made.node_tree
    behind = node(tree, "ShaderNodeBsdfTranslucent", {"Color": LEAF}).outputs[0]
    front = node(tree, "ShaderNodeBsdfDiffuse", {"Color": FRONT}).outputs[0]
    both = node(tree, "ShaderNodeMixShader", {"Fac": mixed, "Shader": behind, "Shader_001": front})
    node(tree, "ShaderNodeOutputMaterial", {"Surface": both.outputs[0]})
    return made


@pytest.mark.parametrize("mixed", [0.0, 0.4])
@pytest.mark.parametrize("kind", ["SUN", "AREA", "POINT"])
def test_leaves_are_lit_from_behind_as_in_cycles(empty_file, tmp_path, kind, mixed):
    """Three, of which one faces the light and one is in the shadow of a fourth in part, over a floor."""
    material = leaf(mixed)
    floor = mesh_object("floor", [(4 * x, 4 * y, 0) for x, y in SQUARE], [(0, 1, 2, 3)])
    floor.data.materials.append(material)
    for number, (place, tilt) in enumerate(
        [((-1.2, 0, 1), 0.6), ((0, 0, 1), 1.2), ((1.2, 0, 1), 2.4), ((0, 1, 2), 0.9)]
    ):
        ob = mesh_object(f"leaf {number}", [(0.5 * x, 0.5 * y, 0) for x, y in SQUARE], [(0, 1, 2, 3)])
        ob.location, ob.rotation_euler = place, (tilt, 0.2, 0.3 * number)
        ob.data.materials.append(material)
    light = bpy.data.lights.new("light", kind)
    light.energy = 3 if kind == "SUN" else 600
    if kind == "AREA":
        light.size = 0.5
    linked(light, (0.5, 3, 4), (-0.7, 0.1, 0))
    scene = bpy.context.scene
    scene.camera = linked(bpy.data.cameras.new("camera"), (0, -5.5, 2.2), (1.3, 0, 0))
    draw_beside_cycles(scene, SIZE, 256)
    shown = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        shown.append(picture(scene, tmp_path).astype(float)[..., :3])
    cycles, found = shown
    ratio, error = found.mean() / cycles.mean(), np.sqrt(np.mean((found - cycles) ** 2)) / cycles.mean()
    assert abs(ratio - 1) < 0.01  # measured 0.0033
    assert error < 0.12  # measured 0.096, with the noise of 256 samples in penumbrae and at edges
