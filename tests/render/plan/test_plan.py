"""What a scene needs is asked of the device; what it does not need never reaches it."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.light.bsdf import WIDTH
from pointsplat_addon.core.light.light_shapes import KINDS
from pointsplat_addon.core.light.light_table import FIRST_LIGHT
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import LIMITS, NullDevice
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, detailed_cases, lit_cases, meshes, solid_cases
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.store import STORE

ONLY_COMBINED = frozenset({"combined"})
POINT_PROGRAMS = {"project", "identify", "resolve", "pull", "push", "fill"}


def record(case, passes=ONLY_COMBINED, samples=1, device=None):
    """The device that recorded a picture, and its report."""
    device = device or NullDevice()
    result = Renderer(device, STORE).render(case.scene, case.request(passes, samples))
    return device, result


def defines(device):
    return {name for interface in device.interfaces for name, _ in interface.defines}


def samplers(device):
    return {name for interface in device.interfaces for _, name in interface.samplers}


def skipped(result):
    return {entry["name"]: entry["because"] for entry in result.report["skipped"]}


def test_an_empty_scene_touches_the_device_not_at_all():
    device, result = record(solid_cases.empty(), ALL_PASSES, 16)
    assert device.textures == device.targets == device.calls == device.interfaces == []
    assert skipped(result)["project"] == skipped(result)["resolve"] == "nothing is drawn as points"
    assert skipped(result)["polygons"] == "nothing is drawn as polygons"


def test_a_cube_allocates_no_point_buffers_and_compiles_no_point_program():
    device, result = record(solid_cases.cube())
    assert not POINT_PROGRAMS & {interface.name for interface in device.interfaces}
    assert all(not interface.compute for interface in device.interfaces)
    assert "R32UI" not in {texture.format for texture in device.textures}
    assert not {"ps_blocks", "ps_ids", "ps_extent", "ps_coarse_place"} & samplers(device)
    assert result.report["points"] == {"total": 0, "cut": 0, "drawn": 0}
    assert result.report["triangles"] == 12
    assert skipped(result)["project"] == "nothing is drawn as points"
    assert "polygons" not in skipped(result)


def test_pictures_are_baked_once_for_all_meshes_and_poses_that_show_them():
    device, table = NullDevice(), solid_cases.textured().scene.materials
    renderer = Renderer(device, STORE)
    for pose in range(2):
        planes = (
            (build.mesh(meshes.plane_mesh(f"shared pictures {x} {pose}"), "POLYGONS"), build.moved((x, 0, 0)))
            for x in (-1.1, 1.1)
        )
        case = Case(build.scene(*planes, table=table), cameras.camera((0.5, -5, 1)))
        renderer.render(case.scene, case.request(ONLY_COMBINED, 1))
    drawn = [call.textures for call in device.calls if call.interface.name == "polygons"]
    assert len(drawn) == 4
    assert len({textures["ps_baked_color"] for textures in drawn}) == 1
    assert len({textures["ps_corner"] for textures in drawn}) == 4
    renderer.release()
    assert not device.alive


def test_a_cloud_compiles_no_polygon_program_and_has_no_depth_buffer():
    device, result = record(solid_cases.plain_sphere())
    assert "polygons" not in device.names
    assert not any(target.depth for target in device.targets)
    assert "PS_DEPTH" not in defines(device)
    assert skipped(result)["polygons"] == "nothing is drawn as polygons"
    assert "project" not in skipped(result)


def test_points_among_polygons_share_their_depth_buffer():
    device, _ = record(solid_cases.mixed())
    assert any(target.depth for target in device.targets)
    assert "PS_DEPTH" in defines(device)


@pytest.mark.parametrize(
    ("name", "on"),
    [
        ("plain_sphere", set()),
        ("cube", set()),
        ("sphere", {"PS_COLOR"}),
        ("emission", {"PS_EMISSION"}),
        ("textured", {"PS_COLOR"}),
    ],
)
def test_attributes_cost_textures_only_where_they_vary(name, on):
    device, _ = record(CASES[name]())
    assert {"PS_COLOR", "PS_EMISSION"} & defines(device) == on
    for define, sampler in (("PS_COLOR", "ps_color"), ("PS_EMISSION", "ps_emission")):
        assert (sampler in samplers(device)) == (define in on)


@pytest.mark.parametrize("name", ["plain_sphere", "cube", "mixed"])
def test_owners_are_kept_only_for_passes_that_ask_whose_a_pixel_is(name):
    for passes, asked in (
        ({"depth", "position", "normal", "mist"}, False),
        ({"object_index"}, True),
        ({"crypto_object"}, True),
        ({"vector"}, True),
    ):
        device, _ = record(CASES[name](), frozenset(passes))
        assert ("ps_owner" in samplers(device)) == ("PS_OWNER" in defines(device)) == asked


@pytest.mark.parametrize("name", ["plain_sphere", "cube"])
@pytest.mark.parametrize("asked", sorted(ALL_PASSES - {"combined"}))
def test_programs_read_only_samplers_that_they_declare_for_any_single_pass(name, asked):
    """A shader that reads PS_OWNER's texture must be told to declare it."""
    device, _ = record(CASES[name](), frozenset({asked}))
    for interface in device.interfaces:
        if interface.name == "data":
            names = {name for name, _ in interface.defines}
            assert ("PS_OWNER" in names) == ("ps_owner" in {sampler for _, sampler in interface.samplers})
            assert "PS_OUT_VECTOR" not in names or "PS_OWNER" in names


