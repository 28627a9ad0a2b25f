"""What lets light through: surfaces, media, particles, and who casts shadows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.core.material.evaluation import evaluate_samples
from pointsplat_addon.core.material.expression import SampleInputs
from pointsplat_addon.core.splat.kernel import PEAK
from pointsplat_addon.host.convert.material.materials import convert_material, convert_materials
from tests.support.blender.scenes import new_material, node

FRESNEL = 0.04  # of glass with an index of refraction of 1.5, at normal incidence


pytestmark = pytest.mark.usefixtures("empty_file")


def linked(build, socket="Surface", name="Material", **properties):
    """A material whose output's socket is fed by the node that `build` makes of the tree."""
    material = new_material(name)
    for key, value in properties.items():
        setattr(material, key, value)
    tree = material.node_tree
    made = build(tree)
    tree.links.new(made.outputs[0], node(tree, "ShaderNodeOutputMaterial").inputs[socket])
    return material


def shader(kind, socket="Surface", name="Material", **inputs):
    by_identifier = {key.replace("_", " "): value for key, value in inputs.items()}
    return linked(lambda tree: node(tree, kind, by_identifier), socket, name)


def picture(alpha, name="Picture"):
    """A white image with these alphas (H, W)."""
    height, width = alpha.shape
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
    texels = np.ones((height, width, 4), np.float32)
    texels[..., 3] = alpha
    image.pixels.foreach_set(texels.ravel())
    return image


def card(alpha, **properties):
    """A Principled surface whose alpha is that of a picture."""

    def build(tree):
        texture = node(tree, "ShaderNodeTexImage", image=picture(alpha))
        return node(tree, "ShaderNodeBsdfPrincipled", {"Alpha": texture.outputs["Alpha"]})

    return linked(build, **properties)


# Surfaces


def test_a_constant_alpha_below_one_is_translucent():
    table, warnings = convert_materials(
        [shader("ShaderNodeBsdfPrincipled", Alpha=alpha) for alpha in (1.0, 0.3, 0.0)] + [None]
    )
    assert warnings == []
    assert table.translucent is not None
    np.testing.assert_array_equal(table.translucent, [False, False, True, True, False])
    np.testing.assert_array_equal(table.alpha, np.array([1, 1, 0.3, 0, 1], np.float32))


def test_a_scene_of_opaque_materials_has_no_columns_for_others():
    table, _ = convert_materials([shader("ShaderNodeBsdfDiffuse")])
    assert table.translucent is table.anisotropy is None
    assert table.media == (None, None)


@pytest.mark.parametrize(
    ("name", "alpha", "blended", "expected"),
    [
        ("hole", np.array([[0.0, 1, 1, 0]] * 4), False, False),
        ("hole", np.array([[0.0, 1, 1, 0]] * 4), True, False),
        ("opaque", np.ones((4, 4)), False, False),
        ("gradient", np.linspace(0, 1, 16)[None].repeat(4, 0), False, True),
        ("window", np.array([[0.3, 0.3, 1, 1]] * 4), False, True),
        ("smooth edge", np.repeat([0.0, 0.5, 1], [20, 2, 20])[None].repeat(4, 0), False, False),
        ("smooth edge", np.repeat([0.0, 0.5, 1], [20, 2, 20])[None].repeat(4, 0), True, False),
    ],
)
def test_pictures_that_cut_out_stay_opaque_with_holes(name, alpha, blended, expected):
    material = card(alpha, name=name, surface_render_method="BLENDED" if blended else "DITHERED")
    row = convert_material(material)
    assert row.translucent == expected
    assert row.graph is not None
    assert row.graph.alpha is not None


def test_thresholds_and_inverted_masks_cut_out_and_products_with_a_constant_do_not():
    def of(operation, number):
        def build(tree):
            texture = node(tree, "ShaderNodeTexImage", image=picture(np.array([[0.0, 1]])))
            vertex = node(tree, "ShaderNodeVertexColor", layer_name="Col")
            source = (vertex if operation == "GREATER_THAN" else texture).outputs["Alpha"]
            alpha = node(tree, "ShaderNodeMath", {"Value": number, "Value_001": source}, operation=operation)
            return node(tree, "ShaderNodeBsdfPrincipled", {"Alpha": alpha.outputs[0]})

        return convert_material(linked(build)).translucent

    assert not of("GREATER_THAN", 0.5)
    assert not of("SUBTRACT", 1.0)
    assert of("MULTIPLY", 0.5)


