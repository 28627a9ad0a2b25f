"""Captured splats imported and exported by the operators, and read from objects for pictures."""

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.host.splats.importing import import_files
from pointsplat_addon.host.splats.pictures import read_picture
from pointsplat_addon.host.ui import panels
from tests.support import splat_files as files
from tests.support.blender.scenes import pointcloud, sync

pytestmark = pytest.mark.usefixtures("empty_file")
WIDTHS = {
    "FLOAT_VECTOR": (3, "vector"),
    "QUATERNION": (4, "value"),
    "FLOAT_COLOR": (4, "color"),
    "FLOAT4": (4, "vector"),
}
FOUR = "FLOAT4" if "FLOAT4" in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items else "FLOAT_COLOR"


def value(ob, name):
    attribute = ob.data.attributes[name]
    width, key = WIDTHS[attribute.data_type]
    found = np.empty(width * len(attribute.data), np.float32)
    attribute.data.foreach_get(key, found)
    return found.reshape(-1, width)


def splat_file(path, count=300, coefficients=8, **changes) -> Any:
    columns = {**files.splat_columns(count, coefficients), **changes}
    files.write_splat_ply(path, columns)
    with open_splats(path) as reader:
        return files.read_all(reader)


def imported(path, **options):
    assert bpy.ops.pointsplat.import_splats(filepath=str(path), **options) == {"FINISHED"}
    return bpy.context.object


def test_splats_have_the_attributes_of_blender_5_3(tmp_path):
    given = splat_file(tmp_path / "a.ply")
    ob = imported(tmp_path / "a.ply")
    assert (ob.type, ob.name, len(ob.data.points)) == ("POINTCLOUD", "a", 300)
    kinds = {a.name: (a.data_type, a.domain) for a in ob.data.attributes if not a.name.startswith(".")}
    harmonics = {f"radiance:sh_{i}": "FLOAT_VECTOR" for i in range(8)}
    expected = {"position": "FLOAT_VECTOR", "scale": "FLOAT_VECTOR", "rotation": "QUATERNION",
                "radiance:base": FOUR, **harmonics}  # fmt: skip
    assert kinds == {name: (kind, "POINT") for name, kind in expected.items()}
    for name in ("position", "scale", "rotation"):
        np.testing.assert_array_equal(value(ob, name), getattr(given, name))
    np.testing.assert_array_equal(value(ob, "radiance:base")[:, :3], given.base)
    np.testing.assert_array_equal(value(ob, "radiance:base")[:, 3], given.opacity)
    for i in range(8):
        np.testing.assert_array_equal(value(ob, f"radiance:sh_{i}"), given.sh[:, i])
    assert "pointsplat_antialiased" not in ob


def test_blender_knows_the_bounds(tmp_path):
    """Frame Selected asks them; Blender 4.5 adds no default radius."""
    given = splat_file(tmp_path / "a.ply")
    found = np.array(imported(tmp_path / "a.ply").bound_box)
    low, high = given.position.min(axis=0), given.position.max(axis=0)
    for of_box, of_points, outwards in ((found.min(axis=0), low, -1), (found.max(axis=0), high, 1)):
        beyond = outwards * (of_box - of_points)
        assert beyond.min() > -1e-6  # measured -2e-8
        assert beyond.max() < 0.01 + 1e-6


def test_the_object_is_turned_so_that_up_is_up(tmp_path):
    splat_file(tmp_path / "a.ply")
    up = {"AUTO": (0, -1, 0), "RDF": (0, -1, 0), "RUB": (0, 1, 0), "RFU": (0, 0, 1)}
    for axes, direction in up.items():
        ob = imported(tmp_path / "a.ply", axes=axes)
        bpy.context.view_layer.update()
        found = np.array(ob.matrix_world)[:3, :3] @ direction
        np.testing.assert_allclose(found, [0, 0, 1], atol=1e-6)


def test_the_object_becomes_captured_splats_of_the_scene(tmp_path):
    given = splat_file(tmp_path / "a.ply")
    imported(tmp_path / "a.ply")
    [geometry] = sync().geometries
    assert geometry.cloud is None
    for name in ("position", "scale", "rotation", "base", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(geometry.captured, name), getattr(given, name))
    assert not geometry.captured.antialiased


