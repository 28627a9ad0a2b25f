"""Material inputs against Cycles: both evaluate the same node trees at the same points of a plane."""

import math

import numpy as np
import pytest

from pointsplat_addon.core.material import color_models, expression
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, math_functions, ramp_nodes, texture_nodes

bpy = pytest.importorskip("bpy")


from pointsplat_addon.core.material.baking import bake, bakeable, suggested_resolution
from pointsplat_addon.core.material.evaluation import evaluate_samples, triangle_tangents
from pointsplat_addon.core.material.expression import SampleInputs
from pointsplat_addon.core.material.graph import needs
from pointsplat_addon.core.numeric.cryptomatte import cryptomatte_hash
from pointsplat_addon.host.convert.material import images
from pointsplat_addon.host.convert.material.materials import convert_material, convert_materials
from pointsplat_addon.host.convert.material.nodes.colors import curve_table
from tests.support.blender.scenes import new_material, node

TILE = 24  # pixels along a side of each case's plane
CORNERS = np.array([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)], np.float32)


def f32(values):
    return np.array(values, np.float32)


def uv_of(position):
    """The UV map (N, 2): turned by 25 degrees, 1.8 pictures wide, beginning left of the first."""
    c, s = math.cos(math.radians(25)), math.sin(math.radians(25))
    return position[:, :2] @ np.array([[c, s], [-s, c]]) * 1.8 + (0.3, 0.4)


def color_of(position):
    """The colour attribute (N, 4), affine in the position."""
    x, y = position[:, 0] + 0.5, position[:, 1] + 0.5
    return np.stack([0.1 + 0.8 * x, 0.9 - 0.7 * y, 0.2 + 0.3 * x + 0.4 * y, 0.3 + 0.6 * y], axis=1)


# Trees


def output(made, identifier=None):
    return next(s for s in made.outputs if identifier in (None, s.identifier))


def uv(tree):
    return output(node(tree, "ShaderNodeTexCoord"), "UV")


def varying(tree):
    return output(node(tree, "ShaderNodeVertexColor", layer_name="Col"))


def scalar(tree, channel="Red"):
    return output(node(tree, "ShaderNodeSeparateColor", {"Color": varying(tree)}), channel)


def signed(tree):
    """A vector with components of both signs."""
    return output(
        node(tree, "ShaderNodeVectorMath", {"Vector": varying(tree), "Vector_001": (0.5,) * 3}, operation="SUBTRACT")
    )