def test_a_mix_with_transparent_is_translucent():
    def build(tree):
        clear = node(tree, "ShaderNodeBsdfTransparent").outputs[0]
        matt = node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0.2, 0.4, 0.6, 1)}).outputs[0]
        return node(tree, "ShaderNodeMixShader", {"Fac": 0.3, "Shader": clear, "Shader_001": matt})

    row = convert_material(linked(build))
    assert row.translucent
    assert row.constants["alpha"] == pytest.approx((0.3,))


def test_a_mix_with_transparent_by_a_picture_cuts_out():
    """As leaves are made of a Diffuse BSDF."""

    def build(tree):
        texture = node(tree, "ShaderNodeTexImage", image=picture(np.array([[0.0, 1]])))
        clear = node(tree, "ShaderNodeBsdfTransparent").outputs[0]
        matt = node(tree, "ShaderNodeBsdfDiffuse", {"Color": texture.outputs["Color"]}).outputs[0]
        factor = texture.outputs["Alpha"]
        return node(tree, "ShaderNodeMixShader", {"Fac": factor, "Shader": clear, "Shader_001": matt})

    row = convert_material(linked(build))
    assert not row.translucent
    assert row.graph is not None
    assert row.graph.alpha is not None


def test_what_only_shadow_rays_see_does_not_show():
    """A usual way to have clear shadows of a surface that is opaque to the eye."""

    def build(tree):
        clear = node(tree, "ShaderNodeBsdfTransparent").outputs[0]
        matt = node(tree, "ShaderNodeBsdfDiffuse").outputs[0]
        path = node(tree, "ShaderNodeLightPath").outputs["Is Shadow Ray"]
        return node(tree, "ShaderNodeMixShader", {"Fac": path, "Shader": matt, "Shader_001": clear})

    row = convert_material(linked(build))
    assert not row.translucent
    assert row.warnings == ()


def transmittance(row):
    return 1 - row.constants["alpha"][0]


def test_clear_glass_lets_through_what_it_does_not_reflect():
    for material in (
        shader("ShaderNodeBsdfGlass"),
        shader("ShaderNodeBsdfPrincipled", Base_Color=(1, 1, 1, 1), Transmission_Weight=1.0, IOR=1.5),
    ):
        row = convert_material(material)
        assert row.translucent
        assert row.warnings == ()
        assert transmittance(row) == pytest.approx(1 - FRESNEL, abs=1e-6)
        # The rest is a mirror: together they reflect what Fresnel's equation says.
        assert row.constants["metallic"] == (1,)
        assert row.constants["base_color"] == (1, 1, 1)


def test_gray_glass_lets_its_tint_through_and_shows_no_colour_of_its_own():
    row = convert_material(shader("ShaderNodeBsdfTransparent", Color=(0.6, 0.6, 0.6, 1)))
    assert transmittance(row) == pytest.approx(0.6, abs=1e-6)
    assert row.constants["base_color"] == pytest.approx((0, 0, 0), abs=1e-6)
    assert row.constants["specular"] == (0,)


@pytest.mark.parametrize("kind", ["ShaderNodeBsdfTransparent", "ShaderNodeBsdfRefraction"])
def test_coloured_glass_lets_its_tint_through_and_shows_no_colour_of_its_own(kind):
    tint = (0.9, 0.5, 0.4)
    row = convert_material(shader(kind, Color=(*tint, 1)))
    assert row.translucent
    assert row.transmission_color == pytest.approx(tint)
    assert row.constants["alpha"] == (0,)
    assert row.constants["base_color"] == (0, 0, 0)


def passes(row):
    """Shares of light that pass a material that is the same everywhere, (3,)."""
    return transmittance(row) * np.array(row.transmission_color)


