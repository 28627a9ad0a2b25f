"""Passes of light beside Cycles': names, channels, and what simple surfaces have in each."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.render.passes.outputs import LIGHT_PASSES
from tests.support import files
from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node

SIZE = 32, 32
COLOR = (0.8, 0.5, 0.2, 1)
# Inputs of a Principled BSDF, and the largest difference of any pass's mean from Cycles'. Measured: 0.0025, 0.0005,
# 0.0013, 0.0025, 0.0025, in Glossy Direct, whose light is over a colour of 0.04; 0.0012 in Glossy Color of glass.
SURFACES = {
    "plain": ({}, 0.003),
    "rough metal": ({"Metallic": 1.0, "Roughness": 0.4}, 0.001),
    "coated": ({"Coat Weight": 1.0}, 0.002),
    "glowing": ({"Emission Color": (1, 0.5, 0.25, 1), "Emission Strength": 1.5}, 0.003),
    "half there": ({"Alpha": 0.5}, 0.003),
    "glass": ({"Base Color": (0.8, 0.9, 1, 1), "Transmission Weight": 1.0, "IOR": 1.45, "Roughness": 0.0}, 0.002),
}


def linked(data):
    made = bpy.data.objects.new(data.name, data)
    bpy.context.collection.objects.link(made)
    return made


def scene_of(inputs, size=20.0):
    """A plane seen aslant by a parallel camera, under a sun and a sky."""
    material = new_material("surface")
    surface = node(material.node_tree, "ShaderNodeBsdfPrincipled", {"Base Color": COLOR, **inputs}).outputs[0]
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": surface})
    half = size / 2
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    mesh_object("plane", corners, [(0, 1, 2, 3)]).data.materials.append(material)
    scene = bpy.context.scene
    sun = linked(bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.rotation_euler = 2, 0.1, (0.3, -0.4, 0)
    scene.world = bpy.data.worlds.new("sky")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    assert scene.world.node_tree is not None
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = 0.2, 0.3, 0.4, 1
    scene.camera = linked(bpy.data.cameras.new("camera"))
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 2
    scene.camera.location, scene.camera.rotation_euler = (0, -2.8766, 5.2655), (0.5, 0, 0)
    draw_beside_cycles(scene, SIZE, 256)
    scene.cycles.max_bounces = 4
    scene.pointsplat.samples = 16
    image, layer = scene.render.image_settings, scene.view_layers[0]
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.exr_codec = "OPEN_EXR_MULTILAYER", "NONE"
    for p in LIGHT_PASSES:
        if p.switch.startswith("pointsplat."):
            for settings in (layer.pointsplat, layer.cycles):
                setattr(settings, p.switch.partition(".")[2], True)
        else:
            setattr(layer, p.switch, True)
    return scene


def passes(scene, engine, folder):
    scene.render.engine, scene.render.filepath = engine, str(folder / f"{engine}.exr")
    bpy.ops.render.render(write_still=True)
    found = files.read_exr(folder / f"{engine}.exr")
    return {name.rpartition(".")[2]: pixels for name, pixels in found.items()}


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces_have_in_each_pass_what_they_have_in_cycles(empty_file, tmp_path, name):
    inputs, most = SURFACES[name]
    scene = scene_of(inputs)
    cycles, found = (passes(scene, engine, tmp_path) for engine in ("CYCLES", "POINTSPLAT"))
    assert {key: pixels.shape for key, pixels in found.items()} == {key: p.shape for key, p in cycles.items()}
    for key, expected in cycles.items():
        difference = np.abs(found[key].mean(axis=(0, 1)) - expected.mean(axis=(0, 1))).max()
        assert difference < most, (key, difference)


def test_a_transparent_film_has_the_environment_in_its_pass_all_the_same(empty_file, tmp_path):
    scene = scene_of({}, size=1.0)
    scene.render.film_transparent = True
    cycles, found = (passes(scene, engine, tmp_path) for engine in ("CYCLES", "POINTSPLAT"))
    assert found["Combined"][0, 0].tolist() == cycles["Combined"][0, 0].tolist() == [0, 0, 0, 0]
    name = next(p.names for p in LIGHT_PASSES if p.key == "environment")[bpy.app.version >= (5, 0, 0)]
    np.testing.assert_allclose(found[name][0, 0], cycles[name][0, 0], rtol=5e-6)  # measured 2.4e-6
    difference = found[name].mean(axis=(0, 1)) - cycles[name].mean(axis=(0, 1))
    assert np.abs(difference).max() < 0.003  # measured 0.0012: Cycles' noise along edges


def block(low, high, kind):
    """A box of a material of one node."""
    corners = [(x, y, z) for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    made, material = mesh_object(kind, corners, faces), new_material(kind)
    surface = node(material.node_tree, kind).outputs[0]
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": surface})
    made.data.materials.append(material)
    return made


# Root mean square and mean of the difference, by distance; measured 0.0220 and -0.0041, 0.0193 and 0.0001, 8e-9. Most
# of it is noise of Cycles', and within a few pixels of edges at which things touch.
OCCLUSION = {10.0: (0.025, 0.006), 0.5: (0.023, 0.001), 0.0: (1e-6, 1e-6)}


@pytest.mark.parametrize("distance", OCCLUSION)
def test_ambient_occlusion_is_that_of_cycles(empty_file, tmp_path, distance):
    """Of surfaces that shine, reflect and let light through alike; by what casts shadows, and no other thing."""
    scene = scene_of({})
    scene.render.resolution_x = scene.render.resolution_y = 192
    scene.camera.data.ortho_scale = 5
    scene.world.light_settings.distance = distance
    block((-2, 1.2, 0), (2, 1.4, 1), "ShaderNodeBsdfDiffuse")
    block((-1.6, -0.4, 0), (-0.6, 0.6, 0.8), "ShaderNodeEmission")
    block((0.4, -0.2, 0), (1.2, 0.6, 0.6), "ShaderNodeBsdfGlass")
    block((-0.2, -1.6, 0), (1.8, -1.4, 0.5), "ShaderNodeBsdfGlossy").visible_diffuse = False
    block((-1.8, -1.6, 0), (-1.0, -1.4, 0.5), "ShaderNodeBsdfDiffuse").visible_shadow = False
    scene.cycles.max_bounces = 0  # occlusion has none
    scene.cycles.samples = 64 if distance else 4  # nothing is nearer than no distance
    cycles, found = (passes(scene, engine, tmp_path) for engine in ("CYCLES", "POINTSPLAT"))
    name = next(p.names for p in LIGHT_PASSES if p.key == "ambient_occlusion")[bpy.app.version >= (5, 0, 0)]
    difference = found[name].astype(float) - cycles[name]
    most, off = OCCLUSION[distance]
    assert np.sqrt((difference**2).mean()) < most
    assert abs(difference.mean()) < off
