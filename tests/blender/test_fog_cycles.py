"""A world with a volume, beside Cycles: fog in which suns and the world do not shine."""

from __future__ import annotations

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from scripts.common.volume_objects import surface
from scripts.studies import media

SIZE = 64


pytestmark = pytest.mark.usefixtures("empty_file")


def fog(scene: bpy.types.Scene, node: str, **inputs) -> bpy.types.Node:
    """Fills the scene's world, which is black, with a volume shader; `inputs` are its sockets."""
    media.sky(scene, 0.0)
    tree = scene.world.node_tree
    made = tree.nodes.new(node)
    for name, value in inputs.items():
        made.inputs[name].default_value = value
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputWorld")
    tree.links.new(made.outputs[0], output.inputs["Volume"])
    return made


def studio() -> bpy.types.Scene:
    scene = media.studio(SIZE)
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    look = surface("Floor", (0.8,) * 3, Roughness=1.0, Specular_IOR_Level=0.0)
    media.plane(30.0, -1.0, look)
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0, 0.3, -0.5))
    bpy.context.object.data.materials.append(look)
    media.look(scene.camera, (3.5, -7.0, 3.2), (0, 0, 0.3))
    scene.camera.data.angle = math.radians(38)
    return scene


def world_of(scene: bpy.types.Scene):
    from pointsplat_addon.host.convert.light.world import from_world

    return from_world(scene.world)


@pytest.mark.parametrize("kind", ["POINT", "SPOT"])
def test_lamps_in_fog_are_cycles(tmp_path, kind):
    scene = studio()
    fog(scene, "ShaderNodeVolumeScatter", Density=0.08, Color=(0.8, 0.6, 0.4, 1.0), Anisotropy=0.3)
    media.lamp(scene, kind, 300.0 if kind == "POINT" else 900.0, (1.6, 2.2, 2.4), (0, 0, -1))
    seen = media.draw(scene, tmp_path, "POINTSPLAT", 16)
    cycles = media.draw(scene, tmp_path, "CYCLES", 512)
    # But for what is next to the lamp, which grows beyond all bounds.
    kept = cycles[..., :3].max(axis=2) < np.quantile(cycles[..., :3].max(axis=2), 0.98)
    rmse = math.sqrt(((seen - cycles)[kept, :3] ** 2).mean()) / cycles[kept, :3].max()
    mean = seen[kept, :3].mean() / cycles[kept, :3].mean() - 1
    assert rmse < 0.02  # measured 0.0034 (point), 0.0142 (spot, along its shadow's edges)
    assert abs(mean) < 0.005  # measured 3.2e-4 and 1.0e-3
    np.testing.assert_allclose(seen[..., 3], 1, atol=1e-5)


@pytest.mark.parametrize("far", ["SUN", "sky"])
def test_suns_and_skies_do_not_reach_through_fog(tmp_path, far):
    scene = studio()
    fog(scene, "ShaderNodeVolumeAbsorption", Density=0.001, Color=(0.0, 0.0, 0.0, 1.0))
    if far == "SUN":
        media.lamp(scene, "SUN", 3.0, (1.6, -1.2, 2.4))
    else:
        scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    for engine, samples in (("POINTSPLAT", 4), ("CYCLES", 4)):
        seen = media.draw(scene, tmp_path, engine, samples)
        assert not seen[..., :3].any()
        np.testing.assert_allclose(seen[..., 3], 1, atol=1e-5)


def test_volume_shaders_of_worlds_are_fogs():
    scene = media.studio(8)
    assert world_of(scene)[0].fog is None
    node = fog(scene, "ShaderNodeVolumePrincipled", Density=0.2, Color=(0.5, 0.25, 1.0, 1.0), Anisotropy=-0.5)
    node.inputs["Emission Strength"].default_value = 2.0
    node.inputs["Emission Color"].default_value = (0.1, 0.2, 0.3, 1.0)
    world, _, warnings = world_of(scene)
    assert not warnings
    assert world.fog is not None
    np.testing.assert_allclose(world.fog.scattering, 0.2 * np.array([0.5, 0.25, 1.0]), rtol=1e-6)
    np.testing.assert_allclose(world.fog.extinction, 0.2 * np.ones(3), rtol=1e-6)
    np.testing.assert_allclose(world.fog.emission, [0.2, 0.4, 0.6], rtol=1e-6)
    assert world.fog.anisotropy == -0.5
    node.inputs["Density"].default_value = 0.0
    node.inputs["Emission Strength"].default_value = 0.0
    assert world_of(scene)[0].fog is None
