"""Cameras: known vertices projected by the Camera against where Cycles draws small glowing objects."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.blender.scenes import glowing, picture

bpy = pytest.importorskip("bpy")

from mathutils import Euler, Matrix

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.scene import Instances, Scene
from pointsplat_addon.core.scene.validation import validate
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.host.convert import camera as cameras


@pytest.fixture
def scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", 64, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.resolution_x, scene.render.resolution_y = 160, 120
    return scene


def perspective(scene, data):
    data.lens = 35


def orthographic(scene, data):
    data.type, data.ortho_scale = "ORTHO", 7


def shifted(scene, data):
    data.shift_x, data.shift_y = 0.2, -0.15


def shifted_orthographic(scene, data):
    data.type, data.ortho_scale, data.shift_x = "ORTHO", 7, 0.2


def portrait(scene, data):
    scene.render.resolution_x, scene.render.resolution_y = 100, 160
    data.shift_y = 0.1


def vertical_fit(scene, data):
    data.sensor_fit, data.sensor_height, data.lens = "VERTICAL", 20, 25


def horizontal_fit_portrait(scene, data):
    scene.render.resolution_x, scene.render.resolution_y = 100, 160
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", 30, 40


def pixel_aspect(scene, data):
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = 1.0, 1.6
    data.lens = 28


def border(scene, data):
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.13, 0.92
    scene.render.border_min_y, scene.render.border_max_y = 0.11, 0.87


def percentage(scene, data):
    scene.render.resolution_percentage = 50
    data.lens = 24


VIEWS = [
    perspective,
    orthographic,
    shifted,
    shifted_orthographic,
    portrait,
    vertical_fit,
    horizontal_fit_portrait,
    pixel_aspect,
    border,
    percentage,
]


def pixels_from_world(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) pixels in the window by the matrices, and the same by Camera.pixel_from_view."""
    view = points @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
    clip = np.column_stack([view, np.ones(len(view))]) @ camera.clip_from_view.T
    by_matrix = (clip[:, :2] / clip[:, 3:] + 1) / 2 * camera.resolution - camera.window[:2]
    fx, fy, cx, cy = camera.pixel_from_view()
    depth = -view[:, 2:] if camera.perspective else 1.0
    return by_matrix, np.array([cx, cy]) + np.array([fx, fy]) * view[:, :2] / depth


@pytest.mark.parametrize("set_up", VIEWS)
def test_vertices_are_projected_where_cycles_draws_them(scene, tmp_path, set_up):
    data = bpy.data.cameras.new("camera")
    obj = bpy.data.objects.new("camera", data)
    # The scale must not matter.
    obj.matrix_world = Matrix.LocRotScale((6, -5, 4), Euler((1.1, 0.05, 0.85)), (2, 0.7, 1.3))
    scene.collection.objects.link(obj)
    scene.camera = obj
    set_up(scene, data)

    render = scene.render
    size = [int(v * render.resolution_percentage / 100) for v in (render.resolution_x, render.resolution_y)]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    camera = cameras.from_camera_object(obj, depsgraph, *size)
    rigid = camera.view_from_world[:3, :3]
    assert np.abs(rigid @ rigid.T - np.eye(3)).max() < 1e-6  # measured 1e-7, Blender's float32

    # Small spheres that the camera sees, at several depths, on a grid of the window.
    width, height = camera.window[2:]
    columns, rows = np.meshgrid([0.15, 0.5, 0.85], [0.2, 0.5, 0.8])
    places = np.stack([columns * width, rows * height], -1).reshape(-1, 2)
    fx, fy, cx, cy = camera.pixel_from_view()
    depth = np.linspace(5, 11, 9)
    scale = depth if camera.perspective else np.ones(9)
    view = np.column_stack([(places - [cx, cy]) / [fx, fy] * scale[:, None], -depth])
    world = (view - camera.view_from_world[:3, 3]) @ rigid
    for i, (point, material) in enumerate(zip(world, glowing(scene, 3) * 3, strict=True)):
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3, radius=3.0 * scale[i] / fx, location=point)
        bpy.context.object.data.materials.append(material)
    by_matrix, by_formula = pixels_from_world(camera, world)
    assert np.abs(by_matrix - by_formula).max() < 1e-3  # measured 2e-5

    seen = picture(scene, tmp_path)
    assert seen.shape[:2] == (height, width)
    y, x = np.mgrid[:height, :width] + 0.5
    for i, (px, py) in enumerate(by_matrix):
        near = (np.hypot(x - px, y - py) < 9) * seen[..., i % 3]
        centroid = np.array([(x * near).sum(), (y * near).sum()]) / near.sum()
        # measured 0.105: perspective draws a sphere's outline away from the middle
        assert np.hypot(*(centroid - (px, py))) < 0.2