def test_mixtures_pass_what_their_shaders_do_by_the_factor():
    """T = (1 - f) Ta + f Tb, whatever else the shaders show."""
    tints = (0.9, 0.5, 0.1), (0.2, 0.4, 1.0)

    def mixed(second, factor=0.3):
        def build(tree):
            shaders = [node(tree, "ShaderNodeBsdfTransparent", {"Color": (*tints[0], 1)}), second(tree)]
            inputs = {"Fac": factor, "Shader": shaders[0].outputs[0], "Shader_001": shaders[1].outputs[0]}
            return node(tree, "ShaderNodeMixShader", inputs)

        return convert_material(linked(build))

    first = np.array(tints[0])
    both = mixed(lambda tree: node(tree, "ShaderNodeBsdfTransparent", {"Color": (*tints[1], 1)}))
    np.testing.assert_allclose(passes(both), 0.7 * first + 0.3 * np.array(tints[1]), atol=1e-6)
    clear = mixed(lambda tree: node(tree, "ShaderNodeBsdfTransparent"))
    np.testing.assert_allclose(passes(clear), 0.7 * first + 0.3, atol=1e-6)
    gray = mixed(lambda tree: node(tree, "ShaderNodeBsdfTransparent", {"Color": (0.5, 0.5, 0.5, 1)}))
    np.testing.assert_allclose(passes(gray), 0.7 * first + 0.15, atol=1e-6)
    matt = mixed(lambda tree: node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0.1, 0.2, 0.3, 1)}))
    np.testing.assert_allclose(passes(matt), 0.7 * first, atol=1e-6)
    assert matt.constants["alpha"] == pytest.approx((0.3,))
    assert matt.constants["base_color"] == pytest.approx((0.1, 0.2, 0.3))


def test_coloured_transmission_passes_the_root_of_the_base_colour_and_fades_by_alpha():
    row = convert_material(
        shader("ShaderNodeBsdfPrincipled", Base_Color=(0.81, 0.25, 0.04, 1), Transmission_Weight=1, IOR=1.5, Alpha=0.6)
    )
    np.testing.assert_allclose(passes(row), 0.4 + 0.6 * (1 - FRESNEL) * np.array([0.9, 0.5, 0.2]), atol=1e-6)


def test_a_picture_tints_what_passes():
    def build(tree):
        vertex = node(tree, "ShaderNodeVertexColor", layer_name="Col").outputs["Color"]
        return node(tree, "ShaderNodeBsdfTransparent", {"Color": vertex})

    row = convert_material(linked(build))
    assert row.translucent
    assert row.graph is not None
    tint = np.array([[0.2, 0.4, 0.8, 1], [1, 1, 1, 1]], np.float32)
    out = evaluate_samples(row.graph, SampleInputs(colors={"Col": tint}, count=2))
    np.testing.assert_allclose(out["transmission_color"], tint[:, :3], atol=1e-6)


def test_only_coloured_materials_have_a_column():
    red = shader("ShaderNodeBsdfTransparent", Color=(1, 0.2, 0.2, 1))
    table, _ = convert_materials([red, shader("ShaderNodeBsdfTransparent", Color=(0.5, 0.5, 0.5, 1))])
    assert table.transmission_color is not None
    np.testing.assert_allclose(table.transmission_color, [[1, 1, 1], [1, 0.2, 0.2], [1, 1, 1]], rtol=1e-6)
    table, _ = convert_materials([shader("ShaderNodeBsdfTransparent", Color=(0.5, 0.5, 0.5, 1))])
    assert table.transmission_color is None


def test_transmission_mixes_glass_with_the_painted_surface():
    inputs = {"Base_Color": (0.25, 0.25, 0.25, 1), "IOR": 1.5, "Roughness": 0.2, "Emission_Color": (1, 1, 1, 1)}
    row = convert_material(
        shader("ShaderNodeBsdfPrincipled", Transmission_Weight=0.5, Emission_Strength=3.0, Alpha=0.8, **inputs)
    )
    # The root of the base colour passes each of a solid's two faces.
    passing = (1 - FRESNEL * 0.5) * 0.5
    assert transmittance(row) == pytest.approx(1 - 0.8 * (1 - 0.5 * passing), abs=1e-6)
    assert row.constants["roughness"] == pytest.approx((0.2,))
    # Emission does not become less where light passes, only by Alpha.
    emitted = row.constants["alpha"][0] * np.array(row.constants["emission"])
    np.testing.assert_allclose(emitted, 0.8 * 3, rtol=1e-5)
    metal = convert_material(shader("ShaderNodeBsdfPrincipled", Transmission_Weight=1.0, Metallic=1.0, **inputs))
    assert not metal.translucent


