"""Shadows on meshes of few faces that are shaded smooth, beside Cycles, whose default is a geometry offset of 0.1."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector

from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture

SIZE = 96, 64
PLATE = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
FACES = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)]
MAKERS = {
    "cylinder": lambda: bpy.ops.mesh.primitive_cylinder_add(radius=0.5, depth=1.1),
    "cube": lambda: bpy.ops.mesh.primitive_cube_add(size=1.0),
    "ball": lambda: bpy.ops.mesh.primitive_uv_sphere_add(radius=0.6, segments=10, ring_count=6),
}


def linked(data, location):
    """A new object at a place, which looks along -Z at the middle of what is drawn."""
    made = bpy.data.objects.new(data.name, data)
    made.location = location
    made.rotation_euler = (-Vector(location)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.collection.objects.link(made)
    return made


def lit_beside_cycles(ob, kind: str, folder) -> tuple[float, float]:
    """The mean of a picture of a white object over Cycles', and the error's root mean square over that."""
    material = new_material()
    shader = node(material.node_tree, "ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.8, 0.8, 1)})
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": shader.outputs[0]})
    ob.data.materials.append(material)
    light = bpy.data.lights.new("light", kind)
    light.energy = 3 if kind == "SUN" else 500
    if kind == "AREA":
        light.size = 0.5
    elif kind == "POINT":
        light.shadow_soft_size = 0
    else:
        light.angle = 0
    linked(light, (2, -0.5, 1))
    scene = bpy.context.scene
    scene.camera = linked(bpy.data.cameras.new("camera"), (0.8, -2.2, 0.7))
    draw_beside_cycles(scene, SIZE, 64)
    shown = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        shown.append(picture(scene, folder).astype(float)[..., :3])
    cycles, found = shown
    return found.mean() / cycles.mean(), np.sqrt(np.mean((found - cycles) ** 2)) / cycles.mean()


@pytest.mark.parametrize("kind", ["SUN", "POINT", "AREA"])
@pytest.mark.parametrize("shape", MAKERS)
def test_smooth_meshes_shade_themselves_as_in_cycles(empty_file, tmp_path, shape, kind):
    MAKERS[shape]()
    ob = bpy.context.object
    ob.data.shade_smooth()
    ob.rotation_euler = 0.6, 0.5, 0.2
    ratio, error = lit_beside_cycles(ob, kind, tmp_path)
    assert abs(ratio - 1) < 0.005  # measured 0.0033; 0.147 without what bulges
    assert error < 0.03  # measured 0.0244; 0.42 without


@pytest.mark.parametrize("kind", ["SUN", "POINT", "AREA"])
def test_the_rim_of_a_leaf_is_lit_from_behind_as_far_as_in_cycles(empty_file, tmp_path, kind):
    """A thin plate whose normals lie nearly in its plane, whose lower side is seen and whose upper side is lit."""
    ob = mesh_object("leaf", [(0.6 * x, 0.6 * y, 5e-4 * z) for x, y, z in PLATE], FACES)
    ob.data.shade_smooth()
    normals = np.array(PLATE) * (1, 1, 0.2)
    ob.data.normals_split_custom_set_from_vertices((normals / np.linalg.norm(normals, axis=1)[:, None]).tolist())
    ob.rotation_euler = -1.0, 0.9, 0.2
    ratio, error = lit_beside_cycles(ob, kind, tmp_path)
    assert abs(ratio - 1) < 0.008  # measured 0.0057
    assert error < 0.04  # measured 0.033
