"""Filters and clip boxes of point clouds: which points are drawn, in which space, and what is said of bad ones."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false, reportOptionalSubscript=false
from math import radians

import bpy
import numpy as np
import pytest

from pointsplat_addon.host.convert import pointcloud as conversion
from pointsplat_addon.host.convert.selection.clip_boxes import within
from pointsplat_addon.host.geometry_cache import GeometryCache
from pointsplat_addon.host.sync import Synchronizer
from tests.support.blender.scenes import alpha, pointcloud

pytestmark = pytest.mark.usefixtures("empty_file")

COUNT = 400


@pytest.fixture
def scan():
    """A point cloud with the attributes that importers write, in a cube from -2 to 2."""
    random = np.random.default_rng(5)
    ob = pointcloud("Scan", random.uniform(-2, 2, (COUNT, 3)).astype(np.float32))
    for name, kind, values in (
        ("classification", "INT8", random.integers(0, 9, COUNT)),
        ("intensity", "INT", random.integers(0, 60_000, COUNT)),
        ("return_number", "INT8", random.integers(1, 5, COUNT)),
        ("gps_time", "FLOAT", random.uniform(0, 100, COUNT).astype(np.float32)),
        ("quality", "FLOAT", random.uniform(0, 1, COUNT).astype(np.float32)),
    ):
        ob.data.attributes.new(name, kind, "POINT").data.foreach_set("value", values)
    return ob


def column(ob, name):
    key, width = ("vector", 3) if name == "position" else ("value", 1)
    found = np.empty(len(ob.data.points) * width, np.float32)
    ob.data.attributes[name].data.foreach_get(key, found)
    return found.reshape(-1, width) if width > 1 else found


def new_filter(ob, kind, **settings):
    made = ob.pointsplat.filters.add()
    made.kind = kind
    for name, value in settings.items():
        setattr(made, name, value)
    return made


def state(sync=None):
    bpy.context.view_layer.update()
    return (sync or Synchronizer(GeometryCache())).scene(bpy.context.evaluated_depsgraph_get())


def drawn(sync=None):
    """Positions of the points that are drawn, in object space, of all geometries; () without any."""
    clouds = [g.cloud.position for g in state(sync).geometries]
    return np.concatenate(clouds) if clouds else np.empty((0, 3))


def assert_drawn(ob, mask):
    assert 0 < mask.sum() < COUNT  # the test says something
    np.testing.assert_array_equal(drawn(), column(ob, "position")[mask])


def box(name, collection, **settings):
    empty = bpy.data.objects.new(name, None)
    collection.objects.link(empty)
    for key, value in settings.items():
        setattr(empty, key, value)
    return empty


@pytest.fixture
def boxes(scan):
    found = bpy.data.collections.new("Boxes")
    bpy.context.scene.collection.children.link(found)
    scan.pointsplat.clip_boxes = found
    return found


# Filters


def test_without_filters_nothing_is_stored_and_nothing_computed(scan, monkeypatch):
    state()
    assert "filters" not in scan.keys()  # noqa: SIM118 (custom properties)
    assert len(scan.pointsplat.filters) == 0
    assert scan.pointsplat.clip_boxes is None
    monkeypatch.setattr("pointsplat_addon.host.geometries.kept_points", None)
    monkeypatch.setattr("pointsplat_addon.host.geometries.clipped", None)
    np.testing.assert_array_equal(drawn(), column(scan, "position"))


@pytest.mark.parametrize(
    ("kind", "attribute", "low", "high"),
    [
        ("INTENSITY", "intensity", 1000, 20_000),
        ("RETURN", "return_number", 2, 3),
        ("TIME", "gps_time", 10, 55),
        ("ATTRIBUTE", "quality", 0.25, 0.5),
    ],
)
@pytest.mark.parametrize("invert", [False, True])
def test_a_range_keeps_what_lies_within(scan, kind, attribute, low, high, invert):
    new_filter(scan, kind, attribute="quality", low=low, high=high, invert=invert)
    value = column(scan, attribute)
    assert_drawn(scan, ((value >= low) & (value <= high)) != invert)


def test_classes_are_a_set_of_numbers(scan):
    new_filter(scan, "CLASS", classes="2, 5 6")
    assert_drawn(scan, np.isin(column(scan, "classification"), (2, 5, 6)))
    scan.pointsplat.filters[0].classes = ""
    assert len(drawn()) == COUNT


def test_heights_are_those_of_the_map(scan):
    scan["pointsplat_origin"] = [5e6, 4e5, 300.0]
    new_filter(scan, "HEIGHT", low=299.5, high=300.75)
    height = column(scan, "position")[:, 2]
    assert_drawn(scan, (height >= -0.5) & (height <= 0.75))


def test_distances_are_those_to_the_scanner_that_saw_the_point(scan):
    new_filter(scan, "DISTANCE", low=0.5, high=2.0)
    position = column(scan, "position").astype(np.float64)
    distance = np.linalg.norm(position, axis=1)
    assert_drawn(scan, (distance >= 0.5) & (distance <= 2.0))
    station = np.arange(COUNT) % 2
    scan.data.attributes.new("station", "INT", "POINT").data.foreach_set("value", station)
    scan["pointsplat_stations"] = [2.0, 0.0, 0.0, -2.0, 0.0, 0.0]
    scan.update_tag()
    distance = np.linalg.norm(position - np.array([[2, 0, 0], [-2, 0, 0]])[station], axis=1)
    assert_drawn(scan, (distance >= 0.5) & (distance <= 2.0))


def test_all_filters_that_are_in_use_apply(scan):
    new_filter(scan, "CLASS", classes="2 3 4")
    second = new_filter(scan, "RETURN", low=1, high=2)
    new_filter(scan, "TIME", low=1e6, high=1e7, use=False)
    chosen = np.isin(column(scan, "classification"), (2, 3, 4))
    assert_drawn(scan, chosen & (column(scan, "return_number") <= 2))
    second.use = False
    assert_drawn(scan, chosen)


def test_attributes_of_the_points_that_are_left_stay_theirs(scan):
    radius = np.linspace(0.01, 0.2, COUNT, dtype=np.float32)
    if "radius" not in scan.data.attributes:
        scan.data.attributes.new("radius", "FLOAT", "POINT")
    scan.data.attributes["radius"].data.foreach_set("value", radius)
    color = np.random.default_rng(1).random((COUNT, 4)).astype(np.float32)
    color[:, 3] = 1
    scan.data.attributes.new("Col", "FLOAT_COLOR", "POINT").data.foreach_set("color", color.ravel())
    new_filter(scan, "RETURN", low=1, high=2)
    mask = column(scan, "return_number") <= 2
    (geometry,) = state().geometries
    np.testing.assert_array_equal(geometry.cloud.radii[:, 0], radius[mask])
    np.testing.assert_array_equal(geometry.cloud.color, color[mask, :3])


def test_values_that_are_no_numbers_are_hidden_by_a_filter_and_by_its_inverse(scan):
    value = column(scan, "quality")
    value[::3] = np.nan
    scan.data.attributes["quality"].data.foreach_set("value", value)
    made = new_filter(scan, "ATTRIBUTE", attribute="quality", low=0, high=0.5)
    assert_drawn(scan, value <= 0.5)
    made.invert = True
    assert_drawn(scan, value > 0.5)


def test_a_filter_that_hides_all_points_leaves_nothing(scan):
    new_filter(scan, "TIME", low=1e6, high=1e7)
    assert len(state().geometries) == 0


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        ("ATTRIBUTE", {"attribute": "missing"}, 'Scan: There is no attribute "missing" to filter by'),
        ("ATTRIBUTE", {}, "Scan: The filter by attribute names none"),
        ("CLASS", {"classes": "two"}, 'Scan: Classes are numbers such as 2, 6; "two" has something else'),
    ],
)
def test_a_filter_that_cannot_be_is_named_once_and_all_points_are_drawn(scan, kind, settings, message):
    new_filter(scan, kind, **settings)
    new_filter(scan, kind, **settings)
    found = state()
    assert found.warnings == (f"{message}: this filter is left out",)
    assert len(found.geometries[0].cloud) == COUNT


def test_a_class_filter_of_a_cloud_without_classes_is_named():
    pointcloud("Plain", [(0, 0, 0), (1, 0, 0)])
    new_filter(bpy.context.object, "CLASS", classes="2")
    found = state()
    assert found.warnings == ('Plain: There is no attribute "classification" to filter by: this filter is left out',)
    assert len(found.geometries[0].cloud) == 2


def test_operators_add_fit_and_remove_filters(scan):
    assert bpy.ops.pointsplat.add_point_filter(kind="INTENSITY") == {"FINISHED"}
    assert len(drawn()) == COUNT  # at first all points lie in the range
    made = scan.pointsplat.filters[0]
    intensity = column(scan, "intensity")
    assert (made.low, made.high) == (intensity.min(), intensity.max())
    made.high = 5
    assert bpy.ops.pointsplat.fit_point_filter(index=0) == {"FINISHED"}
    assert made.high == intensity.max()
    scan["pointsplat_origin"] = [5e6, 4e5, 123.456]
    bpy.ops.pointsplat.add_point_filter(kind="HEIGHT")
    bpy.ops.pointsplat.add_point_filter(kind="DISTANCE")
    assert len(drawn()) == COUNT
    with pytest.raises(RuntimeError, match="Scan has 3 filters"):
        bpy.ops.pointsplat.remove_point_filter(index=3)
    assert bpy.ops.pointsplat.remove_point_filter(index=0) == {"FINISHED"}
    assert [f.kind for f in scan.pointsplat.filters] == ["HEIGHT", "DISTANCE"]


def test_what_operators_change_is_told_to_the_dependency_graph(scan):
    """Or a viewport would not draw it."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    told = []

    def listen(_scene, graph):
        told.extend(update.id.name for update in graph.updates)

    bpy.app.handlers.depsgraph_update_post.append(listen)
    try:
        for change in (
            lambda: bpy.ops.pointsplat.add_point_filter(kind="RETURN"),
            lambda: setattr(scan.pointsplat.filters[0], "high", 2),
            lambda: bpy.ops.pointsplat.remove_point_filter(index=0),
            lambda: setattr(scan.pointsplat, "clip_boxes", bpy.data.collections.new("Boxes")),
            lambda: setattr(scan.pointsplat, "clip_keep", "OUTSIDE"),
        ):
            told.clear()
            change()
            depsgraph.update()
            assert "Scan" in told
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(listen)