def test_a_varying_transmission_varies_alpha():
    def build(tree):
        weight = node(tree, "ShaderNodeVertexColor", layer_name="Col").outputs["Alpha"]
        return node(
            tree, "ShaderNodeBsdfPrincipled", {"Base Color": (1, 1, 1, 1), "Transmission Weight": weight, "IOR": 1.5}
        )

    row = convert_material(linked(build))
    assert row.translucent
    assert row.warnings == ()
    weight = np.array([0, 0.5, 1], np.float32)
    colors = {"Col": np.stack([weight] * 4, axis=1)}
    assert row.graph is not None
    out = evaluate_samples(row.graph, SampleInputs(colors=colors, count=3))
    np.testing.assert_allclose(out["alpha"], 1 - weight * (1 - FRESNEL), atol=1e-6)


def test_a_translucent_bsdf_hides_what_is_behind_it():
    row = convert_material(shader("ShaderNodeBsdfTranslucent", name="Paper"))
    assert not row.translucent
    assert row.backlit == (1, 1, 1)
    assert not row.warnings


# Media


def medium_of_row(row):
    """What fills the material, which something does."""
    assert row.medium is not None
    return row.medium


def coefficients(medium):
    """Scattering and absorption as Cycles computes them from a Principled Volume's inputs."""
    absorbed = np.maximum(1 - medium.color, 0) * np.maximum(1 - np.sqrt(medium.absorption), 0)
    return medium.density * medium.color, medium.density * absorbed


def volume(kind, **inputs):
    row = convert_material(shader(kind, "Volume", "Fog", **inputs))
    assert row.warnings == ()
    return row


def test_a_principled_volume_is_taken_as_it_is():
    color, absorbed = (0.2, 0.5, 0.8, 1), (0.1, 0, 0.3, 1)
    row = volume(
        "ShaderNodeVolumePrincipled", Color=color, Density=3.0, Absorption_Color=absorbed, Anisotropy=0.4,
        Emission_Strength=2.0, Emission_Color=(1, 0.5, 0.25, 1), Density_Attribute="smoke", Blackbody_Intensity=0.5,
        Color_Attribute="tint", Temperature=900.0,
    )  # fmt: skip
    medium = medium_of_row(row)
    assert (medium.density, medium.density_grid, medium.color_grid) == (3, "smoke", "tint")
    assert (medium.temperature, medium.temperature_grid, medium.blackbody) == (900, "temperature", 0.5)
    assert medium.anisotropy == pytest.approx(0.4)
    np.testing.assert_allclose(medium.color, color[:3], rtol=1e-6)
    np.testing.assert_allclose(medium.absorption, absorbed[:3], rtol=1e-6)
    np.testing.assert_allclose(medium.emission, (2, 1, 0.5))
    assert row.constants["alpha"] == (0,)  # it has no surface


def test_absorption_absorbs_and_scatter_scatters():
    color = np.array([0.75, 0.25, 0.5])
    scattering, absorption = coefficients(volume("ShaderNodeVolumeAbsorption", Color=(*color, 1), Density=2.0).medium)
    np.testing.assert_allclose(scattering, 0, atol=1e-12)
    np.testing.assert_allclose(absorption, 2 * (1 - color), rtol=1e-6)
    row = volume("ShaderNodeVolumeScatter", Color=(*color, 1), Density=2.0, Anisotropy=-0.3)
    scattering, absorption = coefficients(medium_of_row(row))
    np.testing.assert_allclose(scattering, 2 * color, rtol=1e-6)
    np.testing.assert_allclose(absorption, 0, atol=1e-12)
    assert medium_of_row(row).anisotropy == pytest.approx(-0.3)
    assert medium_of_row(row).density_grid == ""


def test_coefficients_are_taken_as_they_are():
    row = volume(
        "ShaderNodeVolumeCoefficients",
        Absorption_Coefficients=(1, 2, 3), Scatter_Coefficients=(3, 0, 4), Emission_Coefficients=(0, 5, 0),
    )  # fmt: skip
    scattering, absorption = coefficients(medium_of_row(row))
    np.testing.assert_allclose(scattering, (3, 0, 4), rtol=1e-12)
    np.testing.assert_allclose(absorption, (1, 2, 3), rtol=1e-12)
    np.testing.assert_array_equal(medium_of_row(row).emission, (0, 5, 0))


