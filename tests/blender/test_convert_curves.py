"""Hair, curves and particle hair as strands, against Blender's own evaluation and Cycles' pixels."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest

from pointsplat_addon.core.material import hair_color
from pointsplat_addon.core.scene.valid.geometry import valid_strands
from pointsplat_addon.core.strand import curves, normals
from tests.support.blender.scenes import new_material, node

pytestmark = pytest.mark.usefixtures("empty_file")


def sync(synchronizer=None) -> Any:
    from pointsplat_addon.host.sync import Synchronizer

    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return (synchronizer or Synchronizer()).scene(depsgraph)


def linked(name, data):
    ob = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(ob)
    return ob


def hair(sizes, position, name="Hair", **attributes):
    """A Curves object. Attributes: name to (type, domain, key, values)."""
    data = bpy.data.hair_curves.new(name)
    if sizes:  # none at all crash Blender 4.5
        data.add_curves(list(sizes))
        data.position_data.foreach_set("vector", np.asarray(position, np.float32).ravel())
    for attribute, (kind, domain, key, values) in attributes.items():
        made = data.attributes.new(attribute, kind, domain)
        made.data.foreach_set(key, np.asarray(values).ravel())
    return linked(name, data)


def evaluated_by_blender(ob):
    """Positions, normals and radii at Blender's evaluated points, by a Curve to Points node."""
    tree = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    points = node(tree, "GeometryNodeCurveToPoints", mode="EVALUATED")
    store = node(tree, "GeometryNodeStoreNamedAttribute", data_type="FLOAT_VECTOR")
    store.inputs["Name"].default_value = "N"
    tree.links.new(start.outputs[0], points.inputs[0])
    tree.links.new(points.outputs["Points"], store.inputs[0])
    tree.links.new(points.outputs["Normal"], store.inputs["Value"])
    tree.links.new(store.outputs[0], end.inputs[0])
    modifier = ob.modifiers.new("Points", "NODES")
    modifier.node_group = tree
    geometry = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    cloud = geometry.pointcloud
    found = []
    for name, key, width in (("position", "vector", 3), ("N", "vector", 3), ("radius", "value", 1)):
        values = np.empty(len(cloud.points) * width, np.float32)
        cloud.attributes[name].data.foreach_get(key, values)
        found.append(values.reshape(-1, width))
    ob.modifiers.remove(modifier)
    return found


# Evaluation


@pytest.mark.parametrize("mode", [curves.MINIMUM_TWIST, curves.Z_UP, curves.FREE])
@pytest.mark.parametrize("cyclic", [False, True])
@pytest.mark.parametrize("kind", ["CATMULL_ROM", "POLY"])
def test_points_radii_and_normals_of_hair_are_blenders(kind, cyclic, mode):
    random, sizes = np.random.default_rng(3), [7, 4, 3, 30]
    count, total = len(sizes), sum(sizes)
    ob = hair(
        sizes,
        random.random((total, 3)),
        cyclic=("BOOLEAN", "CURVE", "value", [cyclic] * count),
        resolution=("INT", "CURVE", "value", [5] * count),
        normal_mode=("INT8", "CURVE", "value", [mode] * count),
        radius=("FLOAT", "POINT", "value", random.random(total).astype(np.float32)),
        tilt=("FLOAT", "POINT", "value", random.uniform(-3, 3, total).astype(np.float32)),
        custom_normal=("FLOAT_VECTOR", "POINT", "vector", random.normal(size=(total, 3)).astype(np.float32)),
    )
    ob.data.set_types(type=kind)
    ob.pointsplat.ribbons = True
    position, normal, radius = evaluated_by_blender(ob)
    lines = sync().geometries[0].strands
    assert len(lines) == count
    ends = lines.start[1:] - 1
    kept = np.setdiff1d(np.arange(len(lines.position)), ends) if cyclic else np.arange(len(lines.position))
    if cyclic:
        np.testing.assert_array_equal(lines.position[ends], lines.position[lines.start[:-1]])
    assert np.abs(lines.position[kept] - position).max() < 5e-7  # measured 1.2e-7
    assert np.abs(lines.radius[kept] - np.maximum(radius[:, 0], 0)).max() < 5e-7  # measured 1.2e-7
    # Blender adds rotations up in float32. Measured 6.3e-6
    assert np.linalg.norm(lines.normal[kept] - normal, axis=1).max() < 3e-5