def test_undo_takes_a_filter_back(scan):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.pointsplat.add_point_filter(kind="CLASS")
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert len(bpy.data.objects["Scan"].pointsplat.filters) == 0
    bpy.ops.ed.redo()
    assert [f.kind for f in bpy.data.objects["Scan"].pointsplat.filters] == ["CLASS"]


def test_filters_and_boxes_survive_saving(scan, boxes, tmp_path):
    new_filter(scan, "CLASS", classes="2, 6")
    box("Box", boxes)
    before = drawn()
    assert 0 < len(before) < COUNT
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    np.testing.assert_array_equal(drawn(), before)


# Clip boxes


def inside(position, world_from_object, world_from_box):
    """The truth, in float64: points (N, 3) in a cube from -1 to 1."""
    points = np.concatenate([position.astype(np.float64), np.ones((len(position), 1))], axis=1)
    in_box = points @ (np.linalg.inv(world_from_box) @ world_from_object).T
    return (np.abs(in_box[:, :3]) <= 1).all(axis=1)


def test_a_box_is_the_cube_that_blender_draws(scan, boxes):
    empty = box("Box", boxes, empty_display_size=0.5, location=(0.3, -0.2, 0.1), scale=(2, 1, 3))
    empty.rotation_euler = radians(20), radians(35), radians(50)
    scan.location = 0.1, 0.2, 0.3
    scan.rotation_euler = 0, 0, radians(30)
    bpy.context.view_layer.update()
    cube = np.array(empty.matrix_world) @ np.diag([0.5, 0.5, 0.5, 1])
    mask = inside(column(scan, "position"), np.array(scan.matrix_world), cube)
    assert_drawn(scan, mask)
    scan.pointsplat.clip_keep = "OUTSIDE"
    assert_drawn(scan, ~mask)