def combined(kind, **inputs):
    """Absorption, scattering and light, added up or mixed."""

    def build(tree):
        absorb = node(tree, "ShaderNodeVolumeAbsorption", {"Color": (0, 0.5, 1, 1), "Density": 4.0})
        scatter = node(tree, "ShaderNodeVolumeScatter", {"Color": (1, 0.5, 0, 1), "Density": 2.0, "Anisotropy": 0.5})
        glow = node(tree, "ShaderNodeEmission", {"Color": (1, 0.5, 0.25, 1), "Strength": 4.0})
        both = node(tree, kind, {**inputs, "Shader": absorb.outputs[0], "Shader_001": scatter.outputs[0]})
        return node(tree, "ShaderNodeAddShader", {"Shader": glow.outputs[0], "Shader_001": both.outputs[0]})

    return convert_material(linked(build, "Volume"))


def test_volumes_add_up_by_their_coefficients():
    row = combined("ShaderNodeAddShader")
    scattering, absorption = coefficients(medium_of_row(row))
    np.testing.assert_allclose(scattering, (2, 1, 0), atol=1e-12)
    np.testing.assert_allclose(absorption, (4, 2, 0), atol=1e-12)
    np.testing.assert_allclose(medium_of_row(row).emission, (4, 2, 1))
    assert medium_of_row(row).anisotropy == 0.5  # only one of them scatters
    assert row.warnings == ()


def test_volumes_mix_by_a_factor():
    scattering, absorption = coefficients(combined("ShaderNodeMixShader", Fac=0.25).medium)
    np.testing.assert_allclose(scattering, np.array([2, 1, 0]) * 0.25, atol=1e-12)
    np.testing.assert_allclose(absorption, np.array([4, 2, 0]) * 0.75, atol=1e-12)


def grid_material(multiplied=None, kind="ShaderNodeVolumeScatter", **more):
    def build(tree):
        density = node(tree, "ShaderNodeAttribute", attribute_name="smoke").outputs["Fac"]
        if multiplied is not None:
            operation, number = multiplied
            density = node(
                tree, "ShaderNodeMath", {"Value": density, "Value_001": number}, operation=operation
            ).outputs[0]
        return node(tree, kind, {"Density": density, **more})

    return convert_material(linked(build, "Volume", name="Fog"))


def test_a_linked_attribute_is_the_grid_of_the_density_and_constants_multiply_it():
    assert (medium_of_row(grid_material()).density_grid, medium_of_row(grid_material()).density) == (
        "smoke",
        pytest.approx(0.8),
    )
    for operation, number, density in (("MULTIPLY", 5.0, 5.0), ("DIVIDE", 4.0, 0.25)):
        row = grid_material((operation, number), Color=(1, 1, 1, 1))
        assert row.warnings == ()
        assert medium_of_row(row).density_grid == "smoke"
        assert medium_of_row(row).density == pytest.approx(density)


def test_volume_info_reads_blenders_own_grids():
    def build(tree):
        info = node(tree, "ShaderNodeVolumeInfo")
        inputs = {"Density": info.outputs["Density"], "Color": info.outputs["Color"]}
        inputs |= {"Temperature": info.outputs["Temperature"], "Density Attribute": ""}
        return node(tree, "ShaderNodeVolumePrincipled", inputs)

    row = convert_material(linked(build, "Volume"))
    medium = medium_of_row(row)
    assert (medium.density_grid, medium.color_grid, medium.temperature_grid) == ("density", "color", "temperature")
    assert row.warnings == ()


def test_what_is_no_grid_times_a_constant_keeps_its_own_value_with_one_warning():
    row = grid_material(("POWER", 2.0))
    assert medium_of_row(row).density == pytest.approx(0.8)
    assert medium_of_row(row).density_grid == ""
    assert len(row.warnings) == 1
    assert "Fog" in row.warnings[0]
    assert "Volume Scatter" in row.warnings[0]
    twice = grid_material(kind="ShaderNodeVolumePrincipled")
    assert len(twice.warnings) == 1
    assert medium_of_row(twice).density_grid == "smoke"


def test_an_unknown_volume_shader_is_left_out_with_one_warning():
    row = convert_material(shader("ShaderNodeBsdfSheen", "Volume", "Fog"))
    assert row.medium is None
    assert len(row.warnings) == 1
    assert "Fog" in row.warnings[0]


def test_the_table_has_media_and_their_anisotropy():
    fog = shader("ShaderNodeVolumeScatter", "Volume", Anisotropy=0.5)
    table, _ = convert_materials([None, fog])
    assert table.anisotropy is not None
    np.testing.assert_array_equal(table.anisotropy, np.array([0, 0, 0.5], np.float32))
    assert [m is None for m in table.media] == [True, True, False]
    before = convert_material(fog).key
    next(n for n in fog.node_tree.nodes if n.bl_idname == "ShaderNodeVolumeScatter").inputs["Density"].default_value = 7
    assert convert_material(fog).key != before