def emitting(name, build):
    """A material that emits what `build` returns."""
    material = new_material(name)
    tree = material.node_tree
    emission = node(tree, "ShaderNodeEmission", {"Color": build(tree)})
    tree.links.new(emission.outputs[0], node(tree, "ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def picture(name="Test", width=5, height=3, space="sRGB", is_float=False, alpha=False):
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = space
    texels = np.random.default_rng(7).random((height, width, 4), np.float32)
    texels[..., 3] = np.maximum(texels[..., 3], 0.2) if alpha else 1
    if is_float:
        texels[..., :3] *= texels[..., 3:]
    image.pixels.foreach_set(texels.ravel())
    image.update()
    return image


def texture(tree, vector=None, **properties):
    image_properties = {k: properties.pop(k) for k in ("space", "is_float", "alpha") if k in properties}
    inputs = {} if vector is None else {"Vector": vector}
    return node(tree, "ShaderNodeTexImage", inputs, image=picture(**image_properties), **properties)


# Cases: each is a tree whose output is what the plane emits

CASES = {}


def case(build, name=None):
    CASES[name or build.__name__] = build
    return build


def math_case(operation):
    def build(tree):
        values = {
            "Value": output(node(tree, "ShaderNodeSeparateXYZ", {"Vector": signed(tree)})),
            "Value_001": scalar(tree, "Blue"),
            "Value_002": 0.3,
        }
        if operation in ("POWER", "LOGARITHM", "SQRT", "INVERSE_SQRT"):
            values["Value"] = scalar(tree)
        return output(node(tree, "ShaderNodeMath", values, operation=operation))

    case(build, f"math {operation}")


def vector_case(operation):
    def build(tree):
        second = (0.4, 0.7, -0.2) if operation not in ("WRAP", "POWER", "SNAP", "MODULO") else (0.3, 0.2, 0.45)
        first = varying(tree) if operation == "POWER" else signed(tree)
        values = {"Vector": first, "Vector_001": second, "Vector_002": (0.1, -0.1, 0.15), "Scale": 0.8}
        made = node(tree, "ShaderNodeVectorMath", values, operation=operation)
        return next(s for s in made.outputs if s.enabled)

    case(build, f"vector {operation}")


def blend_case(blend):
    def build(tree):
        inputs = {"Factor_Float": scalar(tree, "Green"), "A_Color": varying(tree), "B_Color": (0.2, 0.9, 0.6, 1)}
        mix = node(tree, "ShaderNodeMix", inputs, data_type="RGBA", blend_type=blend)
        return output(mix, "Result_Color")

    case(build, f"blend {blend}")


def mapping_case(kind):
    def build(tree):
        inputs = {"Vector": uv(tree), "Location": (0.1, 0.2, 0.3), "Rotation": (0.3, 0.2, 0.9), "Scale": (2, 0.7, 1.5)}
        return output(node(tree, "ShaderNodeMapping", inputs, vector_type=kind))

    case(build, f"mapping {kind}")


def extension_case(extension, interpolation):
    case(
        lambda t: output(texture(t, extension=extension, interpolation=interpolation)),
        f"image {extension} {interpolation}",
    )


def model_case(mode):
    def build(tree):
        separate = node(tree, "ShaderNodeSeparateColor", {"Color": varying(tree)}, mode=mode)
        paler = node(tree, "ShaderNodeMath", {"Value": separate.outputs[1], "Value_001": 0.7}, operation="MULTIPLY")
        parts = {"Red": separate.outputs[0], "Green": paler.outputs[0], "Blue": separate.outputs[2]}
        return output(node(tree, "ShaderNodeCombineColor", parts, mode=mode))

    case(build, f"color model {mode}")


def range_case(kind, vector):
    def build(tree):
        if vector:
            inputs = {"Vector": varying(tree), "From_Min_FLOAT3": (0.2,) * 3, "From_Max_FLOAT3": (0.83, 0.13, 0.2)}
            inputs |= {"To_Min_FLOAT3": (0.1, 0.9, 0.2), "To_Max_FLOAT3": (0.7, 0.3, 2), "Steps_FLOAT3": (3, 4, 5)}
        else:
            inputs = {
                "Value": scalar(tree),
                "From Min": 0.2,
                "From Max": 0.73,
                "To Min": 0.9,
                "To Max": 0.1,
                "Steps": 3,
            }
        made = node(
            tree, "ShaderNodeMapRange", inputs, interpolation_type=kind, data_type="FLOAT_VECTOR" if vector else "FLOAT"
        )
        return output(made, "Vector" if vector else "Result")

    case(build, f"range {kind} {'vector' if vector else 'float'}")


for operation in math_functions.MATH:
    math_case(operation)
for operation in sorted(
    set(math_functions.VECTOR_MATH) - ({"POWER", "SIGN", "ROUND"} if bpy.app.version < (5,) else set())
):
    vector_case(operation)
for blend in color_nodes.BLEND:
    blend_case(blend)
for kind in ("POINT", "TEXTURE", "VECTOR", "NORMAL"):
    mapping_case(kind)
for extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
    for interpolation in ("Linear", "Closest", "Cubic"):
        extension_case(extension, interpolation)
for mode in ("RGB", "HSV", "HSL"):
    model_case(mode)
for kind in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"):
    range_case(kind, False)
    range_case(kind, True)

case(lambda t: output(texture(t, space="Non-Color")), "image data")
case(lambda t: output(texture(t, is_float=True, space="Linear Rec.709")), "image float")
case(lambda t: output(texture(t, alpha=True)), "image associated")
case(lambda t: output(node(t, "ShaderNodeTexImage")), "image none")
case(lambda t: output(node(t, "ShaderNodeUVMap", uv_map="absent")), "uv absent")
case(lambda t: output(node(t, "ShaderNodeUVMap", uv_map="UVMap")), "uv named")
case(lambda t: output(node(t, "ShaderNodeVertexColor", layer_name="absent")), "color absent")
case(lambda t: output(node(t, "ShaderNodeVertexColor", layer_name="")), "color active")
case(lambda t: output(node(t, "ShaderNodeVertexColor", layer_name="Col"), "Alpha"), "color alpha")
case(lambda t: output(node(t, "ShaderNodeTexCoord"), "Generated"), "generated")
case(lambda t: output(node(t, "ShaderNodeTexCoord"), "Object"), "object coordinates")
case(lambda t: output(node(t, "ShaderNodeTexCoord"), "Normal"), "object normal")
for name in ("Col", "UVMap", "absent"):
    for socket in ("Color", "Vector", "Fac", "Alpha"):
        case(
            lambda t, n=name, s=socket: output(node(t, "ShaderNodeAttribute", attribute_name=n), s),
            f"attribute {name} {socket}",
        )
case(lambda t: output(node(t, "ShaderNodeInvert", {"Fac": 0.7, "Color": varying(t)})), "invert")
case(lambda t: output(node(t, "ShaderNodeGamma", {"Gamma": 2.2, "Color": varying(t)})), "gamma")
case(lambda t: output(node(t, "ShaderNodeRGBToBW", {"Color": varying(t)})), "gray")
case(lambda t: output(node(t, "ShaderNodeMath", {"Value": varying(t), "Value_001": 0.0})), "implicit gray")
case(lambda t: output(node(t, "ShaderNodeMath", {"Value": uv(t), "Value_001": 0.0})), "implicit mean")
case(
    lambda t: output(node(t, "ShaderNodeBrightContrast", {"Bright": -0.1, "Contrast": 0.4, "Color": varying(t)})),
    "bright contrast",
)
case(
    lambda t: output(
        node(
            t,
            "ShaderNodeHueSaturation",
            {"Hue": 0.63, "Saturation": 1.4, "Value": 0.9, "Fac": 0.8, "Color": varying(t)},
        )
    ),
    "hue saturation",
)
for kind in ("MINMAX", "RANGE"):
    case(
        lambda t, k=kind: output(
            node(t, "ShaderNodeClamp", {"Value": scalar(t), "Min": 0.7, "Max": 0.3}, clamp_type=k)
        ),
        f"clamp {kind}",
    )


@case
def mix_float(tree):
    inputs = {"Factor_Float": scalar(tree), "A_Float": -0.5, "B_Float": 2.0}
    return output(node(tree, "ShaderNodeMix", inputs, data_type="FLOAT", clamp_factor=False), "Result_Float")


@case
def mix_vector_by_components(tree):
    inputs = {"Factor_Vector": varying(tree), "A_Vector": (0, 0.2, 1), "B_Vector": (1, 0.8, 0.1)}
    made = node(tree, "ShaderNodeMix", inputs, data_type="VECTOR", factor_mode="NON_UNIFORM")
    return output(made, "Result_Vector")


@case
def mix_legacy(tree):
    inputs = {"Fac": 1.5, "Color1": varying(tree), "Color2": (0.9, 0.5, 0.9, 1)}
    return output(node(tree, "ShaderNodeMixRGB", inputs, blend_type="ADD", use_clamp=True))


@case
def image_straight(tree):
    made = texture(tree, alpha=True)
    half = node(tree, "ShaderNodeMath", {"Value": made.outputs["Alpha"], "Value_001": 0.5}, operation="MULTIPLY")
    return output(node(tree, "ShaderNodeMixRGB", {"Fac": half.outputs[0], "Color1": made.outputs["Color"]}))


@case
def image_mapped(tree):
    moved = node(tree, "ShaderNodeMapping", {"Vector": uv(tree), "Scale": (3, 2, 1), "Rotation": (0, 0, 0.4)})
    return output(texture(tree, moved.outputs[0]))


@case
def ramp(tree):
    made = node(tree, "ShaderNodeValToRGB", {"Fac": scalar(tree)})
    made.color_ramp.elements[0].color = (0.9, 0.1, 0.3, 1)
    made.color_ramp.elements.new(0.4).color = (0.2, 0.8, 0.5, 0.5)
    return output(made)


@case
def rgb_curves(tree):
    made = node(tree, "ShaderNodeRGBCurve", {"Fac": 0.9, "Color": varying(tree)})
    bend(made.mapping)
    return output(made)


@case
def float_curve(tree):
    made = node(tree, "ShaderNodeFloatCurve", {"Factor": 0.8, "Value": scalar(tree)})
    made.mapping.curves[0].points.new(0.3, 0.8)
    made.mapping.update()
    return output(made)


@case
def vector_curves(tree):
    made = node(tree, "ShaderNodeVectorCurve", {"Fac": 1.0, "Vector": signed(tree)})
    made.mapping.curves[1].points.new(0.1, 0.6)
    made.mapping.update()
    return output(made)


def bend(mapping):
    for index, point in ((0, (0.3, 0.7)), (1, (0.6, 0.2)), (3, (0.5, 0.65))):
        mapping.curves[index].points.new(*point)
    mapping.update()


def normal_case(name, **properties):
    def build(tree):
        inputs = {"Strength": properties.get("strength", 1.0), "Color": output(texture(tree, space="Non-Color"))}
        settings = {k: v for k, v in properties.items() if k != "strength"}
        # Normals are shown as colours, moved up from negative values
        made = node(tree, "ShaderNodeNormalMap", inputs, **settings)
        return output(node(tree, "ShaderNodeVectorMath", {"Vector": made.outputs[0], "Vector_001": (1, 1, 1)}))

    case(build, f"normal map {name}")


normal_case("tangent", uv_map="UVMap")
normal_case("tangent of the active map")
normal_case("weak", uv_map="UVMap", strength=0.4)
normal_case("strong", uv_map="UVMap", strength=1.7)
normal_case("object", space="OBJECT", strength=0.6)
normal_case("object, legacy axes", space="BLENDER_OBJECT")
if bpy.app.version >= (5, 0, 0):
    normal_case("DirectX", uv_map="UVMap", convention="DIRECTX")


@case
def groups_reroutes_and_muted_nodes(tree):
    inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    inner.interface.new_socket("In", in_out="INPUT", socket_type="NodeSocketColor")
    inner.interface.new_socket("Unlinked", in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.25
    inner.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, end = inner.nodes.new("NodeGroupInput"), inner.nodes.new("NodeGroupOutput")
    mix = node(inner, "ShaderNodeMixRGB", {"Fac": start.outputs[1], "Color1": start.outputs[0], "Color2": (0, 1, 0, 1)})
    inner.links.new(mix.outputs[0], end.inputs[0])
    group = tree.nodes.new("ShaderNodeGroup")
    group.node_tree = inner
    group.inputs[1].default_value = 0.75
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(varying(tree), reroute.inputs[0])
    tree.links.new(reroute.outputs[0], group.inputs[0])
    gamma = node(tree, "ShaderNodeGamma", {"Color": group.outputs[0], "Gamma": 5.0})
    gamma.mute = True
    return output(gamma)


# The pictures


@pytest.fixture(scope="module")
def atlas(tmp_path_factory):
    """For each case its material, the pixels (N, 3) of Cycles and the positions (N, 3) on the plane they show."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    materials = {name: emitting(name, build) for name, build in CASES.items()}
    columns = math.ceil(math.sqrt(len(CASES)))
    scene = bpy.context.scene
    objects = [plane(scene, materials[name], i % columns, i // columns) for i, name in enumerate(CASES)]
    path = tmp_path_factory.mktemp("cycles") / "atlas.exr"
    shown = cycles(scene, columns, path)
    # The same pixels with the position as colour tell where in each pixel Cycles took its sample
    where = emitting(
        "where",
        lambda t: output(
            node(
                t,
                "ShaderNodeVectorMath",
                {"Vector": output(node(t, "ShaderNodeTexCoord"), "Object"), "Vector_001": (1, 1, 1)},
            )
        ),
    )
    for made in objects:
        made.material_slots[0].material = where
    position = cycles(scene, columns, path) - 1

    def tile(pixels, i):
        rows, cols = (slice(k * TILE, (k + 1) * TILE) for k in (i // columns, i % columns))
        return pixels[rows, cols].reshape(-1, 3)

    return {name: (materials[name], tile(shown, i), tile(position, i)) for i, name in enumerate(CASES)}


def plane(scene, material, column, row):
    if "plane" not in bpy.data.meshes:
        mesh = bpy.data.meshes.new("plane")
        mesh.from_pydata(CORNERS.tolist(), [], [(0, 1, 2, 3)])
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uv_of(CORNERS).astype(np.float32).ravel())
        colors = mesh.color_attributes.new("Col", "FLOAT_COLOR", "POINT")
        colors.data.foreach_set("color", color_of(CORNERS).astype(np.float32).ravel())
        mesh.materials.append(None)
    made = bpy.data.objects.new(material.name, bpy.data.meshes["plane"])
    made.location = (column + 0.5, row + 0.5, 0)
    made.material_slots[0].link = "OBJECT"
    made.material_slots[0].material = material
    scene.collection.objects.link(made)
    return made


def cycles(scene, columns, path):
    """The pixels (H, W, 3) of one sample each, taken near the pixels' centres."""
    if scene.camera is None:
        camera = bpy.data.cameras.new("camera")
        camera.type, camera.ortho_scale = "ORTHO", columns
        scene.camera = bpy.data.objects.new("camera", camera)
        scene.camera.location = (columns / 2, columns / 2, 1)
        scene.collection.objects.link(scene.camera)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.filter_width = 1, 0.01
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x = scene.render.resolution_y = columns * TILE
    if bpy.app.version >= (5, 0, 0):
        scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(columns * TILE, columns * TILE, -1)[..., :3]


def samples(position):
    """Everything that a graph may read at positions (N, 3) of the plane."""
    tangent, sign = triangle_tangents(CORNERS[None, :3], uv_of(CORNERS)[None, :3])
    count = len(position)
    return SampleInputs(
        uv={"UVMap": uv_of(position).astype(np.float32)},
        active_uv="UVMap",
        colors={"Col": color_of(position).astype(np.float32)},
        position=position,
        # The flat side of a mesh is in the middle of its texture space
        generated=np.column_stack([position[:, :2] + 0.5, np.full(count, 0.5)]).astype(np.float32),
        normal=np.tile(f32([0, 0, 1]), (count, 1)),
        tangent=np.tile(tangent, (count, 1)),
        bitangent_sign=np.tile(sign, count),
    )


def graph_of(row):
    assert row.graph is not None
    return row.graph


def emitted(material, position):
    row = convert_material(material)
    if row.graph is None:
        return np.tile(row.constants["emission"], (len(position), 1)), row
    emission = graph_of(row).emission
    assert emission is not None
    return expression.evaluate(emission, samples(position)), row


@pytest.mark.parametrize("name", list(CASES))
def test_every_node_gives_what_cycles_renders(atlas, name):
    material, shown, position = atlas[name]
    mine, row = emitted(material, position)
    assert bool(row.warnings) == (name == "image none")
    # measured 6e-5 (normal maps of bytes), 4e-5 (RGB curves, luminance), below 1.2e-5 elsewhere
    assert np.abs(mine - shown).max() < 1e-4


# Tables that Blender evaluates itself


@pytest.mark.parametrize("hue", ["NEAR", "FAR", "CW", "CCW"])
@pytest.mark.parametrize("mode", ["RGB", "HSV", "HSL"])
@pytest.mark.parametrize("interpolation", ["LINEAR", "EASE", "CONSTANT", "CARDINAL", "B_SPLINE"])
@pytest.mark.parametrize("stops", [1, 2, 5])
def test_color_ramps_are_blenders(stops, interpolation, mode, hue):
    rng = np.random.default_rng(stops)
    material = new_material("ramp")
    made = node(material.node_tree, "ShaderNodeValToRGB")
    ramp = made.color_ramp
    ramp.interpolation, ramp.color_mode, ramp.hue_interpolation = interpolation, mode, hue
    if stops == 1:
        ramp.elements.remove(ramp.elements[1])
    for position in rng.uniform(0.1, 0.9, max(stops - 2, 0)):
        ramp.elements.new(position)
    for element in ramp.elements:
        element.color = rng.random(4)
    ramp.elements[0].position = 0.07
    x = np.linspace(-0.2, 1.2, 300, dtype=np.float32)
    expected = np.array([tuple(ramp.evaluate(v)) for v in x.tolist()])
    stops_read = sorted(ramp.elements, key=lambda e: e.position)
    mine = ramp_nodes.ColorRamp(
        input_nodes.ColorAttribute(),
        np.array([e.position for e in stops_read], np.float32),
        np.array([tuple(e.color) for e in stops_read], np.float32),
        interpolation,
        mode,
        hue,
    )
    found = expression.evaluate(mine, SampleInputs(colors={"x": np.repeat(x[:, None], 4, axis=1)}))
    assert np.abs(found - expected).max() < 2e-6  # measured 7.5e-7


@pytest.mark.parametrize("extend", ["HORIZONTAL", "EXTRAPOLATED"])
@pytest.mark.parametrize("clip", [False, True])
def test_curves_are_blenders(extend, clip):
    material = new_material("curve")
    mapping = node(material.node_tree, "ShaderNodeRGBCurve").mapping
    bend(mapping)
    mapping.extend, mapping.use_clip = extend, clip
    mapping.update()
    mapping.initialize()
    x = np.linspace(-0.5, 1.5, 1001, dtype=np.float32)
    for index in range(4):
        expected = [mapping.evaluate(mapping.curves[index], v) for v in x.tolist()]
        assert np.abs(curve_table(mapping, index)(x) - expected).max() < 2e-6  # measured 2.4e-7


# Surfaces


def surface(name, build):
    """A material whose surface is the shader output that `build` returns."""
    material = new_material(name)
    tree = material.node_tree
    tree.links.new(build(tree), node(tree, "ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def principled(tree, **inputs):
    return output(node(tree, "ShaderNodeBsdfPrincipled", {k.replace("_", " "): v for k, v in inputs.items()}))


def test_layers_of_principled_surfaces_that_are_left_out_are_named():
    lacquer = surface("lacquer", lambda t: principled(t, Subsurface_Weight=0.5, Thin_Film_Thickness=300.0))
    table, warnings = convert_materials([lacquer])
    assert len(table) == 2
    assert warnings == [
        'Material "lacquer": node "Principled BSDF" is drawn without its subsurface scattering and thin film'
    ]


def test_coats_are_columns_of_their_own_and_mix_by_weight():
    given = {"Coat_Weight": 0.5, "Coat_Roughness": 0.25, "Coat_IOR": 1.75, "Coat_Tint": (0.5, 0.25, 1, 1)}

    def half(tree):
        plain = output(node(tree, "ShaderNodeBsdfDiffuse"))
        mixed = {"Fac": 0.5, "Shader": principled(tree, **given), "Shader_001": plain}
        return output(node(tree, "ShaderNodeMixShader", mixed))

    table, warnings = convert_materials([surface("all", lambda t: principled(t, **given)), surface("half", half)])
    assert not warnings
    assert table.coat is not None
    np.testing.assert_allclose(table.coat.weight, [0, 0.5, 0.25])
    np.testing.assert_allclose(table.coat.roughness[1:], 0.25)
    np.testing.assert_allclose(table.coat.ior[1:], 1.75)
    np.testing.assert_allclose(table.coat.tint[1:], [[0.5, 0.25, 1]] * 2)
    assert convert_materials([surface("bare", principled)])[0].coat is None


def test_what_is_lit_from_behind_is_a_share_of_the_colour():
    leaf = {"Color": (0.2, 0.6, 0.1, 1)}

    def mixed(tree, front, factor):
        behind = output(node(tree, "ShaderNodeBsdfTranslucent", leaf))
        diffuse = output(node(tree, "ShaderNodeBsdfDiffuse", front))
        return output(node(tree, "ShaderNodeMixShader", {"Fac": factor, "Shader": diffuse, "Shader_001": behind}))

    def image_colored(tree):
        return mixed(tree, {"Color": node(tree, "ShaderNodeTexNoise").outputs["Color"]}, 0.25)

    found = [
        surface("alone", lambda t: output(node(t, "ShaderNodeBsdfTranslucent", leaf))),
        surface("mixed", lambda t: mixed(t, {"Color": (0.6, 0.2, 0, 1)}, 0.5)),
        surface("of varying colour", image_colored),
        surface("in part", lambda t: mixed(t, leaf, node(t, "ShaderNodeTexNoise").outputs[0])),
    ]
    table, warnings = convert_materials(found)
    expected = [[0] * 3, [1] * 3, [0.25, 0.75, 1], [0.25] * 3, [0] * 3]
    assert table.backlit is not None
    np.testing.assert_allclose(table.backlit, expected, atol=1e-6)
    assert warnings == ['Material "in part": its translucency varies, and is lit from the front']
    assert convert_materials([surface("bare", principled)])[0].backlit is None


def test_tints_roughness_and_sheen_are_columns_that_scenes_without_them_lack():
    given = {"Specular_Tint": (1, 0.5, 0.25, 1), "Diffuse_Roughness": 0.5, "Sheen_Weight": 0.5, "Sheen_Roughness": 0.25,
             "Sheen_Tint": (1, 0.5, 0, 1)}  # fmt: skip

    def half(tree):
        """With a black one, whose own parameters nobody sees."""
        mixed = {
            "Fac": 0.5,
            "Shader": principled(tree, **given),
            "Shader_001": output(node(tree, "ShaderNodeEmission")),
        }
        return output(node(tree, "ShaderNodeMixShader", mixed))

    table, warnings = convert_materials([surface("all", lambda t: principled(t, **given)), surface("half", half)])
    assert not warnings
    assert table.tint is not None
    assert table.diffuse_roughness is not None
    assert table.sheen is not None
    np.testing.assert_allclose(table.tint, [[1, 1, 1], *[[1, 0.5, 0.25]] * 2])
    np.testing.assert_allclose(table.diffuse_roughness, [0, 0.5, 0.5])
    np.testing.assert_allclose(table.sheen, [[0, 0, 0, 0.5], [0.5, 0.25, 0, 0.25], [0.25, 0.125, 0, 0.25]])
    bare = convert_materials([surface("bare", principled)])[0]
    assert (bare.tint, bare.gloss, bare.diffuse_roughness, bare.sheen, bare.toon, bare.holdout) == (None,) * 6
    assert bare.graphs[1] is None


def test_a_toon_is_a_column_and_so_is_a_holdout():
    def cut(tree):
        held = output(node(tree, "ShaderNodeHoldout"))
        mixed = {"Fac": 0.25, "Shader": principled(tree, Base_Color=(0.2, 0.4, 0.6, 1)), "Shader_001": held}
        return output(node(tree, "ShaderNodeMixShader", mixed))

    toon = surface("toon", lambda t: output(node(t, "ShaderNodeBsdfToon", {"Size": 0.25, "Smooth": 0.75})))
    table, warnings = convert_materials([toon, surface("cut", cut)])
    assert not warnings
    assert table.toon is not None
    assert table.holdout is not None
    np.testing.assert_allclose(table.toon, [[-1, -1], [0.25, 0.75], [-1, -1]])
    np.testing.assert_allclose(table.holdout, [0, 0, 0.25])
    np.testing.assert_allclose(table.base_color[2], f32([0.2, 0.4, 0.6]))


def test_a_conductor_reflects_what_its_indices_say():
    """Gold at 1: ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2)."""
    n, k = np.array([0.18, 0.42, 1.37]), np.array([3.42, 2.35, 1.77])
    gold = surface(
        "gold",
        lambda t: output(
            node(t, "ShaderNodeBsdfMetallic", {"IOR": n, "Extinction": k}, fresnel_type="PHYSICAL_CONDUCTOR")
        ),
    )
    table, warnings = convert_materials([gold])
    assert not warnings
    assert table.metallic[1] == 1
    np.testing.assert_allclose(table.base_color[1], ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), rtol=1e-5)


@pytest.mark.parametrize(
    ("kind", "properties", "told"),
    [
        ("ShaderNodeBsdfToon", {"component": "GLOSSY"}, "is glossy; its viewport colour is shown"),
        ("ShaderNodeBsdfRayPortal", {}, "is not supported; its viewport colour is shown"),
        ("ShaderNodeBsdfSheen", {"distribution": "ASHIKHMIN"}, "is drawn with microfibers"),
        ("ShaderNodeEeveeSpecular", {}, "is drawn as in EEVEE; Cycles has no such node, and draws it black"),
    ],
)
def test_what_surfaces_are_not_is_told(kind, properties, told):
    _, warnings = convert_materials([surface("odd", lambda t: output(node(t, kind, **properties)))])
    assert len(warnings) == 1
    assert warnings[0].startswith('Material "odd')
    assert warnings[0].endswith(told)


@pytest.mark.parametrize(("method", "told"), [("BUMP", []), ("BOTH", ["is drawn as a bump"])])
def test_displacement_raises_the_normal_of_inputs_to_which_nothing_is_linked(method, told):
    made = new_material("raised")
    tree = made.node_tree
    height = node(tree, "ShaderNodeTexNoise").outputs[0]
    raised = node(tree, "ShaderNodeDisplacement", {"Height": height}).outputs[0]
    node(tree, "ShaderNodeOutputMaterial", {"Surface": principled(tree), "Displacement": raised})
    made.displacement_method = method
    table, warnings = convert_materials([made])
    assert warnings == [f'Material "{made.name}": node "Displacement" {text}' for text in told]
    graph = table.graphs[1]
    assert isinstance(graph, MaterialGraph)
    assert set(graph.channels) == {"normal"}


def test_a_stretched_reflection_is_a_graph_and_a_round_one_is_not():
    stretched, plain = (surface("s", lambda t, a=a: principled(t, Anisotropic=a)) for a in (0.5, 0.0))
    table, warnings = convert_materials([stretched, plain])
    assert not warnings
    graph = table.graphs[1]
    assert isinstance(graph, MaterialGraph)
    assert set(graph.channels) == {"tangent"}
    assert table.graphs[2] is None


def test_a_coat_that_varies_is_left_out_with_a_warning():
    def spotted(tree):
        noise = node(tree, "ShaderNodeTexNoise").outputs[0]
        mixed = {"Fac": noise, "Shader": principled(tree, Coat_Weight=1.0), "Shader_001": principled(tree)}
        return output(node(tree, "ShaderNodeMixShader", mixed))

    table, warnings = convert_materials([surface("spotted", spotted)])
    assert table.coat is None
    assert warnings == ['Material "spotted": its coat varies, and is left out']


def test_a_table_of_constants_has_the_default_material_first():
    plain = surface(
        "plain", lambda t: principled(t, Base_Color=(0.1, 0.2, 0.3, 1), Roughness=0.7, Metallic=0.4, Alpha=0.6)
    )
    plain.pass_index, plain.use_backface_culling = 3, True
    shining = surface(
        "shining", lambda t: principled(t, Emission_Color=(0.5, 0.25, 1, 1), Emission_Strength=4.0, IOR=1.3)
    )
    table, warnings = convert_materials([plain, None, shining])
    assert warnings == []
    assert table.names == ("Default", "plain", "Default", "shining")
    assert table.graphs == (None,) * 4
    np.testing.assert_array_equal(table.base_color[1], f32([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(table.base_color[2], table.base_color[0])
    np.testing.assert_array_equal(table.roughness, f32([0.5, 0.7, 0.5, 0.5]))
    np.testing.assert_array_equal(table.metallic, f32([0, 0.4, 0, 0]))
    np.testing.assert_array_equal(table.alpha, f32([1, 0.6, 1, 1]))
    np.testing.assert_array_equal(table.emission[3], f32([2, 1, 4]))
    np.testing.assert_array_equal(table.ior, f32([1.5, 1.5, 1.5, 1.3]))
    default = 0.0 if bpy.app.version < (5, 0, 0) else 0.5  # as in Cycles
    np.testing.assert_array_equal(table.specular, f32([default, 0.5, default, 0.5]))
    np.testing.assert_array_equal(table.cull, [False, True, False, False])
    np.testing.assert_array_equal(table.pass_index, [0, 3, 0, 0])
    # Faces without a material have the identifier that Cycles writes for them
    np.testing.assert_array_equal(table.hash[[0, 2]], [0x78D05529] * 2)
    assert table.hash[1] == cryptomatte_hash("plain")


def test_a_new_material_is_the_default_surface():
    table, warnings = convert_materials([bpy.data.materials.new("fresh")])
    assert warnings == []
    for column in ("base_color", "metallic", "alpha", "emission"):
        np.testing.assert_allclose(getattr(table, column)[1], getattr(table, column)[0], atol=1e-7)  # measured 0


def test_diffuse_has_no_gloss_and_glossy_is_a_metal():
    table, _ = convert_materials(
        [
            surface("matt", lambda t: output(node(t, "ShaderNodeBsdfDiffuse", {"Color": (0.2, 0.4, 0.6, 1)}))),
            surface("mirror", lambda t: output(node(t, "ShaderNodeBsdfGlossy", {"Roughness": 0.1}))),
        ]
    )
    np.testing.assert_array_equal(table.base_color[1], f32([0.2, 0.4, 0.6]))
    np.testing.assert_array_equal(table.specular[1:], [0, 0])
    np.testing.assert_array_equal(table.metallic[1:], [0, 1])
    assert table.roughness[2] == np.float32(0.1)


def test_mixing_with_transparent_is_alpha():
    def build(tree):
        clear = node(tree, "ShaderNodeBsdfTransparent").outputs[0]
        matt = node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0.2, 0.4, 0.6, 1)}).outputs[0]
        return output(node(tree, "ShaderNodeMixShader", {"Fac": 0.3, "Shader": clear, "Shader_001": matt}))

    row = convert_material(surface("veil", build))
    assert row.constants["alpha"] == pytest.approx((0.3,))
    assert row.constants["base_color"] == pytest.approx((0.2, 0.4, 0.6))
    assert row.warnings == ()


def test_mixing_two_surfaces_mixes_their_parameters():
    def build(tree):
        metal = node(tree, "ShaderNodeBsdfGlossy", {"Color": (1, 0.5, 0, 1), "Roughness": 0.2}).outputs[0]
        matt = node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0, 0.5, 1, 1)}).outputs[0]
        mixed = node(tree, "ShaderNodeMixShader", {"Fac": scalar(tree), "Shader": metal, "Shader_001": matt})
        light = node(tree, "ShaderNodeEmission", {"Color": (1, 2, 3, 1), "Strength": 0.5}).outputs[0]
        return output(node(tree, "ShaderNodeAddShader", {"Shader": mixed.outputs[0], "Shader_001": light}))

    row = convert_material(surface("mixture", build))
    assert row.warnings == ()
    assert row.constants["emission"] == pytest.approx((0.5, 1, 1.5))
    assert row.constants["alpha"] == (1.0,)
    position = np.array([[-0.5, 0, 0], [0.5, 0, 0]], np.float32)
    out = evaluate_samples(graph_of(row), samples(position))
    f = color_of(position)[:, 0]
    np.testing.assert_allclose(out["metallic"], 1 - f, atol=1e-6)  # measured 0
    assert row.constants["roughness"] == pytest.approx((0.2,))  # what is matt has none
    assert row.constants["base_color"] == pytest.approx((0, 0.5, 1))
    assert row.gloss == pytest.approx((1, 0.5, 0, 1))


def test_each_share_of_a_constant_mixture_keeps_its_colour():
    """Of a metallic surface of one colour, and a dull one over which a glossy one is mixed."""

    def build(tree):
        first = principled(tree, Base_Color=(0.6, 0.3, 0.9, 1), Metallic=0.5)
        matt = output(node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0, 0.5, 1, 1)}))
        bright = output(node(tree, "ShaderNodeBsdfGlossy", {"Color": (0.9, 0.9, 0.9, 1)}))
        second = output(node(tree, "ShaderNodeMixShader", {"Fac": 0.4, "Shader": matt, "Shader_001": bright}))
        return output(node(tree, "ShaderNodeMixShader", {"Fac": 0.25, "Shader": first, "Shader_001": second}))

    row = convert_material(surface("mixture", build))
    base, shiny, metallic = np.array([0.6, 0.3, 0.9]), np.full(3, 0.9), 0.75 * 0.5 + 0.25 * 0.4
    dull = 0.75 * 0.5 * base + 0.25 * 0.6 * np.array([0, 0.5, 1])
    assert row.constants["metallic"] == pytest.approx((metallic,))
    assert row.constants["base_color"] == pytest.approx(tuple(dull / (1 - metallic)))
    assert row.gloss[:3] == pytest.approx(tuple((0.75 * 0.5 * base + 0.25 * 0.4 * shiny) / metallic))
    table, _ = convert_materials([surface("mixture", build)])
    assert table.gloss is not None
    np.testing.assert_allclose(table.gloss, [[-1, -1, -1, 0], row.gloss])