def spline_object(kind, n, *, cyclic, order=4, endpoint=False, bezier=False, handles="FREE"):
    random = np.random.default_rng(n)
    data = bpy.data.curves.new("Curve", "CURVE")
    data.dimensions = "3D"
    spline = data.splines.new(kind)
    place = random.random((n, 3))
    if kind == "BEZIER":
        spline.bezier_points.add(n - 1)
        for point, at in zip(spline.bezier_points, place, strict=True):
            point.co, point.radius = at, random.uniform(0.5, 2)
            point.handle_left_type = point.handle_right_type = handles
            if handles == "FREE":
                point.handle_left, point.handle_right = at + random.normal(size=(2, 3)) * 0.2
    else:
        spline.points.add(n - 1)
        for point, at in zip(spline.points, place, strict=True):
            point.co, point.radius = (*at, random.uniform(0.5, 2)), random.uniform(0.5, 2)
        if kind == "NURBS":
            spline.use_endpoint_u, spline.use_bezier_u = endpoint, bezier
            spline.order_u = order
    spline.use_cyclic_u, spline.resolution_u = cyclic, 5
    return linked("Curve", data)


def vertices_by_blender(ob):
    """The edges that Blender makes of a curve without a bevel."""
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    found = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", found)
    evaluated.to_mesh_clear()
    return found.reshape(-1, 3)


def distance(points, line):
    a, b = line[:-1].astype(float), line[1:].astype(float)
    along = b - a
    t = np.clip(((points[:, None] - a) * along).sum(-1) / (along * along).sum(-1), 0, 1)
    return np.linalg.norm(points[:, None] - a - t[..., None] * along, axis=-1).min(axis=1).max()


@pytest.mark.parametrize("cyclic", [False, True])
@pytest.mark.parametrize(
    "settings",
    [
        {"kind": "POLY", "n": 5},
        {"kind": "BEZIER", "n": 4},
        {"kind": "BEZIER", "n": 5, "handles": "AUTO"},
        {"kind": "BEZIER", "n": 3, "handles": "VECTOR"},
        *[
            {"kind": "NURBS", "n": n, "order": order, "endpoint": endpoint, "bezier": bezier}
            for n in (4, 6, 9)
            for order in (2, 3, 4)
            for endpoint in (False, True)
            for bezier in (False, True)
        ],
    ],
    ids=lambda s: "-".join(str(v) for v in s.values()),
)
def test_a_round_bevel_is_a_tube_along_blenders_points(settings, cyclic):
    ob = spline_object(**settings, cyclic=cyclic)
    expected = vertices_by_blender(ob)
    assert sync().geometries == ()  # without a bevel Blender draws nothing
    ob.data.bevel_depth = 0.01
    (geometry,) = sync().geometries
    assert geometry.mesh is None
    lines = geometry.strands
    found = lines.position[:-1] if cyclic else lines.position
    if settings["kind"] == "NURBS" and bpy.app.version < (5, 0, 0):
        # The same curve in other steps, five on a span: each lies within the other's chords
        size = np.ptp(expected, axis=0).max()
        assert distance(expected, lines.position) < 0.08 * size  # measured 0.04
    else:
        assert len(found) == len(expected)
        assert np.abs(found - expected).max() < 1e-6  # measured 1.8e-7
    assert lines.radius.min() > 0.004
    assert lines.radius.max() < 0.021


def test_what_a_tube_does_not_fit_stays_a_mesh():
    ob = spline_object("BEZIER", 4, cyclic=False)
    data = ob.data
    data.bevel_depth = 0.1

    def drawn():
        (geometry,) = sync().geometries
        return "lines" if geometry.strands else "mesh"

    assert drawn() == "lines"
    for settings, name, value, back in (
        (ob.pointsplat, "primitive", "POLYGONS", "AUTO"),
        (ob.pointsplat, "primitive", "POINTS", "AUTO"),
        (data, "extrude", 0.1, 0.0),
        (data, "bevel_mode", "PROFILE", "ROUND"),
        (data, "bevel_factor_end", 0.5, 1.0),
        (data, "bevel_resolution", 0, 4),
        (data, "fill_mode", "HALF", "FULL"),
        (data, "offset", 0.01, 0.0),
    ):
        setattr(settings, name, value)
        assert drawn() == "mesh", name
        setattr(settings, name, back)
    data.bevel_resolution, ob.pointsplat.primitive = 0, "LINES"
    assert drawn() == "lines"
    ob.modifiers.new("Wave", "WAVE")
    assert drawn() == "mesh"