# Points


def sync() -> Any:
    from pointsplat_addon.host.sync import Synchronizer

    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return Synchronizer().scene(depsgraph)


def mesh_object(name, vertices, faces=()):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(ob)
    return ob


def pointcloud(positions, material=None, **attributes):
    """A PointCloud object. Attributes: name to (type, key, array)."""
    ob = mesh_object("Points", positions)
    if material is not None:
        ob.data.materials.append(material)
    for attribute, (kind, key, values) in attributes.items():
        made = ob.data.attributes.new(attribute, kind, "POINT")
        made.data.foreach_set(key, np.asarray(values, np.int32 if kind == "INT" else np.float32).ravel())
    with bpy.context.temp_override(active_object=ob, object=ob, selected_objects=[ob], selected_editable_objects=[ob]):
        bpy.context.view_layer.objects.active = ob
        ob.select_set(True)
        bpy.ops.object.convert(target="POINTCLOUD")
    return bpy.context.view_layer.objects.active


def cloud_of(scene, row=0):
    return scene.geometries[row].cloud


def at_centre(cloud):
    """Optical depth through the centres of balls: their mass times the kernel's peak."""
    radius = cloud.radii[:, 0].astype(float)
    mass = 4 / 3 * np.pi * radius**3 * cloud.extinction.T
    return (PEAK * mass / (2 * np.pi * (radius / 2) ** 2)).T


TWO = [(0, 0, 0), (1, 0, 0)]


def test_an_attribute_of_integers_chooses_kernels():
    at, alpha = [(i, 0, 0) for i in range(6)], ("FLOAT", "value", [0.5, 0.5, 0, 0.5, 0.5, 0.5])
    pointcloud(at, opacity=alpha, kernel=("INT", "value", [0, 3, 2, 1, -1, 300]))
    np.testing.assert_array_equal(cloud_of(sync()).kernel, [0, 3, 1, 0, 0])  # the third does not show
    assert cloud_of(sync()).kernel.dtype == np.uint8
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointcloud(at, opacity=alpha, kernel=("FLOAT", "value", [1] * 6))
    assert cloud_of(sync()).kernel is None


@pytest.mark.parametrize("name", ["opacity", "alpha"])
def test_points_with_an_opacity_are_balls_that_have_it_at_their_centres(name):
    alpha, radius = np.array([0.3, 1.0, 0.0, 0.9]), [0.1, 0.2, 0.3, 5.0]
    made = {name: ("FLOAT", "value", alpha), "radius": ("FLOAT", "value", radius)}
    pointcloud([(i, 0, 0) for i in range(4)], **made)
    cloud = cloud_of(sync())
    assert cloud.opacity is cloud.normal is None
    shown = np.array([0.3, 1.0, 0.9])
    np.testing.assert_allclose(-np.expm1(-at_centre(cloud)), shown, rtol=1e-6)  # measured 6e-8, here as below
    assert at_centre(cloud)[1] == pytest.approx(100, rel=1e-6)


def test_opaque_points_stay_as_they_are_and_odd_opacities_are_put_right():
    pointcloud(TWO, opacity=("FLOAT", "value", [1, 1]))
    assert cloud_of(sync()).extinction is cloud_of(sync()).opacity is None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointcloud([*TWO, (2, 0, 0)], opacity=("FLOAT", "value", [7, np.nan, 0.5]))
    np.testing.assert_allclose(-np.expm1(-at_centre(cloud_of(sync()))), [1, 1, 0.5], rtol=1e-6)


def test_captured_opacities_are_logits_and_are_not_read():
    pointcloud(TWO, opacity=("FLOAT", "value", [-3, 4]), f_dc_0=("FLOAT", "value", [1, 1]))
    cloud = cloud_of(sync())
    assert len(cloud) == 2
    assert cloud.extinction is None


def test_disks_keep_their_opacity():
    normal = ("FLOAT_VECTOR", "vector", [(0, 0, 1)] * 2)
    pointcloud(TWO, opacity=("FLOAT", "value", [0.25, 1]), normal=normal).pointsplat.shape = "DISKS"
    cloud = cloud_of(sync())
    assert cloud.extinction is None
    np.testing.assert_array_equal(cloud.opacity, np.array([0.25, 1], np.float32))