def test_evaluated_materials_carry_their_animation(atlas):
    material = surface("animated", lambda t: principled(t, Roughness=output(node(t, "ShaderNodeValue"))))
    value = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeValue").outputs[0]
    for frame in (1, 11):
        value.default_value = (frame - 1) / 10
        value.keyframe_insert("default_value", frame=frame)
    scene = bpy.context.scene
    shown = plane(scene, material, 0, 0)
    scene.frame_set(6)
    evaluated = shown.evaluated_get(bpy.context.evaluated_depsgraph_get()).material_slots[0].material
    assert convert_material(evaluated).constants["roughness"] == pytest.approx((0.5,))


# What cannot be evaluated


def test_an_unknown_surface_shows_the_viewport_colour_with_one_warning():
    cloth = surface("velvet", lambda t: output(node(t, "ShaderNodeSubsurfaceScattering")))
    cloth.diffuse_color, cloth.roughness, cloth.metallic = (0.3, 0.2, 0.1, 1), 0.9, 0.25
    table, warnings = convert_materials([cloth])
    np.testing.assert_array_equal(table.base_color[1], f32([0.3, 0.2, 0.1]))
    assert (table.roughness[1], table.metallic[1]) == (np.float32(0.9), np.float32(0.25))
    assert len(warnings) == 1
    assert "velvet" in warnings[0]
    assert "Subsurface Scattering" in warnings[0]