def test_splines_keep_their_materials_and_radii():
    ob = spline_object("BEZIER", 4, cyclic=False)
    ob.data.bevel_depth = 0.5
    for name in ("Red", "Blue"):
        ob.data.materials.append(bpy.data.materials.new(name))
    second = ob.data.splines.new("POLY")
    second.points.add(1)
    second.points[0].co, second.points[1].co = (5, 0, 0, 1), (5, 0, 1, 1)
    second.points[0].radius, second.points[1].radius = 1, 3
    second.material_index = 1
    scene = sync()
    lines = scene.geometries[0].strands
    assert [scene.materials.names[row] for row in lines.material] == ["Red", "Blue"]
    assert lines.radius[-2:].tolist() == [0.5, 1.5]
    assert lines.materials == tuple(sorted(lines.material.tolist()))


def test_instances_of_tubes_share_them_and_their_meshes_are_left_out():
    ob = spline_object("BEZIER", 4, cyclic=False)
    ob.data.bevel_depth = 0.1
    collection = bpy.data.collections.new("Kit")
    bpy.context.collection.objects.unlink(ob)
    collection.objects.link(ob)
    for i in range(3):
        empty = linked(f"Empty {i}", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, (i, 0, 0)
    scene = sync()
    assert len(scene.geometries) == 1
    assert scene.geometries[0].strands is not None
    assert sorted(scene.instances.world_from_object[:, 0, 3].tolist()) == [0, 1, 2]


# Hair


def test_hair_without_attributes_has_cycles_radius_and_few_points():
    straight = np.linspace([0, 0, 0], [0, 0, 1], 5)
    bent = np.stack([np.cos(np.linspace(0, 3, 5)), np.sin(np.linspace(0, 3, 5)), np.zeros(5)], axis=1)
    hair([5, 5], np.concatenate([straight, bent]))
    lines = sync().geometries[0].strands
    assert (lines.radius == np.float32(0.005)).all()
    count = np.diff(lines.start).tolist()
    assert count[0] == 5
    assert 20 < count[1] <= 49
    assert lines.normal is None


def test_bad_hair_is_named_and_counted_and_the_rest_is_drawn():
    position = np.arange(33, dtype=np.float32).reshape(11, 3)
    position[1] = np.nan
    position[6:8] = 1
    hair([3, 1, 2, 2, 3], position, name="Mop")
    hair([], np.empty((0, 3)), name="Bald")
    hair([2], np.full((2, 3), np.inf), name="Gone")
    scene = sync()
    (geometry,) = scene.geometries
    assert geometry.name == "Mop"
    assert set(scene.warnings) == {
        "Mop: 1 control point is not a number and is left out",
        "Gone: all control points are not numbers",
    }
    strands, messages = valid_strands(geometry.strands)
    assert len(strands.start) - 1 == 3
    assert messages == ("2 strands have less than two positions and are left out",)


def test_what_a_material_reads_of_strands_is_cycles():
    """Intercept, length, thickness and random numbers, and an attribute for each strand."""
    z = np.array([0, 0.25, 1.0])
    position = np.concatenate([np.stack([np.full(3, float(i)), np.zeros(3), z * (i + 1)], axis=1) for i in range(3)])
    ob = hair(
        [3] * 3,
        position,
        radius=("FLOAT", "POINT", "value", np.full(9, 0.125, np.float32)),
        tint=("FLOAT_COLOR", "CURVE", "color", np.repeat([[0.25], [0.5], [1.0]], 4, axis=1).astype(np.float32)),
        surface_uv_coordinate=("FLOAT2", "CURVE", "vector", np.arange(6, dtype=np.float32) / 8),
    )
    ob.data.set_types(type="POLY")

    def shown(kind, output, **settings):
        material = new_material("Hair")
        tree = material.node_tree
        source = node(tree, kind, **settings)
        surface = node(tree, "ShaderNodeBsdfPrincipled", {"Base Color": source.outputs[output]})
        node(tree, "ShaderNodeOutputMaterial", {"Surface": surface.outputs[0]})
        ob.data.materials.clear()
        ob.data.materials.append(material)
        lines = sync().geometries[0].strands
        return lines.color.reshape(3, 3, 3)

    info = "ShaderNodeHairInfo"
    np.testing.assert_allclose(shown(info, "Intercept")[..., 0], np.tile(z, (3, 1)), atol=1e-7)
    np.testing.assert_allclose(shown(info, "Length")[..., 0], np.repeat([[1], [2], [3]], 3, axis=1), atol=1e-6)
    assert (shown(info, "Thickness") == 0.25).all()
    assert (shown(info, "Is Strand") == 1).all()
    np.testing.assert_allclose(shown(info, "Random")[:, 0, 0], hair_color.random_of_strands(3), atol=1e-7)
    tint = shown("ShaderNodeAttribute", "Color", attribute_name="tint")
    np.testing.assert_array_equal(tint[:, :, 1], np.repeat([[0.25], [0.5], [1.0]], 3, axis=1))
    uv = shown("ShaderNodeUVMap", "UV")
    np.testing.assert_array_equal(uv[:, 1, :2], np.arange(6).reshape(3, 2) / 8)
    np.testing.assert_array_equal(sync().geometries[0].strands.uv, np.arange(6).reshape(3, 2) / 8)


def test_ribbons_are_asked_for_and_change_the_geometry():
    from pointsplat_addon.host.sync import Synchronizer

    ob, synchronizer = hair([4], np.random.default_rng(0).random((4, 3))), Synchronizer()
    round_one = sync(synchronizer).geometries[0]
    assert sync(synchronizer).geometries[0] is round_one
    ob.pointsplat.ribbons = True
    flat = sync(synchronizer).geometries[0]
    assert flat.key != round_one.key
    along = normals.curve_tangents(flat.strands.position, flat.strands.start, np.array([False]))
    assert np.abs(np.linalg.norm(flat.strands.normal, axis=1) - 1).max() < 1e-6
    assert np.abs(np.einsum("ij,ij->i", along, flat.strands.normal)).max() < 1e-5  # measured 3.2e-7


# Particle systems


def furry(count=20, **settings):
    bpy.ops.mesh.primitive_plane_add()
    ob = bpy.context.object
    ob.modifiers.new("Fur", "PARTICLE_SYSTEM")
    made = ob.particle_systems[0].settings
    made.type, made.count, made.hair_length = "HAIR", count, 1.0
    for name, value in settings.items():
        setattr(made, name, value)
    return ob


def test_particle_hair_has_cycles_shape_in_the_objects_space():
    ob = furry(root_radius=1.0, tip_radius=0.25, radius_scale=0.02, shape=0.0, use_close_tip=False)
    ob.location, ob.rotation_euler, ob.scale = (3, 2, 1), (0.3, 0.2, 0.1), (2, 2, 2)
    scene = sync()
    geometry = next(g for g in scene.geometries if g.strands)
    lines = geometry.strands
    assert len(lines) == 20
    root = lines.position[lines.start[:-1]]
    assert np.abs(root[:, 2]).max() < 1e-5  # on the plane; measured 1.1e-7
    assert np.abs(root[:, :2]).max() <= 1 + 1e-5
    np.testing.assert_allclose(lines.radius[lines.start[:-1]], 0.01, rtol=1e-6)
    np.testing.assert_allclose(lines.radius[lines.start[1:] - 1], 0.0025, rtol=1e-6)
    row = next(i for i, g in enumerate(scene.geometries) if g.strands)
    drawn = np.flatnonzero(scene.instances.geometry == row)
    np.testing.assert_allclose(scene.instances.world_from_object[drawn[0]], np.array(ob.matrix_world), atol=1e-6)
    # Along the world's way the strands are as Blender's
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    tip = evaluated.particle_systems[0].co_hair(evaluated, particle_no=7, step=4)
    world = np.array(ob.matrix_world) @ [*lines.position[lines.start[8] - 1], 1]
    np.testing.assert_allclose(world[:3], tip, atol=1e-5)  # measured 2e-7


def test_children_take_the_place_of_parents_and_moving_the_emitter_makes_nothing_new():
    from pointsplat_addon.host.sync import Synchronizer

    ob, synchronizer = furry(count=5, child_type="SIMPLE", child_percent=10), Synchronizer()
    first = next(g for g in sync(synchronizer).geometries if g.strands)
    assert len(first.strands) == 50
    ob.location = (1, 2, 3)
    again = next(g for g in sync(synchronizer).geometries if g.strands)
    np.testing.assert_allclose(again.strands.position, first.strands.position, atol=1e-5)  # measured 2.4e-7
    ob.particle_systems[0].settings.render_type = "NONE"
    assert all(g.strands is None for g in sync(synchronizer).geometries)


def test_fur_takes_its_colour_from_the_emitters_uv_map():
    ob = furry()
    material = new_material("Fur")
    uv = node(material.node_tree, "ShaderNodeUVMap", uv_map="UVMap")
    surface = node(material.node_tree, "ShaderNodeBsdfPrincipled", {"Base Color": uv.outputs[0]})
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": surface.outputs[0]})
    ob.data.materials.append(material)
    lines = next(g for g in sync().geometries if g.strands).strands
    root = lines.position[lines.start[:-1]]
    # The plane's map is its square
    np.testing.assert_allclose(lines.uv, (root[:, :2] + 1) / 2, atol=1e-6)  # measured 6e-8
    np.testing.assert_allclose(lines.color[lines.start[:-1], :2], lines.uv, atol=1e-6)


# The Principled Hair BSDF


def hair_material(**inputs):
    settings = {n: inputs.pop(n) for n in ("model", "parametrization") if n in inputs}
    material = new_material("Hair")
    shader = node(material.node_tree, "ShaderNodeBsdfHairPrincipled", inputs, **settings)
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": shader.outputs[0]})
    return material


def table_of(*materials):
    from pointsplat_addon.host.convert.material.materials import convert_materials

    return convert_materials(materials)


def test_principled_hair_fills_the_table():
    color = hair_material(parametrization="COLOR", Color=(0.5, 0.25, 0.125, 1), Roughness=0.4, Coat=0.2, IOR=1.6,
                          Offset=0.05, **{"Radial Roughness": 0.7})  # fmt: skip
    melanin = hair_material(parametrization="MELANIN", Melanin=0.6, Tint=(1, 0.5, 1, 1), **{"Melanin Redness": 0.3})
    absorbing = hair_material(parametrization="ABSORPTION", **{"Absorption Coefficient": (0.245531, 0.52, 1.365)})
    huang = hair_material(model="HUANG", parametrization="COLOR", Roughness=0.2, **{"TT lobe": 0.5})
    plain = new_material("Plain")
    table, warnings = table_of(color, melanin, absorbing, huang, plain)
    found = table.hair
    assert found is not None
    assert found.used.tolist() == [False, True, True, True, True, False]
    np.testing.assert_allclose(table.base_color[1], [0.5, 0.25, 0.125], rtol=1e-6)
    np.testing.assert_allclose(table.roughness[1:3], [0.4, 0.3], rtol=1e-6)
    np.testing.assert_allclose([found.coat[1], table.ior[1], found.tilt[1], found.radial[1]], [0.2, 1.6, 0.05, 0.7],
                               rtol=1e-6)  # fmt: skip
    absorption = hair_color.absorption_from_color(table.base_color, found.radial[:, None])
    np.testing.assert_allclose(absorption[3], [0.245531, 0.52, 1.365], rtol=1e-6)  # measured 3.5e-8
    expected = -np.log(0.4) * (0.7 * np.array(hair_color.EUMELANIN) + 0.3 * np.array(hair_color.PHEOMELANIN))
    expected[1] += (np.log(0.5) / hair_color.roughness_scale(0.3)) ** 2
    np.testing.assert_allclose(absorption[2], expected, rtol=1e-6)  # measured 6.9e-8
    np.testing.assert_allclose(found.lobes[[1, 4]], [[1, 1, 1], [1, 0.5, 1]])
    assert found.radial[4] == np.float32(0.2)
    assert len([w for w in warnings if "Huang" in w]) == 1
    assert table_of(plain)[0].hair is None


def test_melanin_varies_from_strand_to_strand_as_in_cycles():
    ob = hair([2] * 50, np.random.default_rng(0).random((100, 3)))
    ob.data.materials.append(
        hair_material(
            parametrization="MELANIN",
            Melanin=0.5,
            **{"Melanin Redness": 0.0, "Random Color": 0.8, "Random Roughness": 0.5},
        )
    )
    lines = sync().geometries[0].strands
    off = 2 * (hair_color.random_of_strands(50).astype(float) - 0.5)
    absorption = -np.log(1 - 0.5 * (1 + 0.8 * off))[:, None] * np.array(hair_color.EUMELANIN)
    expected = np.repeat(hair_color.color_from_absorption(absorption, np.array(0.3)), 2, axis=0)
    np.testing.assert_allclose(lines.color, expected, rtol=1e-5)  # measured 1e-6
    np.testing.assert_allclose(lines.surface[:, 0], np.repeat(0.3 * (1 + 0.5 * off), 2), rtol=1e-6)  # measured 1.5e-7


def test_colours_of_random_strands_are_cycles_pixels():
    """Emission by Curves Info, seen by Cycles along parallel rays."""
    count, keys = 12, 11
    z = np.tile(np.linspace(0, 2, keys), count)
    position = np.stack([np.repeat(np.arange(count), keys), np.zeros(len(z)), z], axis=1)
    ob = hair([keys] * count, position, radius=("FLOAT", "POINT", "value", np.full(len(z), 0.4, np.float32)))
    material = new_material("Random")
    info = node(material.node_tree, "ShaderNodeHairInfo")
    color = node(material.node_tree, "ShaderNodeCombineColor",
                 {"Red": info.outputs["Random"], "Green": info.outputs["Intercept"]})  # fmt: skip
    glow = node(material.node_tree, "ShaderNodeEmission", {"Color": color.outputs[0]})
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": glow.outputs[0]})
    ob.data.materials.append(material)
    camera = linked("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", count
    camera.location, camera.rotation_euler = (count / 2 - 0.5, -5, 1), (np.pi / 2, 0, 0)
    scene = bpy.context.scene
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.filter_width = 4, False, 0.01
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 16 * count, 16 * 2, 100
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = bpy.app.tempdir + "random.exr"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    seen = pixels.reshape(32, 16 * count, 4)[:, 8::16]
    lines = sync().geometries[0].strands
    strand = lines.emission.reshape(count, -1, 3)
    np.testing.assert_allclose(seen[16, :, 0], strand[:, 0, 0], atol=1e-6)  # measured 6e-8
    height = (np.arange(32) + 0.5) / 16
    expected = np.interp(height, lines.position.reshape(count, -1, 3)[0, :, 2], strand[0, :, 1])
    # In the first and last segments Cycles' splines do not have constant speed
    np.testing.assert_allclose(seen[4:-4, 0, 1], expected[4:-4], atol=5e-4)  # measured 4.1e-5


# Mesh to Strands


def test_branches_and_leaves_become_strands_and_the_rest_stays():
    bpy.ops.mesh.primitive_cylinder_add(vertices=6, end_fill_type="NOTHING", location=(1, 2, 3))
    ob = bpy.context.object
    for settings in ({"location": (4, 2, 3)}, {"location": (1, 6, 3)}):
        (bpy.ops.mesh.primitive_plane_add if settings["location"][0] == 4 else bpy.ops.mesh.primitive_cube_add)(
            **settings
        )
    for other in bpy.context.scene.objects:
        other.select_set(True)
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.join()
    material = bpy.data.materials.new("Bark")
    ob.data.materials.append(material)
    assert bpy.ops.pointsplat.mesh_to_strands() == {"FINISHED"}
    assert len(ob.data.polygons) == 6  # the cube
    scene = sync()
    assert scene.warnings == ()
    tubes, ribbons = (
        [g.strands for g in scene.geometries if g.strands and (g.strands.normal is None) == t] for t in (1, 0)
    )
    assert len(tubes) == len(ribbons) == 1
    assert len(tubes[0]) == len(ribbons[0]) == 1
    np.testing.assert_allclose(np.abs(tubes[0].position), [[0, 0, 1]] * 2, atol=1e-6)
    np.testing.assert_allclose(tubes[0].radius, 6 * np.sin(np.pi / 6) / np.pi, rtol=1e-6)
    np.testing.assert_allclose(ribbons[0].radius, 1, rtol=1e-6)
    np.testing.assert_allclose(np.abs(ribbons[0].normal), [[0, 0, 1]] * 2, atol=1e-6)
    np.testing.assert_allclose(ribbons[0].position.mean(axis=0), [3, 0, 0], atol=1e-6)
    assert [scene.materials.names[row] for row in (*tubes[0].materials, *ribbons[0].materials)] == ["Bark", "Bark"]
    world = scene.instances.world_from_object
    np.testing.assert_allclose(world[:, :3, 3], [[1, 2, 3]] * 3, atol=1e-6)


def test_a_mesh_without_branches_is_left_alone():
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.pointsplat.mesh_to_strands() == {"CANCELLED"}
    assert len(bpy.context.object.data.polygons) == 6
    assert len(bpy.context.scene.objects) == 1