def test_a_colours_alpha_counts_where_there_is_no_material():
    pointcloud(TWO, Color=("FLOAT_COLOR", "color", [(1, 0, 0, 0.5), (0, 1, 0, 1)]))
    np.testing.assert_allclose(-np.expm1(-at_centre(cloud_of(sync()))), [0.5, 1], rtol=1e-6)


def test_a_translucent_material_makes_balls_that_glow_with_its_radiance():
    pointcloud(
        TWO,
        shader("ShaderNodeBsdfPrincipled", Alpha=0.4, Emission_Color=(1, 0.5, 0, 1), Emission_Strength=2.0),
        radius=("FLOAT", "value", [0.1, 0.2]),
    )
    cloud = cloud_of(sync())
    np.testing.assert_allclose(-np.expm1(-at_centre(cloud)), 0.4, rtol=1e-6)
    # In the limit of great depth a medium shines with emission / extinction.
    np.testing.assert_allclose(cloud.emission / cloud.extinction[:, None], [(2, 1, 0)] * 2, rtol=1e-6)


def test_an_alpha_that_an_attribute_gives_is_each_points_own():
    def build(tree):
        alpha = node(tree, "ShaderNodeAttribute", attribute_name="fade").outputs["Fac"]
        return node(tree, "ShaderNodeBsdfPrincipled", {"Alpha": alpha})

    pointcloud(TWO, linked(build), fade=("FLOAT", "value", [0.2, 0.7]))
    np.testing.assert_allclose(-np.expm1(-at_centre(cloud_of(sync()))), [0.2, 0.7], rtol=1e-6)


def test_points_of_coloured_glass_hide_each_channel_by_what_it_does_not_pass():
    """Balls, and disks, which have a normal."""
    tint = np.array([0.9, 0.4, 0.2])
    glass = shader("ShaderNodeBsdfTransparent", Color=(*tint, 1))
    for more in ({}, {"normal": ("FLOAT_VECTOR", "vector", np.ravel([(0, 0, 1)] * 2))}):
        pointcloud(TWO, glass, **more)
        cloud = cloud_of(sync())
        centre = -np.expm1(-at_centre(cloud)) if cloud.opacity is None else cloud.opacity
        np.testing.assert_allclose(centre, np.broadcast_to(1 - tint, (2, 3)), rtol=1e-5)
        np.testing.assert_array_equal(cloud.shaded, 0)
        bpy.data.objects.remove(bpy.context.scene.objects[0])


def test_a_medium_fills_the_points_by_their_own_density():
    fog = shader(
        "ShaderNodeVolumePrincipled", "Volume", Density=2.0, Color=(0.5, 0.5, 0.5, 1), Absorption_Color=(0, 0, 0, 1)
    )
    pointcloud(TWO, fog, density=("FLOAT", "value", [1, 3]))
    cloud = cloud_of(sync())
    np.testing.assert_allclose(cloud.extinction, [2, 6], rtol=1e-6)  # half is scattered, half absorbed
    np.testing.assert_allclose(cloud.color, 0.5, rtol=1e-6)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointcloud(TWO, shader("ShaderNodeVolumeAbsorption", "Volume", Color=(0.5, 1, 0, 1)))
    cloud = cloud_of(sync())
    np.testing.assert_allclose(cloud.extinction, [(0.5, 0, 1)] * 2, rtol=1e-6)
    assert not cloud.color.any()