def test_the_key_is_that_of_the_content(tmp_path):
    splat_file(tmp_path / "a.ply")
    first, second = (imported(tmp_path / "a.ply") for _ in range(2))
    same = sync()
    assert same.geometries[0].captured is same.geometries[-1].captured
    second["pointsplat_antialiased"] = True
    first.data.attributes["radiance:sh_7"].data[0].vector = (9, 9, 9)
    first.data.update_tag()
    changed = [g.captured for g in sync().geometries]
    assert [splats.antialiased for splats in changed] == [False, True]
    assert changed[0].sh[0, 7].tolist() == [9, 9, 9]


def test_training_for_antialiasing_is_kept(tmp_path):
    files.write_splat_ply(tmp_path / "a.ply", files.splat_columns(20), comments=("SplatRenderMode: mip",))
    ob = imported(tmp_path / "a.ply")
    assert ob["pointsplat_antialiased"]
    assert sync().geometries[0].captured.antialiased


def test_several_files_are_several_objects(tmp_path):
    splat_file(tmp_path / "a.ply")
    splat_file(tmp_path / "b.ply", 70, 0)
    names = [{"name": "a.ply"}, {"name": "b.ply"}]
    assert bpy.ops.pointsplat.import_splats(directory=str(tmp_path), files=names) == {"FINISHED"}
    assert sorted(len(ob.data.points) for ob in bpy.context.selected_objects) == [70, 300]


def test_what_cannot_be_drawn_is_left_out_and_said(tmp_path, capfd):
    opacity = [math.nan, -math.inf, math.inf, *[0.0] * 297]
    given = splat_file(tmp_path / "a.ply", opacity=opacity)
    ob = imported(tmp_path / "a.ply")
    assert len(ob.data.points) == 298
    np.testing.assert_array_equal(value(ob, "position"), given.position)
    assert value(ob, "radiance:base")[0, 3] == 1
    assert "a.ply: 2 splats with values that are no numbers are left out" in capfd.readouterr().out
    assert len(bpy.data.pointclouds) == 1


def test_what_is_refused_is_named_and_leaves_nothing(tmp_path):
    (tmp_path / "scan.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n")
    (tmp_path / "empty.splat").write_bytes(b"")
    data = (tmp_path / "whole.ply", splat_file(tmp_path / "whole.ply"))[0].read_bytes()
    (tmp_path / "cut.ply").write_bytes(data[:-5])
    splat_file(tmp_path / "nan.ply", 2, opacity=[math.nan] * 2)
    for name, what in {"scan.ply": "have no y, z, f_dc_0", "empty.splat": "no splats", "cut.ply": "ends after 299",
                       "nan.ply": "no splats that can be drawn", "none.spz": "none.spz"}.items():  # fmt: skip
        with pytest.raises(RuntimeError, match=what):
            bpy.ops.pointsplat.import_splats(directory=str(tmp_path), files=[{"name": "whole.ply"}, {"name": name}])
    assert (len(bpy.data.objects), len(bpy.data.pointclouds), len(bpy.data.meshes)) == (0, 0, 0)
    with pytest.raises(RuntimeError, match=r"whole\.ply: holds captured Gaussian splats, not a scan"):
        bpy.ops.pointsplat.import_points(filepath=str(tmp_path / "whole.ply"))


def test_an_import_that_is_closed_leaves_nothing(tmp_path):
    splat_file(tmp_path / "a.ply")
    work = import_files(bpy.context, [tmp_path / "a.ply"])
    next(work)
    work.close()
    assert len(bpy.data.objects) == len(bpy.data.pointclouds) == 0


def test_blenders_reader_of_pictures_gives_their_bytes():
    random = np.random.default_rng(0)
    pixels = random.integers(256, size=(12, 4)).tolist()
    data = files.webp(pixels, 4)
    np.testing.assert_array_equal(read_picture(data, "a.webp").reshape(-1, 4), pixels)
    assert read_picture(b"no picture", "b.webp").shape == (0, 0, 4)
    assert len(bpy.data.images) == 0


@pytest.mark.parametrize("name", ["a.sog", "folder"])
def test_sog_is_read_through_blenders_pictures(tmp_path, name):
    files.write_sog(tmp_path / name, files.sog_files(30))
    path = tmp_path / name if name == "a.sog" else tmp_path / name / "meta.json"
    ob = imported(path)
    with open_splats(path, files.read_picture) as reader:
        given: Any = files.read_all(reader)
    np.testing.assert_array_equal(value(ob, "position"), given.position)
    np.testing.assert_array_equal(value(ob, "radiance:sh_2"), given.sh[:, 2])
    assert ob.name == ("a" if name == "a.sog" else "folder")