def test_several_boxes_are_one_shape(scan, boxes):
    for name, x in (("A", -1.0), ("B", 1.0)):
        box(name, boxes, location=(x, 0, 0))
    box("Elsewhere", boxes, location=(50, 0, 0))
    bpy.context.view_layer.update()
    x, y, z = column(scan, "position").T
    assert_drawn(scan, (abs(x) <= 2) & (abs(y) <= 1) & (abs(z) <= 1))


def test_boxes_that_move_clip_anew_and_the_cloud_is_not_made_again(scan, boxes, monkeypatch):
    empty = box("Box", boxes)
    made = []
    make = conversion._make_cloud
    monkeypatch.setattr(conversion, "_make_cloud", lambda *given: made.append(1) or make(*given))
    sync = Synchronizer(GeometryCache())
    first = drawn(sync)
    empty.location.x = 1
    second = drawn(sync)
    x, y, z = column(scan, "position").T
    np.testing.assert_array_equal(second, column(scan, "position")[(x >= 0) & (x <= 2) & (abs(y) <= 1) & (abs(z) <= 1)])
    assert len(first) != len(second)
    empty.location.x = 0
    np.testing.assert_array_equal(drawn(sync), first)
    assert made == [1]


def test_boxes_follow_their_animation_and_are_where_they_were_if_hidden(scan, boxes):
    empty = box("Box", boxes)
    empty.keyframe_insert("location", frame=1)
    empty.location.x = 1.5
    empty.keyframe_insert("location", frame=11)
    x, y, z = column(scan, "position").T
    for frame, centre in ((11, 1.5), (1, 0)):
        bpy.context.scene.frame_set(frame)
        assert_drawn(scan, (abs(x - centre) <= 1) & (abs(y) <= 1) & (abs(z) <= 1))
    empty.hide_viewport = True
    assert_drawn(scan, (abs(x) <= 1) & (abs(y) <= 1) & (abs(z) <= 1))


