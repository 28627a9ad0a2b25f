"""The Vector pass of points that move within their object, against geometry and, where it reads them, Cycles."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false, reportOptionalSubscript=false, reportCallIssue=false
import bpy
import numpy as np
import pytest
from mathutils import Matrix

from pointsplat_addon.host.convert.objects import collect
from pointsplat_addon.host.sync import Synchronizer
from tests.support import files
from tests.support.blender.scenes import pointcloud
from tests.support.blender.sequences import frames, imported

pytestmark = pytest.mark.usefixtures("empty_file")

SIDE, WIDE = 64, 6.4  # pixels, and units that they show
VELOCITY = np.array([1.0, 2.0, -3.0])  # object units a second
READS = bpy.app.version >= (5, 0, 0)  # Cycles of 4.5 leaves the velocities of point clouds out


def ball(velocity=VELOCITY, name="velocity"):
    """A ball of 2 units in the middle of a picture of 10 pixels a unit, seen from above."""
    scene = bpy.context.scene
    ob = pointcloud(
        "ball", [(0, 0, 0)], radius=("FLOAT", "value", [2.0]), **{name: ("FLOAT_VECTOR", "vector", [velocity])}
    )
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", WIDE, (0, 0, 10)
    scene.collection.objects.link(camera)
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.resolution_percentage = 100
    scene.view_layers[0].use_pass_vector = True
    scene.frame_set(5)
    return ob


def vector(engine, tmp_path):
    """(H, W, 4), bottom row first."""
    scene, image = bpy.context.scene, bpy.context.scene.render.image_settings
    scene.render.engine, scene.pointsplat.samples, scene.cycles.samples = engine, 1, 1
    scene.cycles.device, scene.cycles.use_denoising = "CPU", False
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    scene.render.filepath = str(tmp_path / "out.exr")
    bpy.ops.render.render(write_still=True)
    return next(array for name, array in files.read_exr(tmp_path / "out.exr").items() if name.endswith("Vector"))


@pytest.mark.parametrize("kind", ["disk", "ball"])
@pytest.mark.parametrize(("fps", "base"), [(24, 1.0), (30, 1.001)])
def test_points_come_from_where_their_velocity_says(tmp_path, kind, fps, base):
    ob = ball()
    if kind == "disk":
        ob.data.attributes.new("normal", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", [0, 0, 1])
        ob.pointsplat.shape = "DISKS"
    render = bpy.context.scene.render
    render.fps, render.fps_base = fps, base
    ob.matrix_world = Matrix.Rotation(0.5, 4, "Z") @ Matrix.Diagonal((1.5, 0.5, 1, 1))
    moved = np.array(ob.matrix_world)[:2, :2] @ VELOCITY[:2] * base / fps * SIDE / WIDE
    found = vector("POINTSPLAT", tmp_path)
    middle = slice(SIDE // 2 - 6, SIDE // 2 + 6)
    np.testing.assert_allclose(found[middle, middle, :2], np.broadcast_to(-moved, (12, 12, 2)), atol=1e-4)
    assert not found[0, 0].any()
    if READS:
        cycles = vector("CYCLES", tmp_path)[middle, middle]
        np.testing.assert_allclose(found[middle, middle], cycles, atol=1e-4)


def test_objects_move_and_points_within_them(tmp_path):
    ob = ball()
    for frame, x in ((4, 0.0), (5, 0.2), (6, 0.4)):
        ob.location = (x, 0, 0)
        ob.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(5)
    found = vector("POINTSPLAT", tmp_path)[SIDE // 2, SIDE // 2, :2]
    expected = (VELOCITY[:2] / bpy.context.scene.render.fps + [0.2, 0]) * SIDE / WIDE
    np.testing.assert_allclose(found, -expected, atol=1e-4)
    if READS:
        cycles = vector("CYCLES", tmp_path)[SIDE // 2, SIDE // 2, :2]
        np.testing.assert_allclose(found, cycles, atol=1e-4)


def test_velocities_are_read_only_where_vector_is_wanted():
    ball()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert Synchronizer().scene(depsgraph).geometries[0].cloud.velocity is None
    previous = dict.fromkeys(collect(depsgraph, identify=True).identity, np.eye(4))
    cloud = Synchronizer().scene(depsgraph, previous=previous).geometries[0].cloud
    np.testing.assert_allclose(cloud.velocity, [VELOCITY / bpy.context.scene.render.fps], rtol=1e-6)


@pytest.mark.parametrize("name", ["speed", "Velocity"])
def test_other_attributes_are_no_velocities(tmp_path, name):
    ball(name=name)
    assert not vector("POINTSPLAT", tmp_path).any()


def test_velocities_that_are_no_numbers_are_none(tmp_path):
    ball(velocity=(np.nan, np.inf, 1))
    assert not vector("POINTSPLAT", tmp_path).any()


def test_points_of_sequences_have_those_of_their_files(tmp_path):
    ob = imported(frames(tmp_path, velocity=True))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    previous = dict.fromkeys(collect(depsgraph, identify=True).identity, np.eye(4))
    for frame in (1, 2, 3):
        bpy.context.scene.frame_set(frame)
        cloud = Synchronizer().scene(bpy.context.evaluated_depsgraph_get(), previous=previous).geometries[0].cloud
        count = 10 + frame
        expected = np.stack([np.full(count, 1.5), np.arange(count), np.full(count, -2.0)], axis=1) / 24
        assert len(cloud) == count
        np.testing.assert_allclose(cloud.velocity, expected, rtol=1e-6)
    assert ob.type == "POINTCLOUD"
