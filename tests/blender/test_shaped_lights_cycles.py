"""Lights with a size that do not shine evenly to all sides, beside Cycles: a ball on a floor, and its shadow."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector

from tests.support.blender.scenes import draw_beside_cycles, new_material, node, picture

SIZE = 96, 54
# The most of the root mean square of the error over the mean; measured, and before points of a light weighed by what
# they send to a receiver, in its shadows too:
LIGHTS = {
    "a narrow spot that fades": ("SPOT", {"energy": 500, "spot_size": 0.5, "spot_blend": 1.0}, 0.08),  # 0.067; 0.48
    "a narrow spot with an edge": ("SPOT", {"energy": 500, "spot_size": 0.5, "spot_blend": 0.0}, 0.13),  # 0.113; 0.51
    "a wide spot": ("SPOT", {"energy": 500, "spot_size": 1.5, "spot_blend": 0.2}, 0.012),  # 0.0087; 0.031
    "a beam": ("AREA", {"energy": 100, "size": 1, "spread": 0.7}, 0.035),  # 0.0277; 0.067
}


def aimed(data, place):
    """A new object that looks along -Z at the ball."""
    made = bpy.data.objects.new(data.name, data)
    made.location = place
    made.rotation_euler = (Vector((0, 0, 0.4)) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.collection.objects.link(made)
    return made


@pytest.mark.parametrize("name", LIGHTS)
def test_their_light_and_shadows_are_cycles(empty_file, tmp_path, name):
    kind, properties, most = LIGHTS[name]
    matte = new_material()
    shader = node(matte.node_tree, "ShaderNodeBsdfDiffuse", {"Color": (0.6, 0.6, 0.6, 1)})
    node(matte.node_tree, "ShaderNodeOutputMaterial", {"Surface": shader.outputs[0]})
    bpy.ops.mesh.primitive_plane_add(size=8)
    bpy.context.object.data.materials.append(matte)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(0, 0, 0.8), segments=48, ring_count=24)
    bpy.context.object.data.shade_smooth()
    bpy.context.object.data.materials.append(matte)
    light = bpy.data.lights.new("light", kind)
    if kind == "SPOT":
        light.shadow_soft_size = 0.5
    for key, value in properties.items():
        setattr(light, key, value)
    aimed(light, (1.5, -2, 3))
    scene = bpy.context.scene
    scene.camera = aimed(bpy.data.cameras.new("camera"), (0, -6, 3.5))
    draw_beside_cycles(scene, SIZE, 256)
    shown = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        shown.append(picture(scene, tmp_path).astype(float)[..., :3])
    cycles, found = shown
    assert np.sqrt(np.mean((found - cycles) ** 2)) / cycles.mean() < most