def test_a_mesh_filled_with_a_volume_is_named():
    ob = mesh_object("Tank", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    ob.data.materials.append(shader("ShaderNodeVolumeScatter", "Volume"))
    (warning,) = sync().warnings
    assert "Tank" in warning


def test_an_objects_extinction_goes_before_its_materials():
    ob = pointcloud(TWO, shader("ShaderNodeBsdfPrincipled", Alpha=0.4))
    ob.pointsplat.extinction = 7
    scene = sync()
    assert scene.geometries[0].extinction == 7
    np.testing.assert_array_equal(cloud_of(scene).extinction, [7, 7])


def test_a_change_of_alpha_reaches_the_points():
    from pointsplat_addon.host.sync import Synchronizer

    material = shader("ShaderNodeBsdfPrincipled", Alpha=0.4)
    pointcloud(TWO, material)
    synchronizer = Synchronizer()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    first = synchronizer.scene(depsgraph).geometries[0]
    principled = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    principled.inputs["Alpha"].default_value = 0.8
    depsgraph.update()
    second = synchronizer.scene(depsgraph).geometries[0]
    assert first.key != second.key
    np.testing.assert_allclose(-np.expm1(-at_centre(second.cloud)), 0.8, rtol=1e-6)


# Particles


def emitter(count=50, **settings):
    ob = mesh_object("Emitter", [(0, 0, 0), (2, 0, 0), (0, 2, 0)], [(0, 1, 2)])
    ob.location, ob.scale = (1, 2, 3), (2, 2, 2)
    ob.modifiers.new("Particles", "PARTICLE_SYSTEM")
    made = ob.particle_systems[0].settings
    made.count, made.frame_start, made.frame_end, made.lifetime = count, 1, 10, 4
    for name, value in settings.items():
        setattr(made, name, value)
    for frame in range(1, 7):
        bpy.context.scene.frame_set(frame)
    return ob


def expected_particles(ob):
    found = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).particle_systems[0].particles
    return np.array([tuple(p.location) for p in found if p.alive_state == "ALIVE"])


def particles_of(scene):
    return [i for i, g in enumerate(scene.instances.geometry) if scene.geometries[g].cloud is not None]


def test_living_particles_are_points_where_blender_has_them():
    ob = emitter(particle_size=0.125)
    scene = sync()
    (row,) = particles_of(scene)
    assert len(scene.instances) == 2  # and the emitter
    cloud = scene.geometries[scene.instances.geometry[row]].cloud
    expected = expected_particles(ob)
    assert 0 < len(expected) < 50
    matrix = scene.instances.world_from_object[row]
    np.testing.assert_allclose(cloud.position @ matrix[:3, :3].T + matrix[:3, 3], expected, atol=1e-6)
    np.testing.assert_array_equal(cloud.radii, np.full((len(expected), 1), 0.125, np.float32))
    assert scene.instances.names[row] == "Emitter"


def test_particles_are_there_without_their_emitter_and_dead_ones_where_they_are_asked_for():
    ob = emitter(use_dead=True)
    ob.show_instancer_for_viewport = False
    scene = sync()
    (row,) = range(len(scene.instances))
    assert len(scene.geometries[scene.instances.geometry[row]].cloud) > len(expected_particles(ob))


@pytest.mark.parametrize("kind", ["NONE", "OBJECT"])
def test_particles_that_blender_hides_or_puts_objects_in_are_no_points(kind):
    emitter(render_type=kind)
    assert particles_of(sync()) == []


def test_particles_have_the_material_of_their_slot():
    ob = emitter(material=2)
    ob.data.materials.append(None)
    ob.data.materials.append(shader("ShaderNodeBsdfPrincipled", Alpha=0.5, name="Spray"))
    scene = sync()
    (row,) = particles_of(scene)
    cloud = scene.geometries[scene.instances.geometry[row]].cloud
    assert {scene.materials.names[m] for m in cloud.material} == {"Spray"}
    np.testing.assert_allclose(-np.expm1(-at_centre(cloud)), 0.5, rtol=1e-6)


def test_particles_move_with_the_frames_and_stay_the_same_within_one():
    from pointsplat_addon.host.sync import Synchronizer

    emitter()
    synchronizer = Synchronizer()
    keys = []
    for frame in (6, 6, 7):
        bpy.context.scene.frame_set(frame)
        scene = synchronizer.scene(bpy.context.evaluated_depsgraph_get())
        keys.append([g.key for g in scene.geometries if g.cloud is not None])
    assert keys[0] == keys[1]
    assert keys[1] != keys[2]


# Shadows


def test_objects_that_cast_no_shadows_are_named_and_none_costs_nothing():
    casting = mesh_object("Casts", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    other = mesh_object("Other", [(0, 0, 0), (1, 0, 0), (0, 2, 0)], [(0, 1, 2)])
    assert sync().instances.casts is None
    other.visible_shadow = False
    instances = sync().instances
    assert dict(zip(instances.names, instances.casts, strict=True)) == {casting.name: True, other.name: False}


def test_lights_say_whether_they_cast_shadows():
    for name, cast in (("One", True), ("Two", False)):
        data = bpy.data.lights.new(name, "POINT")
        data.use_shadow = cast
        bpy.context.collection.objects.link(bpy.data.objects.new(name, data))
    assert {light.name: light.shadow for light in sync().lights} == {"One": True, "Two": False}
