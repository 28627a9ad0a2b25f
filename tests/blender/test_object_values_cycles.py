"""Materials that several objects or instances show, and that read which of them it is: the values of Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.host.sync import Synchronizer
from pointsplat_addon.render.plan.technique import shown_alike
from tests.support.blender.scenes import draw_beside_cycles, mesh_object, new_material, node, picture, sync

SQUARE = [(-0.4, -0.4, 0), (0.4, -0.4, 0), (0.4, 0.4, 0), (-0.4, 0.4, 0)]
SIDE = 4  # objects along each side of the picture
PIXELS = 8  # along each side of an object's cell
HALF_FLOATS = 0.0015  # measured 0.0011 of values up to 2.4, which PointSplat keeps as half floats


@pytest.fixture
def scene(empty_file):
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", SIDE
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = SIDE / 2, SIDE / 2, 5
    scene.collection.objects.link(scene.camera)
    draw_beside_cycles(scene, (SIDE * PIXELS, SIDE * PIXELS), 16)
    scene.render.film_transparent = True
    return scene


def glow(kind: str, output: str, **properties):
    """Emits an eighth of an output plus 1/2."""
    made = new_material("glow")
    tree = made.node_tree
    value = node(tree, f"ShaderNode{kind}", **properties).outputs[output]
    inputs = {"Vector": value, "Vector_001": (0.125,) * 3, "Vector_002": (0.5,) * 3}
    raised = node(tree, "ShaderNodeVectorMath", inputs, operation="MULTIPLY_ADD").outputs[0]
    shown = node(tree, "ShaderNodeEmission", {"Color": raised}).outputs[0]
    node(tree, "ShaderNodeOutputMaterial", {"Surface": shown})
    return made


def square(material, name="square"):
    data = bpy.data.meshes.new(name)
    data.from_pydata(SQUARE, [], [(0, 1, 2, 3)])
    data.materials.append(material)
    return data


def grid(data):
    """Objects that share data, which may be None: each turned, and with a colour and an index of its own."""
    made = []
    for number in range(SIDE * SIDE):
        y, x = divmod(number, SIDE)
        one = bpy.data.objects.new(f"one {number}", data)
        one.location, one.rotation_euler = (x + 0.5, y + 0.5, 0.01 * number), (0.1 * x, 0.2 * y, 0.1)
        one.color, one.pass_index = (x / SIDE, y / SIDE, 0.5, 0.25 + number / 32), number
        bpy.context.collection.objects.link(one)
        made.append(one)
    return made


def beside_cycles(scene, folder):
    """What Cycles and PointSplat draw, (SIDE, P, SIDE, P, 3) each: P by P pixels of the cells of objects."""
    drawn, pixels = [], scene.render.resolution_x // SIDE
    for scene.render.engine in ("CYCLES", "POINTSPLAT"):
        cells = picture(scene, folder).astype(float).reshape(SIDE, pixels, SIDE, pixels, 4)[..., :3]
        assert cells.mean(axis=(1, 3)).reshape(-1, 3).std(axis=0).max() > 0.01  # objects differ
        drawn.append(cells)
    return drawn


def difference_in_middles(scene, folder):
    """The largest difference from Cycles, in the middles of cells: not at edges, of which Cycles has few samples."""
    inner = slice(PIXELS // 2 - 1, PIXELS // 2 + 1)
    cycles, found = (cells[:, inner, :, inner] for cells in beside_cycles(scene, folder))
    return np.abs(found - cycles).max()


def instances_on_a_grid(inner):
    """Instances of an object by geometry nodes, one in each cell."""
    host = mesh_object("host", [(0.5, 0.5, 0)], [])
    group = bpy.data.node_groups.new("instances", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    points = group.nodes.new("GeometryNodeMeshGrid")
    for socket, value in zip(points.inputs, (SIDE - 1, SIDE - 1, SIDE, SIDE), strict=False):
        socket.default_value = value
    what = group.nodes.new("GeometryNodeObjectInfo")
    what.inputs["Object"].default_value = inner
    what.inputs["As Instance"].default_value = True
    instances, out = group.nodes.new("GeometryNodeInstanceOnPoints"), group.nodes.new("NodeGroupOutput")
    group.links.new(points.outputs["Mesh"], instances.inputs["Points"])
    group.links.new(what.outputs["Geometry"], instances.inputs["Instance"])
    group.links.new(instances.outputs["Instances"], out.inputs[0])
    host.modifiers.new("instances", "NODES").node_group = group
    host.location = SIDE / 2, SIDE / 2, 0


OUTPUTS = [
    ("NewGeometry", "Position"),
    ("NewGeometry", "Normal"),
    *(("ObjectInfo", name) for name in ("Location", "Color", "Alpha", "Object Index", "Random")),
]


@pytest.mark.parametrize(("kind", "output"), OUTPUTS)
def test_objects_that_share_a_mesh_have_the_values_of_cycles(scene, tmp_path, kind, output):
    grid(square(glow(kind, output)))
    made = sync()
    assert len(made.geometries) == 1
    assert not made.warnings
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS


def test_objects_with_meshes_of_their_own_do_so_too(scene, tmp_path):
    material = glow("ObjectInfo", "Random")
    for number, one in enumerate(grid(square(material))):
        one.data = square(material)
        one.data.vertices[0].co.x -= 0.001 * number
    assert len(sync().geometries) == SIDE * SIDE
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS


@pytest.mark.parametrize("kind", ["OBJECT", "INSTANCER", "VIEW_LAYER"])
@pytest.mark.parametrize("name", ["mine", "color"])
def test_attributes_of_objects_and_view_layers_are_read(scene, tmp_path, kind, name):
    made = glow("Attribute", "Color", attribute_type=kind, attribute_name=name)
    value = node(made.node_tree, "ShaderNodeObjectInfo").outputs["Random"]
    emission = next(n for n in made.node_tree.nodes if n.bl_idname == "ShaderNodeEmission")
    made.node_tree.links.new(value, emission.inputs["Strength"])
    bpy.context.view_layer["mine"] = [0.2, 0.5, 0.7]
    for number, one in enumerate(grid(square(made))):
        one["mine"] = [number / 16, 0.5, 1.0] if number % 2 else number / 16
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS


def test_coordinates_of_another_object_are_read(scene, tmp_path):
    other = bpy.data.objects.new("other", None)
    other.location, other.rotation_euler, other.scale = (1, 2, 3), (0.3, 0.2, 0.1), (2, 3, 1)
    bpy.context.collection.objects.link(other)
    grid(square(glow("TexCoord", "Object", object=other)))
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS
    synchronizer = Synchronizer()
    before = sync(synchronizer).instances.objects
    other.location.x = 4
    after = sync(synchronizer).instances.objects
    assert any((before[name] != after[name]).any() for name in before)


def test_instances_of_a_collection_have_the_values_of_cycles(scene, tmp_path):
    inside = bpy.data.collections.new("inside")
    inside.objects.link(bpy.data.objects.new("inner", square(glow("ObjectInfo", "Random"))))
    for one in grid(None):
        one.instance_type, one.instance_collection = "COLLECTION", inside
    assert len(sync().geometries) == 1
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS


def test_instances_of_geometry_nodes_have_the_values_of_cycles(scene, tmp_path):
    instances_on_a_grid(bpy.data.objects.new("inner", square(glow("ObjectInfo", "Random"))))
    made = sync()
    assert (len(made.geometries), len(made.instances)) == (1, SIDE * SIDE)
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS


def test_instances_of_particles_have_the_values_of_cycles(scene, tmp_path):
    inner = mesh_object("inner", [tuple(corner) for corner in np.eye(3)], [(0, 1, 2)])
    inner.location.x = 100
    inner.data.materials.append(glow("ObjectInfo", "Random"))
    emitter = mesh_object("emitter", [(0, 0, 0), (SIDE, 0, 0), (SIDE, SIDE, 0), (0, SIDE, 0)], [(0, 1, 2, 3)])
    emitter.modifiers.new("particles", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.count, settings.frame_start, settings.frame_end, settings.physics_type = 8, 1, 1, "NO"
    settings.render_type, settings.instance_object, settings.particle_size = "OBJECT", inner, 1
    scene.frame_set(2)
    scene.render.resolution_x = scene.render.resolution_y = 32 * SIDE
    cycles, found = beside_cycles(scene, tmp_path)
    inside = found > 0.5  # triangles; they light their emitter in Cycles alone
    assert inside.mean() > 0.05  # measured 0.0996
    assert np.median(np.abs(found - cycles)[inside]) < HALF_FLOATS


@pytest.mark.parametrize("link", ["Alpha", "Transmission"])
def test_alpha_of_the_object_is_blended_and_casts_shadows_by_it(scene, tmp_path, link):
    made = new_material("alpha")
    random = node(made.node_tree, "ShaderNodeObjectInfo").outputs["Random"]
    clear = node(made.node_tree, "ShaderNodeBsdfTransparent").outputs[0]
    dull = node(made.node_tree, "ShaderNodeBsdfDiffuse", {"Color": (0.2, 0.7, 0.4, 1)}).outputs[0]
    if link == "Transmission":
        clear = node(made.node_tree, "ShaderNodeBsdfTransparent", {"Color": (1, 0.5, 0.25, 1)}).outputs[0]
    both = node(made.node_tree, "ShaderNodeMixShader", {"Fac": random, "Shader": clear, "Shader_001": dull})
    node(made.node_tree, "ShaderNodeOutputMaterial", {"Surface": both.outputs[0]})
    floor = mesh_object("floor", [(-9, -9, -0.2), (9, -9, -0.2), (9, 9, -0.2), (-9, 9, -0.2)], [(0, 1, 2, 3)])
    floor.data.materials.append(new_material("floor"))
    tree = floor.data.materials[0].node_tree
    node(tree, "ShaderNodeOutputMaterial", {"Surface": node(tree, "ShaderNodeBsdfDiffuse").outputs[0]})
    grid(square(made))
    light = bpy.data.lights.new("light", "SUN")
    light.energy, light.angle = 3, 0
    sun = bpy.data.objects.new("light", light)
    sun.rotation_euler = 0.4, 0.5, 0
    scene.collection.objects.link(sun)
    scene.cycles.samples = 256
    cycles, found = beside_cycles(scene, tmp_path)
    difference = np.abs(found.mean(axis=(1, 3)) - cycles.mean(axis=(1, 3))).max()
    assert difference < 0.04 * cycles.mean()  # measured 0.032, at edges of shadows in 64 pixels


def test_curves_of_several_objects_have_the_values_of_cycles(scene, tmp_path):
    curve = bpy.data.curves.new("curve", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.3
    curve.splines.new("POLY").points.add(1)
    curve.splines[0].points[0].co, curve.splines[0].points[1].co = (-0.45, 0, 0, 1), (0.45, 0, 0, 1)
    curve.materials.append(glow("ObjectInfo", "Random"))
    grid(curve)
    assert not sync().warnings
    assert difference_in_middles(scene, tmp_path) < HALF_FLOATS


def test_an_edit_of_an_object_changes_its_values(scene):
    made = glow("ObjectInfo", "Color")
    objects = grid(square(made))
    synchronizer = Synchronizer()
    before = sync(synchronizer)
    objects[5].color = (0.9, 0.1, 0.3, 1)
    after = sync(synchronizer)
    changed = (after.instances.objects["color"] != before.instances.objects["color"]).any(axis=1)
    assert changed.sum() == 1
    assert np.allclose(after.instances.objects["color"][changed], (0.9, 0.1, 0.3, 1))
    assert after.geometries[0].key == before.geometries[0].key


def test_an_edit_is_seen_by_a_renderer_that_drew_before(scene, tmp_path):
    objects = grid(square(glow("ObjectInfo", "Color")))
    scene.render.engine = "POINTSPLAT"
    first = picture(scene, tmp_path)
    objects[5].color = (0.9, 0.1, 0.3, 1)
    second = picture(scene, tmp_path)
    changed = (np.abs(first - second).max(axis=2) > 0.01).reshape(SIDE, PIXELS, SIDE, PIXELS).any(axis=(1, 3))
    assert changed[1, 1]
    assert changed.sum() == 1


def test_techniques_that_show_instances_alike_say_so(scene):
    grid(square(glow("ObjectInfo", "Random")))
    made = sync()
    assert not shown_alike(made, "VISIBILITY")
    (warning,) = shown_alike(made, "EWA")
    assert '"one ' in warning


def test_what_reads_no_object_has_no_values(scene):
    grid(square(glow("TexCoord", "Generated")))
    made = sync()
    assert not made.instances.objects
    assert not made.geometries[0].mesh.objects


def test_instances_of_points_are_named(scene):
    data = bpy.data.meshes.new("points")
    data.from_pydata([(0, 0, 0), (0.1, 0, 0)], [], [])
    data.materials.append(glow("ObjectInfo", "Random"))
    instances_on_a_grid(bpy.data.objects.new("dots", data))
    warnings = [warning for warning in sync().warnings if "look as the first" in warning]
    assert len(warnings) == 1
    assert "dots" in warnings[0]


def test_values_of_faces_are_cycles(scene, tmp_path):
    """Of faces with three, four and five corners, cut into triangles."""
    data = bpy.data.meshes.new("faces")
    rows = [[(0, 0), (2, 0), (2, 2), (0, 2)], [(2, 0), (4, 0), (4, 2), (3, 1), (2, 2)], [(0, 2), (4, 2), (0, 4)]]
    data.from_pydata([(x, y, 0) for row in rows for x, y in row], [], [range(4), range(4, 9), range(9, 12)])
    data.attributes.new("of faces", "FLOAT", "FACE").data.foreach_set("value", [0.75, 0.25, 1.5])
    data.materials.append(glow("Attribute", "Color", attribute_name="of faces"))
    bpy.context.collection.objects.link(bpy.data.objects.new("faces", data))
    want = np.array([0.75, 0.75, 0.25, 1.5]) / 8 + 0.5  # in cells that one face fills
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        cells = picture(scene, tmp_path)[..., :3].reshape(SIDE, PIXELS, SIDE, PIXELS, 3)[:, 3:5, :, 3:5]
        found = cells.mean(axis=(1, 3, 4))[[0, 1, 0, 2], [0, 0, 3, 0]]
        np.testing.assert_allclose(found, want, atol=1e-6)  # measured 6e-8