@pytest.mark.skipif(bpy.app.version >= (5, 0, 0), reason="Blender 5 has no materials without nodes")
def test_a_material_without_nodes_is_lamberts_as_in_cycles():
    plain = bpy.data.materials.new("plain")
    plain.diffuse_color, plain.metallic, plain.specular_intensity = (0.3, 0.2, 0.1, 1), 0.5, 0.8
    row = convert_material(plain)
    assert row.constants["base_color"] == pytest.approx((0.3, 0.2, 0.1))
    assert (*row.constants["specular"], *row.constants["metallic"]) == (0.0, 0.0)
    assert not row.warnings


def test_an_unknown_node_leaves_its_input_at_its_own_value():
    def build(tree):
        unknown = node(tree, "ShaderNodeAmbientOcclusion").outputs[0]
        return principled(tree, Roughness=unknown, Metallic=unknown, Base_Color=varying(tree))

    material = surface("noisy", build)
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value = 0.3
    row = convert_material(material)
    assert row.constants["roughness"] == (pytest.approx(0.3),)
    assert graph_of(row).base_color is not None
    assert len(row.warnings) == 1
    assert "noisy" in row.warnings[0]
    assert "Ambient Occlusion" in row.warnings[0]


def test_a_varying_index_of_refraction_keeps_its_own_value():
    row = convert_material(surface("gem", lambda t: principled(t, IOR=scalar(t))))
    assert row.constants["ior"] == (1.5,)
    assert row.graph is None
    assert len(row.warnings) == 1
    assert "gem" in row.warnings[0]
    assert "Principled BSDF" in row.warnings[0]


