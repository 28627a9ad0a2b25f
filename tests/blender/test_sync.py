"""From a dependency graph to a scene: counts, positions, materials, instances, visibility, and what is reused."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from pointsplat_addon.core.numeric.cryptomatte import cryptomatte_hash
from tests.support.blender.scenes import mesh_object, pointcloud, sync

pytestmark = pytest.mark.usefixtures("empty_file")


def square(name="Square"):
    return mesh_object(name, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])


def material(name, color=None):
    made = bpy.data.materials.new(name)
    made.diffuse_color = (*(color or (1, 1, 1)), 1)
    return made


def instance_on_points(target, source):
    """A modifier on `target` that puts the object `source` on each of its vertices, and keeps its own surface."""
    tree = bpy.data.node_groups.new("Instances", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    put, info = tree.nodes.new("GeometryNodeInstanceOnPoints"), tree.nodes.new("GeometryNodeObjectInfo")
    join = tree.nodes.new("GeometryNodeJoinGeometry")
    info.inputs["Object"].default_value = source
    info.inputs["As Instance"].default_value = True
    tree.links.new(start.outputs[0], put.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], put.inputs["Instance"])
    tree.links.new(put.outputs[0], join.inputs[0])
    tree.links.new(start.outputs[0], join.inputs[0])
    tree.links.new(join.outputs[0], end.inputs[0])
    target.modifiers.new("Instances", "NODES").node_group = tree


# Geometry


def test_a_square_is_two_triangles_that_cover_it():
    square()
    scene = sync()
    (geometry,) = scene.geometries
    mesh = geometry.mesh
    p = mesh.position[mesh.triangles]
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    assert mesh.triangles.dtype == np.int32
    assert len(mesh.triangles) == 2
    assert area.sum() == pytest.approx(1, abs=0)  # exact in binary
    assert np.array_equal(scene.instances.world_from_object, np.eye(4)[None])


def test_the_fast_reading_of_triangles_equals_blenders_own():
    bpy.ops.mesh.primitive_uv_sphere_add(segments=9, ring_count=7)
    ob = bpy.context.object
    ob.data.polygons[3].use_smooth = True  # normals differ from corner to corner
    mesh = sync().geometries[0].mesh
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    evaluated.calc_loop_triangles()
    triangles = evaluated.loop_triangles
    assert np.array_equal(mesh.triangles, [t.vertices[:] for t in triangles])
    assert np.array_equal(
        mesh.corner_normal, [[evaluated.corner_normals[c].vector for c in t.loops] for t in triangles]
    )
    layer = evaluated.uv_layers.active
    assert np.array_equal(mesh.uv[layer.name], [[layer.uv[c].vector for c in t.loops] for t in triangles])
    assert mesh.active_uv == layer.name


def test_a_smooth_mesh_has_one_normal_for_each_vertex():
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    mesh = sync().geometries[0].mesh
    assert mesh.corner_normal is None
    # A sphere's normals are its positions; the mesh is flat between its vertices.
    assert np.einsum("ij,ij->i", mesh.vertex_normal, mesh.position).min() > 0.999  # measured 0.99998


def test_materials_of_faces_become_rows_of_the_table():
    ob = mesh_object("Two", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], [(0, 1, 2, 3), (1, 4, 2)])
    red, blue = material("Red"), material("Blue")
    ob.data.materials.append(red)
    ob.data.materials.append(None)
    ob.material_slots[1].link = "OBJECT"
    ob.material_slots[1].material = blue
    ob.data.polygons[1].material_index = 1
    scene = sync()
    mesh = scene.geometries[0].mesh
    names = [scene.materials.names[row] for row in mesh.material]
    assert names == ["Red", "Red", "Blue"]  # the quad is two triangles
    assert sorted(scene.materials.names[row] for row in mesh.materials) == ["Blue", "Red"]


def test_a_view_layers_material_takes_the_place_of_all():
    square("With").data.materials.append(material("Own"))
    square("Without")
    bpy.context.view_layer.material_override = material("Override")
    scene = sync()
    assert {scene.materials.names[row] for g in scene.geometries for row in g.mesh.materials} == {"Override"}


def test_a_material_index_beyond_the_slots_means_the_last_slot():
    ob = square()
    ob.data.materials.append(material("Only"))
    ob.data.materials.append(material("Last"))
    ob.data.polygons[0].material_index = 7
    scene = sync()
    assert [scene.materials.names[row] for row in scene.geometries[0].mesh.materials] == ["Last"]


def test_only_colours_that_a_material_reads_are_taken_and_they_are_scene_linear():
    ob = square()
    for name in ("Paint", "Other"):
        layer = ob.data.color_attributes.new(name, "BYTE_COLOR", "CORNER")
        for item in layer.data:
            item.color_srgb = (0.5, 0, 1, 0.25)
    used = material("Painted")
    if not used.node_tree:
        used.use_nodes = True
    tree = used.node_tree
    node = tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "Paint"
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    assert sync().geometries[0].mesh.colors == {}
    ob.data.materials.append(used)
    colors = sync().geometries[0].mesh.colors
    assert list(colors) == ["Paint"]
    # sRGB 128/255 is 0.2158605 linear (IEC 61966-2-1); alpha stays linear: 64/255
    assert colors["Paint"].shape == (2, 3, 4)
    assert np.allclose(colors["Paint"], [0.2158605, 0, 1, 64 / 255], atol=2e-7)  # measured 6e-8


@pytest.mark.parametrize("kind", ["curve", "text", "metaball"])
def test_what_blender_turns_into_a_mesh_is_a_mesh(kind):
    if kind == "curve":
        bpy.ops.curve.primitive_bezier_circle_add()
        bpy.context.object.data.bevel_depth = 0.1
        bpy.context.object.pointsplat.primitive = "POLYGONS"  # else it is tubes (test_convert_curves.py)
    elif kind == "text":
        bpy.ops.object.text_add()
    else:
        bpy.ops.object.metaball_add()
    scene = sync()
    assert len(scene.instances) == len(scene.geometries) == 1
    assert len(scene.geometries[0].mesh.triangles) > 10
    assert scene.warnings == ()


def test_modifiers_are_applied():
    ob = square()
    ob.modifiers.new("Subdivision", "SUBSURF").render_levels = 2
    ob.modifiers[0].levels = 1
    assert len(sync().geometries[0].mesh.triangles) == 4 * 2


def test_a_mesh_in_edit_mode_is_drawn_as_it_is_edited():
    ob = square()
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    assert len(sync().geometries[0].mesh.triangles) == 2
    bpy.ops.object.mode_set(mode="OBJECT")


def test_loose_vertices_edges_and_empty_meshes_give_no_triangles_and_no_error():
    mesh_object("Loose", [(0, 0, 0), (1, 0, 0), (5, 5, 5)], [], [(0, 1)])
    mesh_object("Empty", [], [])
    scene = sync()
    assert len(scene.geometries) == len(scene.instances) == 0
    ob = mesh_object("Mixed", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (9, 9, 9)], [(0, 1, 2)], [(2, 3)])
    scene = sync()
    assert scene.instances.names == (ob.name,)
    assert len(scene.geometries[0].mesh.triangles) == 1


def test_non_finite_positions_pass_through_without_an_error():
    square().data.vertices[0].co = (float("nan"), float("inf"), 0)
    assert len(sync().geometries[0].mesh.triangles) >= 1


def test_a_point_cloud_keeps_radius_and_colour():
    position = np.arange(12, dtype=np.float32).reshape(4, 3)
    color = np.linspace(0, 1, 16).reshape(4, 4)
    pointcloud("Scan", position, radius=("FLOAT", "value", [1, 2, 3, 4]), Col=("FLOAT_COLOR", "color", color))
    scene = sync()
    cloud = scene.geometries[0].cloud
    assert np.array_equal(cloud.position, position)
    assert np.array_equal(cloud.radii, [[1], [2], [3], [4]])
    assert np.array_equal(cloud.color, color[:, :3].astype(np.float32))
    assert cloud.normal is None
    assert cloud.material is None


def test_a_point_cloud_without_radius_has_blenders_default():
    pointcloud("Plain", [(0, 0, 0), (1, 1, 1)])
    cloud = sync().geometries[0].cloud
    assert cloud.radii == pytest.approx(0.01, rel=1e-7)
    assert cloud.color is None


def test_a_point_cloud_shows_what_its_material_makes_of_an_attribute():
    heat = np.array([0.0, 0.25, 1.0], np.float32)
    ob = pointcloud("Heat", np.eye(3), heat=("FLOAT", "value", heat))
    used = material("By heat")
    if not used.node_tree:
        used.use_nodes = True
    tree = used.node_tree
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = "heat"
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    tree.links.new(node.outputs["Fac"], shader.inputs["Roughness"])
    ob.data.materials.append(used)
    scene = sync()
    cloud = scene.geometries[0].cloud
    assert np.allclose(cloud.surface[:, 0], heat, atol=1e-7)  # measured 0
    assert np.all(cloud.surface[:, 1] == 0)
    assert [scene.materials.names[row] for row in cloud.material] == ["By heat"] * 3


# Instances


def test_objects_that_share_a_mesh_share_a_geometry():
    first = square()
    second = first.copy()
    second.location = (0, 0, 3)
    second.scale = (-1, 2, 0)  # mirrored and flat
    bpy.context.collection.objects.link(second)
    scene = sync()
    assert len(scene.geometries) == 1
    assert scene.instances.geometry.tolist() == [0, 0]
    row = scene.instances.names.index(second.name)
    assert np.array_equal(scene.instances.world_from_object[row], np.array(second.matrix_world))


def test_instances_stand_where_the_vertices_are():
    source = square("Leaf")
    source.location = (50, 0, 0)
    positions = [(x, y, 0) for x in range(10) for y in range(10)]
    target = mesh_object("Tree", positions, [(0, 1, 11, 10)])
    instance_on_points(target, source)
    scene = sync()
    leaf = np.array([name == "Leaf" for name in scene.instances.names])
    assert len(scene.geometries) == 2
    assert leaf.sum() == 1 + 100
    places = scene.instances.world_from_object[leaf][:, :3, 3]
    assert {tuple(p) for p in places.tolist()} == {(50, 0, 0), *positions}


def test_material_of_the_object_separates_geometries():
    first, red = square(), material("Red")
    first.data.materials.append(None)
    second = first.copy()
    bpy.context.collection.objects.link(second)
    second.material_slots[0].link = "OBJECT"
    second.material_slots[0].material = red
    scene = sync()
    assert len(scene.geometries) == 2
    rows = {
        scene.instances.names[i]: scene.geometries[g].mesh.materials for i, g in enumerate(scene.instances.geometry)
    }
    assert rows[first.name] == (0,)
    assert [scene.materials.names[row] for row in rows[second.name]] == ["Red"]


def test_object_settings_pass_index_and_hash_arrive():
    ob = square("Named")
    ob.pass_index = 12
    ob.pointsplat.primitive = "POINTS"
    ob.pointsplat.spacing = 0.25
    scene = sync()
    assert scene.geometries[0].primitive == "POINTS"
    assert scene.geometries[0].spacing == 0.25
    assert scene.instances.pass_index.tolist() == [12]
    assert scene.instances.object_hash.tolist() == [cryptomatte_hash("Named")]


def test_previous_transforms_are_found_by_identity_and_new_instances_stand_still():
    from pointsplat_addon.host.convert.objects import collect

    moved, source = square("Moved"), square("Source")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    collected = collect(depsgraph, identify=True)
    before = dict(zip(collected.identity, collected.world_from_object, strict=True))
    moved.location.x = 2
    instance_on_points(moved, source)
    instances = sync(previous=before).instances
    row = instances.names.index("Moved")
    assert instances.previous[row, 0, 3] == 0
    assert instances.world_from_object[row, 0, 3] == 2
    generated = [
        i for i, n in enumerate(instances.names) if n == "Source" and instances.world_from_object[i, 0, 3] >= 2
    ]
    assert len(generated) == 4
    assert np.array_equal(instances.previous[generated], instances.world_from_object[generated])


# Visibility


def drawn():
    """The names of what cameras see."""
    instances = sync().instances
    seen = np.ones(len(instances), bool) if instances.seen is None else instances.seen
    return sorted(np.array(instances.names, object)[seen])


def test_hidden_and_excluded_objects_are_not_drawn():
    for name in ("Shown", "Viewport off", "Camera off", "Excluded"):
        square(name)
    objects = bpy.data.objects
    objects["Viewport off"].hide_viewport = True
    objects["Camera off"].visible_camera = False
    collection = bpy.data.collections.new("Away")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(objects["Excluded"])
    bpy.context.collection.objects.unlink(objects["Excluded"])
    bpy.context.view_layer.layer_collection.children["Away"].exclude = True
    assert drawn() == ["Shown"]


def test_objects_seen_only_indirectly_are_not_drawn():
    collection = bpy.data.collections.new("Indirect")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(square("Mirrored"))
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Mirrored"])
    bpy.context.view_layer.layer_collection.children["Indirect"].indirect_only = True
    assert drawn() == []


@pytest.mark.parametrize("how", ["object", "collection"])
def test_holdouts_are_marked(how):
    ob = square("Hole")
    square("Wall")
    if how == "object":
        ob.is_holdout = True
    else:
        collection = bpy.data.collections.new("Holdout")
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(ob)
        bpy.context.scene.collection.objects.unlink(ob)
        bpy.context.view_layer.layer_collection.children["Holdout"].holdout = True
    instances = sync().instances
    assert dict(zip(instances.names, instances.holdout.tolist(), strict=True)) == {"Hole": True, "Wall": False}


def test_shadow_catchers_without_polygons_are_left_out_and_named():
    square("Floor").is_shadow_catcher = True
    pointcloud("Scan", [(0, 0, 0)]).is_shadow_catcher = True
    square("Wall")
    scene = sync()
    assert dict(zip(scene.instances.names, scene.instances.matte.tolist(), strict=True)) == {
        "Floor": True,
        "Wall": False,
    }
    assert [w for w in scene.warnings if "Scan" in w] == [
        'Shadow catchers without polygons are not supported yet and are left out: "Scan"'
    ]


def test_shadow_catchers_hide_what_is_behind_them_whatever_their_material_lets_through():
    ob = square("Floor")
    ob.is_shadow_catcher = True
    ob.data.materials.append(material := bpy.data.materials.new("Film"))
    material.use_nodes = True
    assert sync().geometries[0].mesh.materials != (0,)
    material.node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.5
    found = sync()
    assert found.geometries[0].mesh.materials == (0,)
    assert found.warnings == ()


def test_polygons_that_light_passes_through_are_said_to_be_points():
    ob = square("Pane")
    ob.pointsplat.primitive = "POLYGONS"
    ob.data.materials.append(material := bpy.data.materials.new("Glass"))
    material.use_nodes = True
    nodes = material.node_tree.nodes
    assert sync().warnings == ()
    nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.5
    assert [w for w in sync().warnings if "Pane" in w] == [
        'Translucent surfaces are drawn as points, not as polygons: "Pane"'
    ]


def test_an_instancer_decides_whether_its_instances_are_holes():
    source, target = square("Leaf"), mesh_object("Tree", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    instance_on_points(target, source)
    target.is_holdout = True
    instances = sync().instances
    assert sorted(zip(instances.names, instances.holdout.tolist(), strict=True)) == [
        ("Leaf", False),
        *[("Leaf", True)] * 3,
        ("Tree", True),
    ]


def test_kinds_that_are_not_supported_give_one_warning_that_names_some():
    collection = getattr(bpy.data, "grease_pencils_v3", bpy.data.grease_pencils)  # until and from Blender 5
    for i in range(5):
        pencil = collection.new(f"Pencil {i}")
        bpy.context.collection.objects.link(bpy.data.objects.new(f"Pencil {i}", pencil))
    (warning,) = sync().warnings
    assert "Grease Pencil" in warning
    assert '"Pencil 0"' in warning
    assert "2 more" in warning


# What is reused


def test_a_second_look_at_the_same_content_makes_no_new_arrays():
    ob = square()
    first = sync()
    ob.location.x = 4
    ob.data.update()
    assert sync().geometries[0] is first.geometries[0]


def test_a_moved_vertex_changes_the_content_key_and_back_again():
    ob = square()
    first = sync()
    ob.data.vertices[0].co.z = 0.5
    ob.data.update()
    second = sync()
    assert second.geometries[0].key != first.geometries[0].key
    ob.data.vertices[0].co.z = 0
    ob.data.update()
    assert sync().geometries[0].key == first.geometries[0].key


def test_a_deformed_mesh_keeps_its_topology_key():
    ob = square()
    first = sync().geometries[0].mesh
    ob.data.vertices[0].co.z = 0.5
    ob.data.update()
    second = sync().geometries[0].mesh
    assert second.topology == first.topology != ""
    ob.data.materials.append(material("Other"))
    assert sync().geometries[0].mesh.topology != first.topology


def test_content_keys_do_not_depend_on_which_other_materials_are_shown():
    first, second = square("First"), square("Second")
    first.data.materials.append(material("A"))
    second.data.materials.append(material("B"))
    keys = {g.name: g.key for g in sync().geometries}
    first.hide_viewport = True
    assert sync().geometries[0].key == keys["Second"]


def test_updates_of_the_dependency_graph_decide_what_is_read_again(monkeypatch):
    from pointsplat_addon.host import geometries
    from pointsplat_addon.host.sync import Synchronizer

    changed, still = square("Changed"), mesh_object("Still", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    assert still
    synchronizer, read = Synchronizer(), []
    original = geometries._read_evaluated

    def spy(source, *arguments):
        read.append(source.name)
        return original(source, *arguments)

    monkeypatch.setattr(geometries, "_read_evaluated", spy)
    log = []

    def handler(_scene, depsgraph):
        read.clear()
        synchronizer.scene(depsgraph)
        log.append(sorted(read))

    bpy.app.handlers.depsgraph_update_post.append(handler)
    try:
        changed.location.x = 1
        bpy.context.view_layer.update()
        changed.location.x = 2
        bpy.context.view_layer.update()
        changed.data.vertices[0].co.z = 3
        changed.data.update()
        bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(handler)
    assert log == [["Changed", "Still"], [], ["Changed"]]


def test_geometry_is_forgotten_with_the_scenes_that_hold_it():
    from pointsplat_addon.host.geometry_cache import GeometryCache
    from pointsplat_addon.host.sync import Synchronizer

    square()
    cache = GeometryCache()
    synchronizer = Synchronizer(cache)
    scene = sync(synchronizer)
    key = scene.geometries[0].key
    assert cache.lookup(key, lambda: None) is scene.geometries[0]
    del scene, synchronizer
    marker = sync  # any object that can be referred to weakly
    assert cache.lookup(key, lambda: marker) is marker
