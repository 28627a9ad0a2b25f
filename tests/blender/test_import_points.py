"""Scans imported by the operator: objects, attributes, where they lie on the map, looks, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import pointsplat_addon
from pointsplat_addon.formats.points.gather import Selection
from pointsplat_addon.host.scans import looks
from pointsplat_addon.host.scans.importing import import_scan
from pointsplat_addon.host.ui.views import reach
from tests.support.blender.scenes import pointcloud, sync
from tests.support.scan_files import write_ept, write_ply

FAR = np.array([5_000_123.0, 400_456.0, 100.0])


@pytest.fixture(autouse=True)
def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    yield
    pointsplat_addon.unregister()


def scan_file(path, count=500, far=FAR):
    random = np.random.default_rng(count)
    found = np.zeros(count, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
                             ("intensity", "u2"), ("classification", "u1"), ("quality", "f4")])  # fmt: skip
    for axis, offset in zip("xyz", far, strict=True):
        found[axis] = offset + random.uniform(-50, 50, count)
    for name in ("red", "green", "blue", "intensity", "classification", "quality"):
        found[name] = random.integers(1, 200, count)
    write_ply(path, found, "binary_little_endian")
    return found


def positions(ob):
    found = np.empty(3 * len(ob.data.points), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", found)
    return found.reshape(-1, 3)


def test_a_scan_becomes_a_point_cloud_with_its_attributes(tmp_path):
    given = scan_file(tmp_path / "a.ply")
    assert bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "a.ply")) == {"FINISHED"}
    ob = bpy.context.object
    assert (ob.type, len(ob.data.points), ob.pointsplat.shape) == ("POINTCLOUD", 500, "SURFACE")
    kinds = {a.name: a.data_type for a in ob.data.attributes}
    assert kinds["Col"] == "BYTE_COLOR"
    assert kinds["intensity"] == "INT"
    assert kinds["quality"] == "FLOAT"
    color = np.array([item.color_srgb[:3] for item in ob.data.attributes["Col"].data])
    expected = np.stack([given[name] for name in ("red", "green", "blue")], axis=1) / 255
    np.testing.assert_allclose(color, expected, atol=1e-6)
    radius = np.array([item.value for item in ob.data.attributes["radius"].data])
    assert radius[0] > 0
    assert (radius == radius[0]).all()


def test_octrees_are_called_as_their_folder(tmp_path):
    (tmp_path / "Église").mkdir()
    write_ept(tmp_path / "Église", {"0-0-0-0": np.arange(30).reshape(10, 3)}, "binary")
    bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "Église" / "ept.json"))
    assert bpy.context.object.name == "Église"


def test_views_reach_as_far_as_what_is_imported(tmp_path):
    class Space:
        type = "VIEW_3D"

        def __init__(self, clip_end):
            self.clip_end = clip_end

    near, far, other = Space(1000.0), Space(1e6), Space(5.0)
    other.type = "OUTLINER"
    area = SimpleNamespace(spaces=[near, far, other])
    window = SimpleNamespace(screen=SimpleNamespace(areas=[area]))
    context = SimpleNamespace(window_manager=SimpleNamespace(windows=[window]))
    ob = pointcloud("far", [[0.0, 0.0, 0.0], [3000.0, 4000.0, 0.0]], radius=("FLOAT", "value", [0.0, 0.0]))
    reach(context, [ob])
    assert near.clip_end == pytest.approx(4 * 5000)
    assert (far.clip_end, other.clip_end) == (1e6, 5.0)
    reach(context, [])
    assert near.clip_end == pytest.approx(4 * 5000)


def test_map_coordinates_come_back_to_a_millimetre(tmp_path):
    given = scan_file(tmp_path / "a.ply")
    bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "a.ply"))
    ob = bpy.context.object
    found = positions(ob).astype(np.float64) + np.array(ob["pointsplat_origin"])
    expected = np.stack([given[axis] for axis in "xyz"], axis=1)
    assert np.abs(found - expected).max() < 3.1e-5  # measured 3.0e-5: half a unit in the last place of 500 m


def test_scans_of_one_scene_share_its_origin(tmp_path):
    scan_file(tmp_path / "a.ply")
    scan_file(tmp_path / "b.ply", 300, FAR + np.array([7_000, -2_000, 0]))
    scan_file(tmp_path / "local.ply", 200, np.zeros(3))
    objects = []
    for name in ("a", "b", "local"):
        bpy.ops.pointsplat.import_points(filepath=str(tmp_path / f"{name}.ply"))
        objects.append(bpy.context.object)
    scene = bpy.context.scene
    shared = np.array([scene["crs x"], scene["crs y"]])
    for ob in objects[:2]:
        np.testing.assert_array_equal(shared + ob.location[:2], np.array(ob["pointsplat_origin"])[:2])
    assert tuple(objects[2].location) == (0, 0, 0)  # coordinates near zero are no map's


def test_several_files_become_one_object(tmp_path):
    scan_file(tmp_path / "a.ply")
    scan_file(tmp_path / "b.ply", 300)
    files = [{"name": "a.ply"}, {"name": "b.ply"}]
    bpy.ops.pointsplat.import_points(directory=str(tmp_path), files=files)
    assert len(bpy.context.object.data.points) == 800


def test_points_are_chosen(tmp_path):
    given = scan_file(tmp_path / "a.ply")
    bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "a.ply"), classes="2, 6, 7", attributes="NONE")
    ob = bpy.context.object
    assert len(ob.data.points) == np.isin(given["classification"], (2, 6, 7)).sum()
    assert "Col" not in ob.data.attributes


@pytest.mark.parametrize("look", [key for key in looks.LOOKS if key not in ("RETURN", "TIME", "SOURCE", "ATTRIBUTE")])
def test_looks_are_materials_of_attributes(tmp_path, look):
    scan_file(tmp_path / "a.ply")
    bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "a.ply"))
    assert bpy.ops.pointsplat.scan_look(look=look) == {"FINISHED"}
    [material] = bpy.context.object.data.materials
    names = [node.attribute_name for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeAttribute"]
    own = looks.LOOKS[look][0]
    assert names == ([] if own is None else [own])


@pytest.mark.parametrize(("kind", "values"), [("INT8", (2, 6)), ("BOOLEAN", (False, True)), ("INT", (2, 300))])
def test_looks_show_attributes_of_small_integers(kind, values):
    ob = pointcloud("Scan", [(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    ob.data.attributes.new("number", kind, "POINT").data.foreach_set("value", [values[0], values[1], values[0]])
    assert bpy.ops.pointsplat.scan_look(look="ATTRIBUTE", attribute="number") == {"FINISHED"}
    color = sync().geometries[0].cloud.color
    np.testing.assert_array_equal(color[0], color[2])
    assert np.abs(color[0] - color[1]).max() > 0.1


def test_what_is_refused_is_named_and_leaves_nothing(tmp_path):
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 5\nend_header\n")
    before = len(bpy.data.objects), len(bpy.data.pointclouds), len(bpy.data.meshes)
    with pytest.raises(RuntimeError, match=r"broken\.ply: has no columns x, y and z"):
        bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "broken.ply"))
    with pytest.raises(RuntimeError, match=r"missing\.ply"):
        bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "missing.ply"))
    assert (len(bpy.data.objects), len(bpy.data.pointclouds), len(bpy.data.meshes)) == before


def test_files_of_different_reference_systems_are_named(tmp_path):
    laspy = pytest.importorskip("laspy", reason="it comes with the extension")
    for name, system in (("a", "RGF93 / Lambert-93"), ("b", "WGS 84 / UTM zone 31N"), ("c", "RGF93 / Lambert-93")):
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.x, las.y, las.z = np.arange(9.0).reshape(3, 3)
        las.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", f'PROJCS["{system}"]\0'.encode()))
        las.write(str(tmp_path / f"{name}.las"))

    def warnings_of(names):
        work = import_scan(bpy.context, [tmp_path / f"{name}.las" for name in names], Selection())
        while True:
            try:
                next(work)
            except StopIteration as done:
                return done.value[1]

    [warning] = warnings_of("abc")
    assert warning == (
        "The files have different coordinate reference systems "
        '(a.las: PROJCS["RGF93 / Lambert-93"]; b.las: PROJCS["WGS 84 / UTM zone 31N"])'
    )
    assert warnings_of("ac") == []


def test_an_import_that_is_closed_leaves_nothing(tmp_path):
    scan_file(tmp_path / "a.ply")
    work = import_scan(bpy.context, [tmp_path / "a.ply"], Selection())
    next(work)
    work.close()
    assert len(bpy.data.objects) == 0
    assert len(bpy.data.pointclouds) == 0


def test_a_scan_survives_saving(tmp_path):
    scan_file(tmp_path / "a.ply")
    bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "a.ply"))
    origin, first = list(bpy.context.object["pointsplat_origin"]), positions(bpy.context.object)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    ob = bpy.data.objects["a"]
    assert list(ob["pointsplat_origin"]) == origin
    np.testing.assert_array_equal(positions(ob), first)