@pytest.mark.parametrize(
    ("place", "size", "there"),
    [((0, -4, 0), (2, 0.7, 1.3), True), ((0, -4, 0), (0, 0, 0), False), ((0, -4, 0), (1, 1, 0), False),
     ((float("inf"), -4, 0), (1, 1, 1), False)],
)  # fmt: skip
def test_a_camera_that_is_nowhere_sees_nothing_as_in_cycles(scene, tmp_path, place, size, there):
    obj = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    obj.location, obj.rotation_euler, obj.scale = place, (np.pi / 2, 0, 0), size
    scene.collection.objects.link(obj)
    scene.camera = obj
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.data.materials.append(glowing(scene, 1)[0])
    assert (picture(scene, tmp_path)[..., :3].max() > 0.5) == there

    made = Scene((), Instances(np.zeros(1, np.int32), np.eye(4)[None]), default_materials(), (), World())
    camera = cameras.from_camera_object(obj, bpy.context.evaluated_depsgraph_get(), 160, 120)
    seen, _ = validate(made, camera)
    assert (len(seen.instances), len(seen.warnings)) == ((1, 0) if there else (0, 1))


def test_clip_range_is_read_back_from_both_projections(scene):
    data = bpy.data.cameras.new("camera")
    obj = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(obj)
    data.clip_start, data.clip_end = 0.25, 80
    for kind in ("PERSP", "ORTHO"):
        data.type = kind
        camera = cameras.from_camera_object(obj, bpy.context.evaluated_depsgraph_get(), 64, 48)
        assert camera.perspective == (kind == "PERSP")
        assert (camera.near, camera.far) == (0.25, 80)
        assert cameras.clip_range(camera.clip_from_view) == pytest.approx((0.25, 80), rel=1e-4)  # measured 4e-6


def test_border_is_truncated_as_blender_does(scene):
    obj = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(obj)
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.333, 0.666
    scene.render.border_min_y, scene.render.border_max_y = 0.5, 0.5
    camera = cameras.from_camera_object(obj, bpy.context.evaluated_depsgraph_get(), 100, 90)
    assert camera.window == (33, 45, 33, 0)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_border_in_camera_view_is_a_part_of_the_camera_frame(scene, kind):
    """A region twice as wide as the camera's frame, which then fills its middle half."""
    data = bpy.data.cameras.new("camera")
    data.type, data.shift_x = kind, 0.1
    obj = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(obj)
    scene.camera = obj
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.25, 0.75
    scene.render.border_min_y, scene.render.border_max_y = 0.1, 0.6
    depsgraph = bpy.context.evaluated_depsgraph_get()
    narrow = obj.calc_matrix_camera(depsgraph, x=160, y=120)
    region = SimpleNamespace(width=640, height=240)
    rv3d = SimpleNamespace(
        view_perspective="CAMERA",
        view_matrix=obj.matrix_world.inverted(),
        window_matrix=Matrix.Diagonal((0.5, 1, 1, 1)) @ narrow,
    )
    space = SimpleNamespace(camera=obj, use_local_camera=False, use_render_border=False)
    camera = cameras.from_view(region, rv3d, space, scene)
    # The frame covers columns 160 to 480.
    assert camera.window == (240, 24, 160, 120)
    assert (camera.near, camera.far) == pytest.approx((data.clip_start, data.clip_end), rel=1e-3)

    rv3d.view_perspective = "PERSP"
    assert cameras.from_view(region, rv3d, space, scene).region is None
    space.use_render_border = True
    space.render_border_min_x, space.render_border_max_x = 0.5, 1.0
    space.render_border_min_y, space.render_border_max_y = 0.0, 0.25
    assert cameras.from_view(region, rv3d, space, scene).window == (320, 0, 320, 60)