def test_instances_of_a_cloud_are_clipped_where_they_are(scan, boxes):
    box("Box", boxes)
    group = bpy.data.collections.new("Group")
    group.objects.link(scan)
    for number, x in enumerate((0.0, 1.5)):
        instance = bpy.data.objects.new(f"Instance {number}", None)
        instance.instance_type, instance.instance_collection = "COLLECTION", group
        instance.location.x = x
        bpy.context.scene.collection.objects.link(instance)
    bpy.context.scene.collection.objects.unlink(scan)
    found = state()
    x, y, z = column(scan, "position").T
    yz = (abs(y) <= 1) & (abs(z) <= 1)
    counts = sorted(len(found.geometries[g].cloud) for g in found.instances.geometry)
    assert counts == sorted([(yz & (abs(x) <= 1)).sum(), (yz & (abs(x + 1.5) <= 1)).sum()])


def test_bad_boxes_are_named_and_left_out(scan, boxes):
    found = state()
    assert found.warnings == ('Scan: The collection "Boxes" of its clip boxes has no empties',)
    assert len(found.geometries[0].cloud) == COUNT
    box("Flat", boxes, scale=(1, 0, 1))
    found = state()
    assert found.warnings == ('Scan: The clip box "Flat" has no volume and is left out',)
    assert len(found.geometries[0].cloud) == COUNT
    box("Far", boxes, location=(100, 0, 0))
    assert len(state().geometries) == 0


def test_points_that_are_no_numbers_lie_in_no_box():
    position = np.array([[0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]], np.float32)
    np.testing.assert_array_equal(within(position, np.eye(4)[None]), [True, False, False])


def test_neighbours_that_a_box_hides_still_shape_a_surface(scan, boxes):
    scan.pointsplat.shape = "SURFACE"
    boxes_of_scan, scan.pointsplat.clip_boxes = scan.pointsplat.clip_boxes, None
    (whole,) = state().geometries
    scan.pointsplat.clip_boxes = boxes_of_scan
    box("Box", boxes)
    (part,) = state().geometries
    rows = (np.abs(whole.cloud.position) <= 1).all(axis=1)
    np.testing.assert_array_equal(part.cloud.radii, whole.cloud.radii[rows])


def test_pictures_show_what_the_boxes_keep(scan, boxes, tmp_path):
    """A cloud of balls fills the view; a box that reaches to x = 0 leaves the left half, in frame 2 the right one."""
    scene = bpy.context.scene
    scan.pointsplat.radius = 0.3
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0, 0, 10)
    scene.collection.objects.link(camera)
    scene.camera = camera
    empty = box("Box", boxes, scale=(2, 4, 4), location=(-2, 0, 0), hide_render=False)
    empty.keyframe_insert("location", frame=1)
    empty.location.x = 2
    empty.keyframe_insert("location", frame=2)
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = 32
    scene.render.image_settings.file_format = "OPEN_EXR"
    for frame, full in ((1, slice(0, 16)), (2, slice(16, 32))):
        scene.frame_set(frame)
        found = alpha(scene, tmp_path, "POINTSPLAT")
        assert found[:, full].mean() > 0.95
        assert found.mean() < 0.75
