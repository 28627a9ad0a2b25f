"""Eye-dome lighting in a final picture of Blender: a scan without light shows where one part hides another."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
import bpy
import numpy as np
import pytest

from tests.support.blender.scenes import new_material, node, picture, pointcloud

pytestmark = pytest.mark.usefixtures("empty_file")


def test_a_step_between_two_walls_of_points_is_dark(tmp_path):
    """Two unlit walls of balls, side by side: the farther one is dark beside the nearer, and nothing else is."""
    grid = np.stack(np.meshgrid(np.linspace(0.02, 2, 60), np.linspace(-2, 2, 120)), axis=-1).reshape(-1, 2)
    near = np.column_stack([-grid, np.full(len(grid), 0.5)])
    far = np.column_stack([grid, np.zeros(len(grid))])
    ob = pointcloud("Walls", np.concatenate([near, far]))
    ob.pointsplat.radius = 0.06
    glowing = new_material()
    emission = node(glowing.node_tree, "ShaderNodeEmission", {"Color": (0.5, 0.5, 0.5, 1)})
    node(glowing.node_tree, "ShaderNodeOutputMaterial", {"Surface": emission.outputs[0]})
    ob.data.materials.append(glowing)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.sensor_width, camera.data.lens = (0, 0, 5.5), 36, 60
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "POINTSPLAT"
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.render.image_settings.file_format = "OPEN_EXR"
    before = picture(scene, tmp_path)
    np.testing.assert_allclose(before[..., 0], 0.5, atol=1e-3)
    scene.pointsplat.use_eye_dome, scene.pointsplat.eye_dome_strength = True, 0.1
    found = picture(scene, tmp_path)
    rows = np.s_[8:-8]
    dark = found[rows, :, 0].min(axis=1)
    # Three of eight neighbours lie nearer, at 5.0 of 5.5, but for the balls' own depth of 0.06.
    step = np.exp(-12 * 3 / 8 * np.log2(5.5 / 5.0))
    np.testing.assert_allclose(dark, 0.5 * step, rtol=0.04)  # measured 1.8 %
    columns = np.argmin(found[rows, :, 0], axis=1)
    assert set(columns) <= {32, 33}
    assert np.median(found[rows, :28, 0]) > 0.47
    np.testing.assert_array_equal(found[..., 3], before[..., 3])
