"""Objects that cameras do not see cast shadows, and those that diffuse rays do not see let the sky by, as in Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender.scenes import draw_beside_cycles, mesh_object, picture


@pytest.fixture
def scene(empty_file):
    """A floor under a lamp, seen obliquely."""
    scene = bpy.context.scene
    mesh_object("floor", [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)], [(0, 1, 2, 3)])
    lamp = bpy.data.lights.new("lamp", "AREA")
    lamp.energy, lamp.size = 300, 0.5
    shining = bpy.data.objects.new("lamp", lamp)
    shining.location, shining.rotation_euler = (1, -2, 5), (0.38, 0.19, 0)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.camera.location, scene.camera.rotation_euler = (3, -6, 5), (0.97, 0, 0.464)
    for item in (scene.camera, shining):
        scene.collection.objects.link(item)
    draw_beside_cycles(scene, (96, 72), 64)
    return scene


def drawn(scene, engine: str, folder) -> np.ndarray:
    scene.render.engine = engine
    return picture(scene, folder)[..., :3].astype(np.float64)


def cube(scene):
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 1))
    bpy.context.object.visible_camera = False


def instance(scene):
    """Of a collection, whose instancer is not seen."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 1))
    held = bpy.data.collections.new("held")
    held.objects.link(bpy.context.object)
    scene.collection.objects.unlink(bpy.context.object)
    empty = bpy.data.objects.new("empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", held
    empty.visible_camera = False
    scene.collection.objects.link(empty)


def only_indirect(scene):
    """A collection whose objects cameras do not see."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 1))
    held = bpy.data.collections.new("held")
    scene.collection.children.link(held)
    held.objects.link(bpy.context.object)
    scene.collection.objects.unlink(bpy.context.object)
    bpy.context.view_layer.layer_collection.children["held"].indirect_only = True


@pytest.mark.parametrize("unseen", [cube, instance, only_indirect])
def test_what_cameras_do_not_see_casts_shadows(scene, tmp_path, unseen):
    open_floor = drawn(scene, "CYCLES", tmp_path)
    unseen(scene)
    truth, found = drawn(scene, "CYCLES", tmp_path), drawn(scene, "POINTSPLAT", tmp_path)
    assert truth.mean() < 0.98 * open_floor.mean()  # it does
    assert abs(found.mean() / truth.mean() - 1) < 0.001  # measured: 3.2e-6, and 6.6e-4 with Blender 5.2
    assert np.sqrt(np.square(found - truth).mean()) < 0.006  # measured: 0.0057, the noise of Cycles in the penumbra


def test_what_neither_cameras_nor_lamps_see_is_left_out(scene, tmp_path):
    before = drawn(scene, "POINTSPLAT", tmp_path)
    cube(scene)
    bpy.context.object.visible_shadow = False
    np.testing.assert_array_equal(drawn(scene, "POINTSPLAT", tmp_path), before)


# Measured: 1.0106 and 0.0129 under the cube that hides the sky, which in Cycles takes 2.5 % of the light; 1.0022 and
# 0.0042 where it lets it by.
@pytest.mark.parametrize(("visible", "of_mean", "error"), [(True, 0.015, 0.015), (False, 0.004, 0.006)])
def test_what_diffuse_rays_do_not_see_hides_no_sky(scene, tmp_path, visible, of_mean, error):
    cube(scene)
    bpy.context.object.visible_diffuse = visible
    scene.objects["lamp"].hide_render = True
    scene.world = bpy.data.worlds.new("sky")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    assert scene.world.node_tree is not None
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = 0.5, 0.5, 0.5, 1
    scene.pointsplat.use_indirect = True
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 3
    scene.render.film_transparent = True
    truth, found = drawn(scene, "CYCLES", tmp_path), drawn(scene, "POINTSPLAT", tmp_path)
    assert abs(found.mean() / truth.mean() - 1) < of_mean
    assert np.sqrt(np.square(found - truth).mean()) < error
