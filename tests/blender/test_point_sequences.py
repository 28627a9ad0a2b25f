"""Numbered PLY files as one object that follows the scene's frame: in conversion, pictures, and after loading."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false, reportOptionalSubscript=false
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.host.scans.sequences import numbered_files
from tests.support.blender.scenes import sync
from tests.support.blender.sequences import frame_file, frames, imported

pytestmark = pytest.mark.usefixtures("empty_file")

ROOT = Path(__file__).resolve().parents[2]


def shown(frame):
    """The cloud of a frame, None without one."""
    bpy.context.scene.frame_set(frame)
    geometries = sync().geometries
    return geometries[0].cloud if geometries else None


@pytest.mark.parametrize("pattern", ["frame_{:04d}.ply", "frame {}.ply", "{:03d}.ply"])
def test_points_follow_the_frame(tmp_path, pattern):
    ob = imported(frames(tmp_path, pattern=pattern))
    assert ob.type == "POINTCLOUD"
    for frame in (3, 1, 12, 2):
        cloud = shown(frame)
        assert len(cloud) == 10 + frame
        np.testing.assert_array_equal(cloud.position[:, 0], frame)
    # Before and after, what is nearest; where a file is missing, nothing.
    assert len(shown(-5)) == 11
    assert len(shown(99)) == 22
    assert shown(7) is None


def test_the_offset_of_the_modifier_moves_the_frames(tmp_path):
    ob = imported(frames(tmp_path))
    modifier = ob.modifiers["Sequence"]
    identifier = next(i.identifier for i in modifier.node_group.interface.items_tree if i.name == "Offset")
    if hasattr(modifier, "properties"):  # since Blender 5.2
        getattr(modifier.properties.inputs, identifier).value = 2
    else:
        modifier[identifier] = 2
    ob.update_tag()
    assert len(shown(1)) == 13


def test_colours_radii_and_velocities_are_kept(tmp_path):
    ob = imported(frames(tmp_path, velocity=True, radius=True))
    cloud = shown(2)
    np.testing.assert_allclose(cloud.radii, 0.125)
    linear = ((200 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(cloud.color, np.tile([linear, 0, 0], (12, 1)), atol=2e-3)  # 8 bits
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    velocity = np.empty(3 * 12, np.float32)
    evaluated.attributes["velocity"].data.foreach_get("vector", velocity)
    expected = np.stack([np.full(12, 1.5), np.arange(12), np.full(12, -2)], axis=1)
    np.testing.assert_array_equal(velocity.reshape(-1, 3), expected)


def test_without_radii_points_have_half_the_spacing(tmp_path):
    imported(frames(tmp_path, color=False))
    np.testing.assert_allclose(shown(2).radii, 0.5 * np.hypot(1, 0.5), rtol=1e-6)


def test_shapes_and_filters_apply_to_what_the_nodes_make(tmp_path):
    ob = imported(frames(tmp_path))
    ob.pointsplat.radius = 0.75
    made = ob.pointsplat.filters.add()
    made.kind, made.low, made.high = "HEIGHT", 0.9, 2.1
    cloud = shown(3)
    np.testing.assert_array_equal(cloud.position[:, 2], [1, 1.5, 2])
    np.testing.assert_array_equal(cloud.radii, 0.75)


def test_the_range_of_a_new_filter_is_that_of_the_frames_points(tmp_path):
    ob = imported(frames(tmp_path))
    bpy.context.scene.frame_set(2)
    bpy.ops.pointsplat.add_point_filter(kind="HEIGHT")
    assert (ob.pointsplat.filters[0].low, ob.pointsplat.filters[0].high) == (0.0, 5.5)


def test_gaps_and_far_coordinates_are_said(tmp_path, capfd):
    imported(frames(tmp_path, offset=3e6))
    text = "".join(capfd.readouterr())
    assert "8 of the frames 1 to 12 have no file" in text
    assert "Coordinates reach 3,000,001" in text


@pytest.mark.parametrize(
    ("name", "message"),
    [("scan.ply", "is not one of a sequence"), ("scan_1.xyz", "sequences are read from PLY files alone")],
)
def test_what_is_no_sequence_is_refused_and_leaves_nothing(tmp_path, name, message):
    frame_file(tmp_path / name, 1)
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.pointsplat.import_points(filepath=str(tmp_path / name), sequence=True)
    left = bpy.data.objects, bpy.data.pointclouds, bpy.data.node_groups, bpy.data.materials
    assert [len(found) for found in left] == [0, 0, 0, 0]


def test_names_of_files_that_belong_together(tmp_path):
    for name in ("a_008.ply", "a_009.ply", "a_010.ply", "a_1000.ply", "a_11.ply", "b_011.ply", "a_012.las", "a_x.ply"):
        (tmp_path / name).touch()
    found = numbered_files(tmp_path / "a_009.ply")
    assert (found.stem, found.suffix, found.digits) == (str(tmp_path / "a_"), ".ply", 3)
    assert found.numbers == (8, 9, 10, 1000)
    with pytest.raises(PointFileError, match=r"a_x\.ply: is not one of a sequence"):
        numbered_files(tmp_path / "a_x.ply")


def test_an_empty_frame_draws_nothing(tmp_path):
    path = frames(tmp_path, numbers=(1, 2))
    frame_file(tmp_path / "frame_0003.ply", 3, count=0)
    imported(path).pointsplat.filters.add().kind = "HEIGHT"
    assert shown(3) is None
    assert sync().warnings == ()
    bpy.context.object.pointsplat.filters.clear()
    bpy.context.object.update_tag()
    assert len(shown(2)) == 12


def test_a_saved_file_renders_each_frame_in_the_background_and_cycles_draws_the_same(tmp_path):
    """Another process loads the file and renders an animation: a row of balls that moves from frame to frame."""
    imported(frames(tmp_path, numbers=(1, 2)))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 24.0, (1.5, 6, 30)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.render.film_transparent = True
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(tmp_path / "out_")
    scene.frame_start, scene.frame_end = 1, 2
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    code = (
        "import bpy, pointsplat_addon; pointsplat_addon.register();"
        f"bpy.ops.wm.open_mainfile(filepath={str(tmp_path / 'scene.blend')!r});"
        "bpy.ops.render.render(animation=True); import os, sys; sys.stdout.flush(); os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120, capture_output=True)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 4
    scene.frame_set(2)
    scene.render.filepath = str(tmp_path / "out_0003.exr")
    bpy.ops.render.render(write_still=True)
    columns = []
    for frame in (1, 2, 3):
        image = bpy.data.images.load(str(tmp_path / f"out_{frame:04d}.exr"))
        pixels = np.array(image.pixels, np.float32).reshape(48, 48, 4)[..., 3]
        columns.append((pixels * np.arange(48)).sum() / pixels.sum())
        assert pixels.sum() > 10
    assert columns[1] - columns[0] == pytest.approx(2.0, abs=0.02)  # one unit is two pixels; measured 0.000
    assert columns[2] == pytest.approx(columns[1], abs=0.1)  # Cycles' noise; measured 0.01