def test_a_missing_file_is_magenta_and_named(tmp_path):
    def build(tree):
        image = bpy.data.images.new("gone", 4, 4)
        image.source, image.filepath = "FILE", str(tmp_path / "gone.png")
        return principled(tree, Base_Color=output(node(tree, "ShaderNodeTexImage", image=image)))

    row = convert_material(surface("holder", build))
    out = evaluate_samples(graph_of(row), samples(CORNERS))
    np.testing.assert_array_equal(out["base_color"], f32([[1, 0, 1]] * 4))
    assert len(row.warnings) == 1
    assert "holder" in row.warnings[0]
    assert "gone.png" in row.warnings[0]


def test_materials_without_surface_nodes():
    empty = convert_material(new_material("empty"))
    assert empty.constants["base_color"] == (0, 0, 0)
    assert empty.constants["specular"] == (0,)
    smoke = new_material("smoke")
    tree = smoke.node_tree
    volume = node(tree, "ShaderNodeVolumePrincipled").outputs[0]
    tree.links.new(volume, node(tree, "ShaderNodeOutputMaterial").inputs["Volume"])
    assert convert_material(smoke).constants["alpha"] == (0,)


# Pictures


@pytest.mark.parametrize("space", ["sRGB", "Non-Color"])
def test_packed_and_saved_pictures_have_the_texels_that_were_painted(tmp_path, space):
    images.clear()
    painted = picture("painted", space=space)
    direct, problem = images.convert_image(painted)
    assert problem is None
    painted.filepath_raw, painted.file_format = str(tmp_path / "painted.png"), "PNG"
    painted.save()
    loaded = bpy.data.images.load(str(tmp_path / "painted.png"))
    loaded.colorspace_settings.name = space
    saved, _ = images.convert_image(loaded)
    loaded.pack()
    packed, _ = images.convert_image(loaded)
    assert direct.srgb == saved.srgb == packed.srgb == (space == "sRGB")
    np.testing.assert_array_equal(saved.texels, direct.texels)
    np.testing.assert_array_equal(packed.texels, direct.texels)