def test_passes_that_nobody_asks_for_have_no_outputs():
    plain, _ = record(solid_cases.mixed())
    full, _ = record(solid_cases.mixed(), ALL_PASSES)
    outputs = [{name for i in device.interfaces for _, name in i.outputs} for device in (plain, full)]
    extra = {"out_normal_pass", "out_mist", "out_position", "out_index", "out_vector"}
    assert not extra & outputs[0]
    assert extra <= outputs[1]
    assert "data" not in plain.names


def test_the_data_passes_run_once_unless_identities_are_averaged():
    device, _ = record(solid_cases.mixed(), frozenset({"depth", "vector", "object_index"}), samples=5)
    assert device.names.count("data") == 1
    device, _ = record(solid_cases.mixed(), frozenset({"crypto_object"}), samples=5)
    assert device.names.count("data") == 5


def test_lights_and_world_cost_only_what_shines():
    def on(case):
        return {name for name in defines(record(case)[0]) if name.startswith("PS_HAS_")}

    shining = on(lit_cases.lights())
    assert {"PS_HAS_WORLD"} | {f"PS_HAS_{kind}S" for kind in KINDS} <= shining
    assert not shining & on(solid_cases.unlit())
    assert shining & on(solid_cases.cube()) == {"PS_HAS_SUNS", "PS_HAS_WORLD"}
    assert "PS_HAS_ENVIRONMENT" in on(lit_cases.environment())
    assert not shining & on(lit_cases.environment())
    assert "ps_lights" not in samplers(record(solid_cases.unlit())[0])


def test_a_transparent_film_draws_no_world():
    case = lit_cases.environment()
    clear = replace(case, scene=replace(case.scene, transparent=True))
    assert skipped(record(clear)[1])["background"] == "the film is transparent"
    empty = Case(build.scene(world=World(np.zeros(3), np.ones((4, 8, 3), np.float32)), transparent=True), case.camera)
    assert "PS_HAS_ENVIRONMENT" not in defines(record(empty)[0])


def test_one_instance_needs_no_table_of_instances():
    device, _ = record(solid_cases.plain_sphere())
    assert "PS_ONE_INSTANCE" in defines(device)
    assert "ps_instances" not in samplers(device)
    case = solid_cases.plain_sphere()
    two = build.scene(*((case.scene.geometries[0], build.moved((x, 0, 0))) for x in (-1, 1)))
    device, _ = record(replace(case, scene=two))
    assert "PS_ONE_INSTANCE" not in defines(device)
    assert "ps_instances" in samplers(device)


def test_holdouts_and_culling_are_variants():
    assert "PS_HOLDOUT" in defines(record(solid_cases.holdout())[0])
    assert "PS_CULL" in defines(record(solid_cases.culled())[0])
    plain = defines(record(solid_cases.mixed())[0])
    assert not {"PS_HOLDOUT", "PS_CULL"} & plain


def test_an_emission_that_only_points_have_is_known_to_polygons_too():
    """They share one G-buffer: what one kind has, the other must fill from its table."""
    graph = MaterialGraph(emission=color_nodes.Color(input_nodes.UV()))
    glowing = build.mesh(meshes.plane_mesh("glowing plane"), "POLYGONS")
    case = Case(
        build.scene(
            (glowing, build.moved()),
            (build.points("unlit sphere", clouds.sphere_cloud()), build.moved()),
            table=build.materials(graphs=(graph,)),
        ),
        cameras.camera(),
    )
    device, _ = record(case)
    named = {i.name: {name for name, _ in i.defines} for i in device.interfaces}
    assert all("PS_EMISSION" in named[name] for name in ("resolve", "polygons", "shade"))


def test_many_materials_have_identities_that_halves_cannot_hold():
    few, many = (
        record(replace(solid_cases.cube(), scene=replace(solid_cases.cube().scene, materials=build.materials(n))))[0]
        for n in (100, 3000)
    )

    def formats(device):
        draw = next(call for call in device.calls if call.interface.name == "shade")
        return draw.textures["ps_shape"].format

    assert (formats(few), formats(many)) == ("RGBA16F", "RGBA32F")


def test_without_image_atomics_points_are_rasterised():
    device, _ = record(solid_cases.plain_sphere(), device=NullDevice(replace(LIMITS, image_atomics=False)))
    assert all(not interface.compute for interface in device.interfaces)
    assert any(call.interface.name == "project" and call.primitive == "POINTS" for call in device.calls)
    assert "identify" not in device.names