def test_levels_of_streamed_sets_are_chosen(tmp_path):
    for name, count in (("0_0", 6), ("1_0", 3)):
        files.write_sog(tmp_path / name, files.sog_files(count))
    lods = {str(i): {"file": i, "offset": 0, "count": count} for i, count in enumerate((6, 3))}
    meta = {"lodLevels": 2, "filenames": ["0_0/meta.json", "1_0/meta.json"], "tree": {"lods": lods}}
    (tmp_path / "lod-meta.json").write_text(json.dumps(meta))
    for level, count in enumerate((6, 3)):
        assert len(imported(tmp_path / "lod-meta.json", level=level).data.points) == count


# Objects of other makers


def made_by_hand(count=5):
    """A splat object whose attributes a person made."""
    ob = pointcloud("Made", [(i, 0, 0) for i in range(count)])
    for name, kind, key, one in (("scale", "FLOAT_VECTOR", "vector", [0.1, 0.2, 0.3]),
                                 ("rotation", "QUATERNION", "value", [1, 0, 0, 0]),
                                 ("radiance:base", "FLOAT_COLOR", "color", [0.5, 0, -0.5, 2])):  # fmt: skip
        ob.data.attributes.new(name, kind, "POINT").data.foreach_set(key, one * count)
    return ob


def test_any_cloud_with_the_three_attributes_is_captured():
    ob = made_by_hand()
    captured = sync().geometries[0].captured
    assert captured.opacity.tolist() == [1] * 5  # of 2
    assert captured.sh is None
    ob.data.attributes.remove(ob.data.attributes["scale"])
    assert sync().geometries[0].captured is None
    assert sync().geometries[0].cloud is not None


def test_harmonics_of_no_whole_degree_are_left_out_and_said():
    ob = made_by_hand()
    for i in range(4):
        ob.data.attributes.new(f"radiance:sh_{i}", "FLOAT_VECTOR", "POINT")
    scene = sync()
    assert scene.geometries[0].captured.sh.shape == (5, 3, 3)
    assert any("Made: 1 of the 4 attributes radiance:sh_*" in warning for warning in scene.warnings)


def test_filters_and_clip_boxes_cut_splats():
    ob = made_by_hand()
    one = ob.pointsplat.filters.add()
    one.kind, one.attribute, one.low, one.high = "ATTRIBUTE", "position", 0.5, 3.5
    assert sync().geometries[0].captured.position[:, 0].tolist() == [1, 2, 3]
    box = bpy.data.objects.new("Box", None)
    box.location, box.empty_display_size = (0, 0, 0), 2.5
    collection = bpy.data.collections.new("Boxes")
    collection.objects.link(box)
    bpy.context.scene.collection.children.link(collection)
    ob.pointsplat.clip_boxes = collection
    assert sync().geometries[0].captured.position[:, 0].tolist() == [1, 2]


# Export


def exported(path, **options) -> Any:
    assert bpy.ops.pointsplat.export_splats(filepath=str(path), **options) == {"FINISHED"}
    with open_splats(path) as reader:
        return files.read_all(reader)


