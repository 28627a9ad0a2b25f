"""Sharp mirrors among other things, with indirect light, beside Cycles."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector

from tests.support.blender.scenes import draw_beside_cycles, new_material, node, picture

SIZE, SAMPLES = (96, 64), 256
PRINCIPLED = "ShaderNodeBsdfPrincipled"


def look(name, color, **inputs):
    made = new_material(name)
    values = {"Base Color": (*color, 1.0)} | {key.replace("_", " "): value for key, value in inputs.items()}
    surface = node(made.node_tree, PRINCIPLED, values).outputs[0]
    node(made.node_tree, "ShaderNodeOutputMaterial", {"Surface": surface})
    return made


def with_material(material):
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def block(color, place, scale):
    bpy.ops.mesh.primitive_cube_add(size=1, location=place, rotation=(0, 0, 0.4))
    made = with_material(look("block", color, Roughness=1.0, Specular_IOR_Level=0.0))
    made.scale = scale
    return made


def drawn(tmp_path, roughness, mirrored=True):
    """(H, W, 3) of Cycles and of PointSplat: a ball of metal and blocks on a polished floor. `mirrored`: glossy rays
    see all of it."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=20)
    with_material(look("floor", (0.15, 0.12, 0.1), Roughness=roughness))
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.6, location=(0, 0, 0.6))
    with_material(look("metal", (0.9, 0.9, 0.9), Roughness=roughness, Metallic=1.0)).data.shade_smooth()
    block((0.6, 0.06, 0.05), (-1.2, 0.3, 0.5), (0.6, 0.6, 1.0)).visible_glossy = mirrored
    block((0.1, 0.4, 0.08), (1.1, -0.5, 0.25), (0.4, 0.4, 0.5))
    lamp = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    scene.collection.objects.link(lamp)
    lamp.data.energy, lamp.rotation_euler, lamp.visible_glossy = 2.0, (0.7, 0.3, 0.4), False
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = 0.4, 0.5, 0.7, 1
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location = 0.2, -4.0, 1.4
    scene.camera.rotation_euler = (Vector((0, 0, 0.4)) - scene.camera.location).to_track_quat("-Z", "Y").to_euler()
    scene.camera.data.angle = math.radians(40)
    draw_beside_cycles(scene, SIZE, SAMPLES)
    cycles = scene.cycles
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 4, 3, 4
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.blur_glossy = cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    scene.pointsplat.use_indirect, scene.pointsplat.bounces = True, 3
    shown = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        shown.append(picture(scene, tmp_path)[..., :3].astype(float))
    return shown


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.2])
def test_mirrors_show_what_is_around_them_as_in_cycles(empty_file, tmp_path, roughness):
    cycles, found = drawn(tmp_path, roughness)
    assert cycles.mean() > 0.2
    # As cells of 18 degrees show it: 0.0374, 0.0369, 0.0338, and means of 0.973.
    assert np.sqrt(np.mean((found - cycles) ** 2)) < 0.008  # 0.0048, 0.0049, 0.0060
    assert abs(found.mean() / cycles.mean() - 1) < 0.006  # 1.0030, 1.0028, 1.0028


def test_mirrors_do_not_show_what_glossy_rays_do_not_see(empty_file, tmp_path):
    cycles, found = drawn(tmp_path, 0.0, mirrored=False)
    assert np.sqrt(np.mean((found - cycles) ** 2)) < 0.006  # 0.0042