@pytest.mark.parametrize("name", CASES)
def test_every_scene_is_drawn_and_everything_is_freed(name):
    device = NullDevice()
    renderer = Renderer(device, STORE)
    case = CASES[name]()
    result = renderer.render(case.scene, case.request(samples=2))
    _, _, width, height = case.camera.window
    assert result.pixels["combined"].shape == (height, width, 4)
    renderer.release()
    assert device.bytes_allocated() == 0


def test_every_pass_that_is_asked_for_is_there_in_every_scene():
    expected = (ALL_PASSES - {"crypto_object", "crypto_material"}) | {
        f"crypto_{kind}{i:02d}" for kind in ("object", "material") for i in range(3)
    }
    lone_world = Case(build.scene(world=World(np.zeros(3), np.ones((4, 8, 3), np.float32))), cameras.camera())
    for case in (*(make() for make in CASES.values()), lone_world):
        _, result = record(case, ALL_PASSES)
        assert set(result.pixels) == expected


@pytest.mark.parametrize("name", ["plain_sphere", "sphere", "cube", "mixed", "textured"])
def test_the_second_frame_uploads_only_small_tables(name):
    """Materials, lights, instances and blocks of the cut; no geometry, no picture."""
    case = CASES[name]()
    device = NullDevice()
    renderer = Renderer(device, STORE)
    renderer.render(case.scene, case.request(ALL_PASSES))
    first, pages = device.uploaded_bytes, len(device.textures)
    turned = replace(
        case.camera,
        view_from_world=cameras.look_at((0, 0, 0), (0.05, 0.03, -1), (0, 1, 0)) @ case.camera.view_from_world,
    )
    renderer.render(case.scene, replace(case, camera=turned).request(ALL_PASSES))
    again = [texture for texture in device.textures[pages:] if texture.uploaded]
    assert device.uploaded_bytes - first < first
    # One page each for the blocks of the cut, instances and motion; lights below the reflectances; materials.
    largest = {(4096, 1), (WIDTH, FIRST_LIGHT + len(case.scene.lights)), (4, len(case.scene.materials))}
    assert {texture.size for texture in again} <= largest
    assert len(again) <= 5


def test_a_large_static_cloud_is_uploaded_once():
    cloud = clouds.sphere_cloud(200_000)
    case = Case(build.scene((build.points("large", cloud), build.moved())), cameras.camera())
    device = NullDevice()
    renderer = Renderer(device, STORE)
    renderer.render(case.scene, case.request(ONLY_COMBINED))
    first = device.uploaded_bytes
    renderer.render(case.scene, case.request(ONLY_COMBINED))
    assert device.uploaded_bytes - first < first / 20  # measured 1/44: one block of 64 splats is 16 bytes, a splat 32


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA", "PAINTER"])
def test_a_scene_without_strands_compiles_nothing_for_them(technique):
    for name in ("sphere", "mixed", "smoke"):
        case = CASES[name]()
        device, result = record(replace(case, settings=replace(case.settings, technique=technique)), ALL_PASSES)
        assert "lines" not in device.names
        assert not {"PS_STRANDS", "PS_THIN", "PS_TUBE", "PS_RIBBON"} & defines(device)
        assert skipped(result)["lines"] == "nothing is drawn as lines"
        assert result.report["lines"] == {"strands": 0, "segments": 0, "drawn": 0}


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA", "PAINTER"])
def test_strands_alone_need_neither_points_nor_a_pyramid(technique):
    case = detailed_cases.strands()
    only = [
        (g, m) for g, m in zip(case.scene.geometries, case.scene.instances.world_from_object, strict=True) if g.strands
    ]
    alone = replace(case, scene=build.scene(*only), settings=replace(case.settings, technique=technique))
    device, result = record(alone, samples=8)
    assert not POINT_PROGRAMS & set(device.names)
    assert "polygons" not in device.names
    assert not {"ps_coarse_place", "ps_ids"} & samplers(device)
    assert "lines" not in skipped(result)
    assert skipped(result)["project"] == "nothing is drawn as points"
    assert skipped(result)["adapt"] == "strands thinner than a pixel are drawn in a share of all samples"
    # A spring, a ribbon and hair, of which no sample draws every one.
    drawn = {(call.interface.vertex, call.primitive) for call in device.calls if call.interface.name == "lines"}
    assert drawn == {("strands/strands.vert", "TRIANGLES"), ("strands/strands.vert", "LINES")}
    report = result.report["lines"]
    assert report["strands"] == 403
    assert 0 < report["drawn"] < 8 * report["segments"]


def test_wide_strands_leave_out_what_thin_ones_need():
    turn = np.linspace(0, 6, 20)
    tube = build.strand_lines("wide only", [np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)], 0.2)
    device, result = record(Case(build.scene((tube, build.moved())), cameras.camera()), samples=8)
    assert "PS_THIN" not in defines(device)
    assert "adapt" not in skipped(result)
    assert all(call.primitive == "TRIANGLES" for call in device.calls if call.interface.name == "lines")