def test_ply_comes_back_as_it_was(tmp_path):
    given = splat_file(tmp_path / "a.ply")
    imported(tmp_path / "a.ply")
    found = exported(tmp_path / "b.ply")
    for name in ("position", "base", "sh"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    for name in ("scale", "rotation", "opacity"):
        np.testing.assert_allclose(getattr(found, name), getattr(given, name), rtol=2e-6)  # measured 4.2e-7


@pytest.mark.parametrize(("kind", "version"), [("SPZ", 3), ("SPZ4", 4)])
def test_spz_has_its_own_axes(tmp_path, kind, version):
    given = splat_file(tmp_path / "a.ply")
    imported(tmp_path / "a.ply")
    found = exported(tmp_path / "b.spz", file_format=kind)
    np.testing.assert_allclose(found.position, given.position * [1, -1, -1], atol=1e-5)  # measured 7.6e-6: 2^-17
    # Of degree 1, -y, z and -x: what was y and z changes its sign.
    np.testing.assert_allclose(found.sh[:, :3], given.sh[:, :3].clip(-1, 127 / 128) * [[-1], [-1], [1]], atol=0.012)
    with open_splats(tmp_path / "b.spz") as reader:
        assert reader.header.format == f"SPZ {version}"
    ob = imported(tmp_path / "b.spz")
    bpy.context.view_layer.update()
    world = value(ob, "position") @ np.array(ob.matrix_world)[:3, :3].T
    np.testing.assert_allclose(world, given.position[:, [0, 2, 1]] * [1, 1, -1], atol=1e-5)


def test_objects_are_written_where_they_are_and_together(tmp_path):
    first = made_by_hand(2)
    first.scale, first.location = (2, 2, 2), (0, 0, 10)
    second = made_by_hand(3)
    second.data.attributes.new("radiance:sh_0", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", [1.0] * 9)
    for i in (1, 2):
        second.data.attributes.new(f"radiance:sh_{i}", "FLOAT_VECTOR", "POINT")
    for ob in (first, second):
        ob.select_set(True)
    found = exported(tmp_path / "b.ply")
    assert len(found) == 5
    order = np.argsort(found.position[:, 1], kind="stable")  # Y down: the moved object comes first
    np.testing.assert_allclose(found.position[order[:2]], [[0, -10, 0], [2, -10, 0]], atol=1e-5)
    np.testing.assert_allclose(found.scale[order[0]], [0.2, 0.4, 0.6], rtol=1e-5)
    assert not found.sh[order[:2]].any()
    np.testing.assert_allclose(np.abs(found.sh[order[2:]]).sum(axis=1), 1, atol=1e-5)


def test_exports_without_splats_are_refused(tmp_path):
    pointcloud("Scan", [(0, 0, 0)])
    with pytest.raises(RuntimeError, match="No object that is selected holds captured splats"):
        bpy.ops.pointsplat.export_splats(filepath=str(tmp_path / "a.ply"))
    assert list(tmp_path.iterdir()) == []


def test_splats_survive_saving(tmp_path):
    given = splat_file(tmp_path / "a.ply")
    imported(tmp_path / "a.ply")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    ob = bpy.data.objects["a"]
    np.testing.assert_array_equal(value(ob, "rotation"), given.rotation)
    np.testing.assert_array_equal(value(ob, "radiance:sh_3"), given.sh[:, 3])


def test_lighting_is_read_and_makes_other_geometry(tmp_path):
    splat_file(tmp_path / "a.ply")
    ob = imported(tmp_path / "a.ply")
    keys = set()
    for lighting in ("CAPTURED", "SHADOWED", "RELIT"):
        ob.pointsplat.lighting = lighting
        (geometry,) = sync().geometries
        assert geometry.lighting == lighting
        keys.add(geometry.key)
    assert len(keys) == 3


def test_the_panel_shows_what_captured_splats_have(tmp_path):
    """And not the shape, radius and extinction of points; a point cloud has these."""
    splat_file(tmp_path / "a.ply")
    assert drawn(imported(tmp_path / "a.ply")) == ["lighting", "visible_camera", "visible_shadow"]
    assert {"shape", "radius", "extinction"} < set(drawn(pointcloud("Scan", [(0, 0, 0)])))
    assert "lighting" not in drawn(bpy.context.object)


def test_a_shadow_catcher_stands_for_captured_surfaces():
    bpy.ops.mesh.primitive_cube_add()
    ob = bpy.context.object
    ob.data.materials.append(bpy.data.materials.new("Glass"))
    assert sync().instances.matte is None
    assert "is_shadow_catcher" in drawn(ob)
    ob.is_shadow_catcher = True
    ob.pointsplat.primitive = "POINTS"
    scene = sync()
    np.testing.assert_array_equal(scene.instances.matte, [True])
    (geometry,) = scene.geometries
    # The light that it sends has its own colour.
    assert (geometry.primitive, geometry.mesh.materials) == ("POLYGONS", (1,))


def drawn(ob) -> list[str]:
    """Names of the properties that the object panel shows."""
    found: list[str] = []

    class Layout:
        def __getattr__(self, name):
            return (lambda *_, **__: self) if name != "prop" else (lambda _, shown, **__: found.append(shown))

    context = SimpleNamespace(object=ob)
    panel: Any = SimpleNamespace(layout=Layout(), split_layout=Layout)
    panel._visibility = lambda *given: panels.POINTSPLAT_OBJECT_PT_pointsplat._visibility(panel, *given)
    panels.POINTSPLAT_OBJECT_PT_pointsplat.draw(panel, context)
    return found
