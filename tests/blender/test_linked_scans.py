"""Objects that stand for scans too large for memory: how they are made, drawn, saved elsewhere and found again."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import pointsplat_addon
from pointsplat_addon.formats.hierarchies.building.build import Settings, build
from pointsplat_addon.formats.hierarchies.opening import open_pages
from pointsplat_addon.formats.hierarchies.psh import PshPages
from pointsplat_addon.host.scans import picking
from pointsplat_addon.host.scans.building import build_scan
from pointsplat_addon.host.scans.linking import STAND_IN
from pointsplat_addon.host.scans.looks import look_material
from pointsplat_addon.stream.pool import POOL
from tests.support.blender.scenes import sync
from tests.support.octrees import SIDE, write_octree
from tests.support.scan_files import write_ply

COUNT = 20_000


@pytest.fixture(autouse=True)
def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    POOL.clear()
    yield
    pointsplat_addon.unregister()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = np.random.default_rng(4).integers(0, SIDE, (COUNT, 3)) * [1, 1, 0] + [0, 0, SIDE // 2]
    write_octree(tmp_path / "survey", place, 1000)
    return tmp_path / "survey"


def write_points(path: Path, place: np.ndarray) -> None:
    """A file of positions (N, 3)."""
    records = np.ascontiguousarray(place, np.float32).view([(axis, np.float32) for axis in "xyz"]).reshape(-1)
    write_ply(path, records, "binary_little_endian")


def link(path: Path):
    assert bpy.ops.pointsplat.link_scan(filepath=str(path)) == {"FINISHED"}
    return bpy.context.object


def look_down(size: tuple[int, int] = (48, 32)) -> None:
    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    data.type, data.ortho_scale, data.clip_end = "ORTHO", 210.0, 1000.0
    camera = bpy.data.objects.new("Camera", data)
    camera.location = 100.0, 100.0, 400.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100


def report():
    from pointsplat_addon.host import engine

    bpy.ops.render.render()
    return dict(engine.last_report)


def test_a_linked_scan_is_a_light_object_that_refers_to_its_file(folder: Path) -> None:
    ob = link(folder / "ept.json")
    assert (ob.type, ob.name) == ("POINTCLOUD", "survey")
    assert 0 < len(ob.data.points) <= 1.1 * STAND_IN
    assert Path(ob.pointsplat.scan_path) == folder / "ept.json"
    assert list(ob["pointsplat_origin"]) == [0.0, 0.0, 0.0]
    assert {"position", "radius", "intensity"} <= {a.name for a in ob.data.attributes}


def test_the_scene_holds_the_file_and_not_its_points(folder: Path) -> None:
    link(folder)
    [geometry] = sync().geometries
    assert geometry.cloud is None
    assert geometry.streamed is not None
    assert geometry.streamed.stand_in is not None
    assert geometry.streamed.scan.path == folder / "ept.json"
    assert geometry.streamed.scan.source is None  # whoever draws has it opened


def test_a_render_reads_what_its_tolerance_needs(folder: Path) -> None:
    link(folder)
    look_down()
    bpy.context.scene.pointsplat.tolerance = 4.0
    coarse = report()["streamed"]
    bpy.context.scene.pointsplat.tolerance = 0.05
    fine = report()["streamed"]
    assert 0 < coarse["points"] < fine["points"] == COUNT
    assert coarse["pages"] == coarse["needed_pages"] < fine["needed_pages"]
    assert fine["pages"] == fine["needed_pages"] - coarse["needed_pages"]


def test_filters_looks_and_clip_boxes_act_on_pages(folder: Path) -> None:
    ob = link(folder)
    look_down()
    bpy.context.scene.pointsplat.tolerance = 0.05
    one = ob.pointsplat.filters.add()
    one.kind, one.low, one.high = "INTENSITY", 2.0, 3.0  # of the intensities 0 to 6 of each page
    found = report()["streamed"]["points"]
    assert found == pytest.approx(COUNT * 2 / 7, rel=0.02)
    box = bpy.data.objects.new("Box", None)
    box.location, box.scale = (50.0, 100.0, 100.0), (50.0, 200.0, 200.0)
    clips = bpy.data.collections.new("Clips")
    clips.objects.link(box)
    bpy.context.scene.collection.children.link(clips)
    ob.pointsplat.clip_boxes = clips
    assert report()["streamed"]["points"] == pytest.approx(found / 2, rel=0.05)
    ob.data.materials[0] = look_material(ob, "INTENSITY")
    assert report()["warnings"] == []


def test_a_missing_file_is_said_and_what_stands_in_is_drawn(folder: Path) -> None:
    ob = link(folder)
    look_down()
    ob.pointsplat.scan_path = str(folder / "nowhere" / "ept.json")
    found = report()
    assert any("is missing" in warning for warning in found["warnings"])
    assert found["points"]["cut"] == len(ob.data.points)


def test_relative_paths_are_remapped_when_the_file_is_saved_elsewhere(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b" / "c").mkdir(parents=True)
    ob = link(folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a" / "one.blend"))
    assert ob.pointsplat.scan_path == "//../survey/ept.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "b" / "c" / "copy.blend"), copy=True)
    assert ob.pointsplat.scan_path == "//../survey/ept.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "b" / "c" / "two.blend"))
    assert ob.pointsplat.scan_path == "//../../survey/ept.json"
    for name in ("copy", "two"):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b" / "c" / f"{name}.blend"))
        assert bpy.data.objects["survey"].pointsplat.scan_path == "//../../survey/ept.json"


def test_missing_files_are_found_again_below_a_folder(folder: Path, tmp_path: Path) -> None:
    ob = link(folder)
    (tmp_path / "archive").mkdir()
    folder.rename(tmp_path / "archive" / "survey")
    assert bpy.ops.pointsplat.find_missing_scans(directory=str(tmp_path)) == {"FINISHED"}
    assert Path(ob.pointsplat.scan_path) == tmp_path / "archive" / "survey" / "ept.json"
    assert bpy.ops.pointsplat.find_missing_scans(directory=str(tmp_path)) == {"FINISHED"}


def test_what_is_no_such_scan_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.psh").write_bytes(b"no hierarchy")
    with pytest.raises(RuntimeError, match="is no hierarchy"):
        bpy.ops.pointsplat.link_scan(filepath=str(tmp_path / "a.psh"))
    assert len(bpy.data.objects) == 0


def test_points_are_picked_from_the_file_with_their_map_coordinate_and_distance(folder: Path) -> None:
    ob = link(folder)
    ob.location = 1000.0, 0.0, 0.0
    bpy.context.view_layer.update()
    for x in (30.0, 130.0):
        found = bpy.ops.pointsplat.pick_point(start=(1000.0 + x, 50.0, 500.0), along=(0.0, 0.0, -1.0), reach=3.0)
        assert found == {"FINISHED"}
    first, second = picking.PICKS
    assert np.linalg.norm(first.point.coordinate - (30.0, 50.0, 100.0)) < 3.0
    assert np.linalg.norm(second.point.coordinate - (130.0, 50.0, 100.0)) < 3.0
    assert {"intensity", "color"} <= set(first.point.attributes)
    apart = np.linalg.norm(first.point.coordinate - second.point.coordinate)
    assert picking.distance() == pytest.approx(apart, abs=1e-3)
    none = bpy.ops.pointsplat.pick_point(start=(0.0, 0.0, 500.0), along=(0.0, 0.0, 1.0), reach=3.0)
    assert none == {"CANCELLED"}


def test_the_points_of_a_hierarchy_close_their_surface_where_that_is_asked_for(tmp_path: Path) -> None:
    random = np.random.default_rng(6)
    points = np.zeros(3000, [("x", "f8"), ("y", "f8"), ("z", "f8")])
    points["x"], points["y"] = random.uniform(0, 200, (2, 3000))
    write_ply(tmp_path / "plane.ply", points, "binary_little_endian")
    build([tmp_path / "plane.ply"], tmp_path / "plane.psh", Settings(memory=1 << 30, workers=1), lambda *_: None)
    ob = link(tmp_path / "plane.psh")
    look_down()
    scene = bpy.context.scene
    scene.render.film_transparent = True
    scene.pointsplat.tolerance = 0.05
    covered = {}
    for shape in ("BALLS", "SURFACE"):
        ob.pointsplat.shape = shape
        assert report()["streamed"]["points"] == 3000
        scene.render.image_settings.file_format = "PNG"
        scene.render.image_settings.color_mode = "RGBA"
        scene.render.filepath = str(tmp_path / f"{shape}.png")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        covered[shape] = np.array(image.pixels[:]).reshape(32, 48, 4)[2:-2, 8:-8, 3].mean()
    assert covered["BALLS"] < 0.5 < 0.97 < covered["SURFACE"]


@pytest.mark.parametrize("shape", ["BALLS", "DISKS", "SURFACE"])
def test_points_of_additive_scans_are_disks_across_their_neighbours(folder: Path, shape: str) -> None:
    ob = link(folder / "ept.json")
    ob.pointsplat.shape = shape
    [geometry] = sync().geometries
    assert geometry.streamed is not None
    with open_pages(folder) as source:
        cloud = geometry.streamed.look.splats(source.read(0), True).cloud
    assert (cloud.normal is None) == (shape == "BALLS")
    if cloud.normal is not None:
        upright = (np.abs(cloud.normal - [0.0, 0.0, 1.0]) < 1e-3).all(axis=1)
        assert upright.mean() > 0.99  # measured 0.998: strays are balls, whose normals are zero
        assert not cloud.normal[~upright].any()


def test_files_are_built_and_linked(tmp_path):
    place = np.random.default_rng(5).random((COUNT, 3)) * [100, 80, 1]
    for i, part in enumerate(np.array_split(place, 2)):
        write_points(tmp_path / f"tile{i}.ply", part)
    names = [{"name": f"tile{i}.ply"} for i in range(2)]
    found = bpy.ops.pointsplat.build_scan(directory=str(tmp_path), files=names, normals=False)
    assert found == {"FINISHED"}
    assert not list(tmp_path.glob("*.building"))
    ob = bpy.context.object
    assert Path(ob.pointsplat.scan_path) == tmp_path / f"{tmp_path.name}.psh"
    with PshPages(tmp_path / f"{tmp_path.name}.psh") as pages:
        assert pages.directory.points == COUNT


def test_a_build_that_is_stopped_goes_on_where_it_was(tmp_path):
    write_points(tmp_path / "scan.ply", np.random.default_rng(6).random((COUNT, 3)))
    whole, other = tmp_path / "whole.psh", tmp_path / "other.psh"
    build([tmp_path / "scan.ply"], whole, Settings(1 << 30, workers=1), lambda stage, share: None)
    work = build_scan([tmp_path / "scan.ply"], other, False, ())
    next(work)
    work.close()
    for _ in build_scan([tmp_path / "scan.ply"], other, False, ()):
        pass
    assert other.read_bytes() == whole.read_bytes()


def test_what_cannot_be_built_is_told_and_makes_no_object(tmp_path):
    (tmp_path / "broken.las").write_bytes(b"LASF" + bytes(50))
    with pytest.raises(RuntimeError, match=r"broken\.las"):
        bpy.ops.pointsplat.build_scan(filepath=str(tmp_path / "broken.las"))
    assert not bpy.data.objects