def test_a_picture_is_read_once_and_again_after_a_change():
    images.clear()
    image = picture("cached")
    first, _ = images.convert_image(image)
    assert images.convert_image(image)[0] is first
    image.pixels[0] = 1 - image.pixels[0]
    assert images.convert_image(image)[0].key != first.key
    image.colorspace_settings.name = "Non-Color"
    assert images.convert_image(image)[0].srgb is False


# Keys, needs and baking


def test_keys_tell_materials_apart_by_what_they_show():
    image = picture("keyed")

    def build(tree):
        return principled(tree, Base_Color=output(node(tree, "ShaderNodeTexImage", image=image)))

    one, other = surface("one", build), surface("other", build)
    assert graph_of(convert_material(one)).digest == graph_of(convert_material(other)).digest
    before = convert_material(one).key
    assert before == convert_material(one).key
    shader = next(n for n in one.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value = 0.123
    after = convert_material(one).key
    assert after != before
    image.pixels[1] = 1 - image.pixels[1]
    assert convert_material(one).key != after


def test_a_picture_baked_at_its_own_resolution_is_the_picture():
    row = convert_material(surface("baked", lambda t: principled(t, Base_Color=output(texture(t)))))
    graph = graph_of(row)
    assert bakeable(graph)
    assert needs(graph).uv == {None}
    assert suggested_resolution(graph) == (5, 3)
    image = next(n.image for n in expression.walk(graph.base_color) if isinstance(n, texture_nodes.ImageTexture))
    expected = color_models.linear_from_srgb(image.texels[..., :3] / np.float32(255))
    # measured 0; the texel centres are rounded to float32
    np.testing.assert_allclose(bake(graph, (5, 3))["base_color"], expected, atol=2e-6)
