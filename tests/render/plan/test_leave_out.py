"""What each scene takes on the device is what its pixels read: passes, targets, textures, attributes, programs.

docs/notes/leave_out.md holds the exact lists; `python -m tests.support.leave_out.tables --write-docs` rewrites them.
"""

import re

import numpy as np
import pytest

from pointsplat_addon.render.passes.uniforms import CAMERA_FIELDS
from pointsplat_addon.render.plan.reasons import PASSES
from scripts.scenes import drawing, solid_cases
from scripts.scenes.store import STORE
from tests.support.leave_out import rows, shaders, tables
from tests.support.leave_out.rows import ROWS, found, read, written
from tests.support.leave_out.shaders import active, idle_defines, words

IMAGE = "project resolve pull push "
EWA = "splats visibility blend normalise "
GROUPED = "group attributes shade spread "
SEEN = "shade background "
BLENDED = "light translucent add "
LAYERS = "expand difference " + BLENDED
EXPECTED = {
    "nothing": "",
    "world of one colour": "",
    "environment picture": "background",
    "environment picture, 16 samples": "background adapt",
    "environment picture, transparent film": "",
    "one cube": "polygons " + SEEN,
    "one cube, unlit": "polygons " + SEEN,
    "one cube, shadows": "polygons " + SEEN,
    "two cubes, shadows": "shadow+maps polygons " + SEEN,
    "two cubes, shadows of a wide light": "shadow+maps polygons " + SEEN,
    "one cube, transparent film": "polygons shade",
    "dense mesh": IMAGE + SEEN,
    "mesh of points and polygons": "polygons " + IMAGE + SEEN,
    "polygons, colours from a picture": "polygons " + SEEN,
    "points, colours from a picture": IMAGE + SEEN,
    "polygons, roughness from a picture": "polygons " + SEEN,
    "points, roughness from a picture": IMAGE + SEEN,
    "polygons, colours from a picture, depth": "polygons data " + SEEN,
    "polygons, colours at corners": "polygons " + SEEN,
    "polygons, colours at corners, depth": "polygons data " + SEEN,
    "points": IMAGE + SEEN,
    "points, unlit": IMAGE + SEEN,
    "points, colours": IMAGE + SEEN,
    "points, shading normals": IMAGE + SEEN,
    "points, shading normals, unlit": IMAGE + SEEN,
    "points, shadows of a sun": "shadow+maps " + IMAGE + SEEN,
    "points, shadows of a wide light": "shadow+maps " + IMAGE + SEEN,
    "points that only glow": IMAGE + SEEN,
    "points and polygons, backs culled": "polygons " + IMAGE + SEEN,
    "leaves": IMAGE + SEEN,
    "small balls": IMAGE + SEEN,
    "wide balls": "polygons spheres " + SEEN,
    "many instances": IMAGE + SEEN,
    "many instances that share levels": IMAGE + SEEN,
    "points and polygons": "polygons " + IMAGE + SEEN,
    "points and polygons, unlit": "polygons " + IMAGE + SEEN,
    "points and polygons, border": "polygons " + IMAGE + SEEN,
    "points and polygons, parallel camera": "polygons " + IMAGE + SEEN,
    "points and polygons, interactive": "polygons " + IMAGE + SEEN,
    "points and polygons, adaptive": "polygons adapt " + IMAGE + SEEN,
    "emission of points and polygons": "polygons " + IMAGE + SEEN,
    "mixed materials": "polygons " + SEEN,
    "a coat": "polygons " + SEEN,
    "a surface lit from behind": "polygons " + SEEN,
    "a tint of reflections": "polygons " + SEEN,
    "a rough diffuse surface": "polygons " + SEEN,
    "sheen": "polygons " + SEEN,
    "a toon": "polygons " + SEEN,
    "a material that is cut out": "polygons " + SEEN,
    "visibility buffer, stretched reflections": "polygons background " + GROUPED,
    "holdouts": "polygons shade " + IMAGE,
    "every kind of light": "polygons " + IMAGE + SEEN,
    "points in an environment picture": IMAGE + SEEN,
    "pane": "order background " + BLENDED,
    "panes and a cube": "shadow+maps order reach opaque+depth polygons " + SEEN + BLENDED,
    "coloured panes": "shadow+maps order reach opaque+depth polygons " + SEEN + BLENDED,
    "coloured panes, shadows of a wide light, too": "shadow+maps order reach opaque+depth polygons " + SEEN + BLENDED,
    "smoke": "order background " + BLENDED,
    "smoke, transparent film": "order " + BLENDED,
    "smoke, interactive": "order background enlarge " + BLENDED,
    "smoke twice, shadows": "shadows order background " + BLENDED,
    "smoke among points and polygons, shadows": "shadows shadow+maps order reach opaque+depth polygons "
    + IMAGE
    + SEEN
    + BLENDED,
    "coloured smoke, shadows": "shadows order reach opaque+depth polygons " + SEEN + BLENDED,
    "smoke that is held out": "order background " + BLENDED,
    "fog alone": "background",
    "one cube in fog, shadows": "shadow+maps polygons " + SEEN,
    "two cubes in fog, shadows of a wide light": "shadow+maps polygons " + SEEN,
    "visibility buffer, two cubes in fog, shadows": "shadow+maps polygons background " + GROUPED,
    "smoke in fog": "shadows shadow+maps order opaque+depth polygons " + IMAGE + SEEN + BLENDED,
    "tube": "lines " + SEEN,
    "ribbon": "lines " + SEEN,
    "hair, shadows": "shadows lines " + SEEN,
    "strands and a cube, shadows": "shadows shadow+maps lines polygons " + SEEN,
    "visibility buffer, polygons": "polygons background " + GROUPED,
    "visibility buffer, normals from a picture": "polygons background " + GROUPED,
    "visibility buffer, normals from a picture finer than pixels": "polygons background " + GROUPED,
    "visibility buffer, small balls": "cover data background " + GROUPED,
    "visibility buffer, wide balls among polygons": "cover polygons background " + GROUPED,
    "visibility buffer, all passes": "cover polygons data background " + GROUPED,
    "visibility buffer, panes and a cube": "shadow+maps polygons background compose add " + GROUPED,
    "visibility buffer, panes with functions": "shadow+maps polygons background compose add " + GROUPED,
    "visibility buffer, coloured panes, shadows of a wide light, too": "shadow+maps polygons background compose add "
    + GROUPED,
    "visibility buffer, panes in smoke": "shadows shadow+maps order reach polygons background compose expand "
    + BLENDED
    + GROUPED,
    "visibility buffer, panes in coloured smoke": "shadows shadow+maps order reach polygons background compose expand "
    + BLENDED
    + GROUPED,
    "visibility buffer, panes in smoke, interactive": "shadows shadow+maps order reach polygons background compose "
    "expand enlarge " + BLENDED + GROUPED,
    "visibility buffer, coloured smoke, shadows": "shadows order reach polygons background " + GROUPED + LAYERS,
    "visibility buffer, smoke and a cube, interactive": "order polygons background enlarge " + GROUPED + LAYERS,
    "visibility buffer, a cube in held out smoke": "order polygons background " + GROUPED + LAYERS,
    "visibility buffer, smoke alone": "order background " + BLENDED,
    "captured splats": "order captured background translucent add",
    "captured splats, panes and a cube": "order captured polygons background compose expand translucent add " + GROUPED,
    "captured splats from far away": "order captured background translucent add",
    "captured splats, blended as trained": "order captured background translucent add",
    "captured splats, blended as trained, transparent film": "order captured translucent add",
    "captured splats from far away, blended as trained": "order captured background translucent add",
    "captured splats, smoke and a cube, as trained was asked for": "order captured polygons background "
    + GROUPED
    + LAYERS,
    "captured splats, relit and shadowed, and a cube": "shadows order shadow+maps captured polygons background "
    "translucent expand difference add " + GROUPED,
    "captured splats, a matte and a cube": "shadows order shadow+maps captured polygons background mattes "
    "translucent expand difference add " + GROUPED,
    "captured splats, depth": "order captured background translucent captured+depth add",
    "captured splats in smoke": "order captured background " + BLENDED,
    "visibility buffer, captured splats, smoke and a cube": "order captured polygons background " + GROUPED + LAYERS,
    "visibility buffer, panes and a cube, out of focus": "shadow+maps polygons light tiles defocus " + GROUPED,
    "visibility buffer, points and polygons, out of focus, depth": "cover polygons data light tiles defocus " + GROUPED,
    "visibility buffer, many polygons behind a wall": "occlusion polygons background " + GROUPED,
    "visibility buffer, a far crowd": "cover background " + GROUPED,
    "visibility buffer, polygons, eye-dome lighting": "polygons background eye+dome " + GROUPED,
    "indirect light in a corner": "shadow+maps light+tree gather polygons background " + GROUPED,
    "indirect light in a corner, out of focus": "shadow+maps light+tree gather polygons light tiles defocus " + GROUPED,
    "indirect light among balls and strands": "light+tree gather cover polygons lines background " + GROUPED,
    "indirect light under smoke": "shadows shadow+maps light+tree gather polygons reach order background "
    + GROUPED
    + LAYERS,
    "indirect light among mirrors": "shadow+maps light+tree gather polygons background " + GROUPED,
    "indirect light beside captured splats": "light+tree gather order captured polygons background "
    "expand difference translucent add " + GROUPED,
    "captured splats alone, indirect light asked for": "order captured background translucent add",
    "EWA": EWA + SEEN,
    "EWA, adaptive": "adapt " + EWA + SEEN,
    "EWA among polygons": "polygons " + EWA + SEEN,
    "painter": "order background " + BLENDED,
    "painter among polygons": "order opaque+depth polygons " + SEEN + BLENDED,
    "painter among polygons, normal and depth": "order opaque+depth polygons data averages " + IMAGE + SEEN + BLENDED,
    "points, depth and position": "data " + IMAGE + SEEN,
    "points, normal": IMAGE + SEEN,
    "points, mist": IMAGE + SEEN,
    "points, mist, transparent film": IMAGE + SEEN,
    "points, indices": "data " + IMAGE + SEEN,
    "points, Cryptomatte": "data " + IMAGE + SEEN,
    "points that move": IMAGE + SEEN,
    "points that move, motion": "data " + IMAGE + SEEN,
    "visibility buffer, points that move, motion": "cover data background " + GROUPED,
    "points and polygons, motion": "polygons data " + IMAGE + SEEN,
    "smoke, depth and motion": "order background " + BLENDED,
    "a light that is off": "shadow+maps " + IMAGE + SEEN,
    "a light too far to matter": "shadow+maps " + IMAGE + SEEN,
    "a world too dark to matter": IMAGE + SEEN,
    "a black environment picture": IMAGE + SEEN,
    "an emission too weak to matter": IMAGE + SEEN,
    "points and polygons out of view": "",
    "smoke out of view": "",
    "smoke without density": IMAGE + SEEN,
    "points and polygons, out of focus": "polygons shade light tiles defocus " + IMAGE,
    "points and polygons, out of focus, depth": "polygons data shade light tiles defocus " + IMAGE,
    "points and polygons, samples of the lens": "polygons " + IMAGE + SEEN,
    "environment picture, out of focus": "backdrop background",
    "points in focus in an environment picture": "backdrop " + IMAGE + SEEN,
    "visibility buffer, a cube, passes of light": "polygons background light+passes " + GROUPED,
    "visibility buffer, a cube, ambient occlusion": "polygons background light+passes " + GROUPED,
    "nothing, every pass": "",
    "points and polygons, every pass": "polygons data " + IMAGE + SEEN,
}
# Entries of the report that are no passes: what of the scene, or of the samples, is left out.
BESIDE_PASSES = {"samples", "lights", "world", "emission"}


def names(device):
    """(program, sampler) of all that is read."""
    return {(interface.name, sampler) for interface in device.interfaces for _, sampler in interface.samplers}


def told(device):
    return {name for interface in device.interfaces for name, _ in interface.defines}


@pytest.mark.parametrize("name", ROWS)
def test_only_the_passes_that_a_scene_needs_run(name):
    assert set(found(name).ran) == {word.replace("+", " ") for word in EXPECTED[name].split()}


@pytest.mark.parametrize("name", ROWS)
def test_every_pass_of_the_list_has_either_run_or_a_reason_why_not(name):
    ran, skipped = set(found(name).ran), found(name).skipped
    assert ran | (skipped.keys() - BESIDE_PASSES) == PASSES.keys()
    assert not ran & skipped.keys()
    assert all(skipped.values())
    assert "no sample came so far" not in skipped.values()


def test_each_pass_of_the_list_runs_in_some_scene():
    assert {name for row in ROWS for name in found(row).ran} == PASSES.keys()


@pytest.mark.parametrize("name", ROWS)
def test_every_texture_is_read_and_what_is_not_sent_is_written(name):
    device = found(name).device
    used, drawn = read(device), written(device)
    for texture in device.textures:
        assert texture.uploaded or id(texture) in drawn
    # A pyramid's coarsest level has no coarser one that asks for its near ends.
    coarsest = [call.target.colors[-1] for call in device.calls if call.target and call.interface.name == "pull"]
    unread = [t for t in device.textures if id(t) not in used and all(t is not front for front in coarsest)]
    assert not unread


@pytest.mark.parametrize("name", ROWS)
def test_every_target_is_drawn_into_or_cleared_for_one_that_is(name):
    """A target that only clears shares its textures with one that draws."""
    device = found(name).device
    drawn = {id(call.target) for call in device.calls}
    shared = written(device)
    for target in device.targets:
        assert id(target) in drawn or all(id(texture) in shared for texture in target.colors)


@pytest.mark.parametrize("name", ROWS)
def test_programs_declare_only_what_their_code_names(name):
    for interface in found(name).device.interfaces:
        known = words(interface)
        for kind in (interface.samplers, interface.outputs, interface.images):
            assert {declared for _, declared in kind} <= known, interface.name
        assert {declared for _, _, declared in interface.varyings} <= known, interface.name


@pytest.mark.parametrize("name", ROWS)
def test_uniform_blocks_hold_only_what_their_code_names(name):
    """The camera's fields come together; functions of lib/geometry/camera.glsl that a program does not call name
    some."""
    camera = {declared for _, declared in CAMERA_FIELDS}
    for interface in found(name).device.interfaces:
        declared = {field for _, field in interface.block.fields} if interface.block else set()
        values = {word for _, value in interface.defines for word in re.findall(r"\w+", value)}
        assert declared - (camera if camera <= declared else set()) <= words(interface) | values, interface.name


@pytest.mark.parametrize("name", ROWS)
def test_every_define_changes_its_program(name):
    """Programs that are told apart by what changes nothing would be compiled twice."""
    for interface in found(name).device.interfaces:
        assert not idle_defines(interface), interface.name


@pytest.mark.parametrize("name", ROWS)
def test_no_two_programs_are_the_same(name):
    """Neither twice the same code, nor one program by two names."""
    seen = set()
    for interface in found(name).device.interfaces:
        text = "\n".join(active(part, dict(interface.defines)) for part in shaders.stages(interface))
        key = (text, interface.defines, interface.samplers, interface.outputs, interface.varyings)
        assert key not in seen, interface.name
        seen.add(key)


def test_the_page_says_what_is():
    """Otherwise: python -m tests.support.leave_out.tables --write-docs"""
    page = tables.DOCS.read_text(encoding="utf-8")
    assert page == tables.with_tables(page)


def test_the_page_and_the_tests_know_the_same_scenes():
    assert EXPECTED.keys() == ROWS.keys()
    assert len(ROWS) >= 30


def test_conditionals_of_shaders_are_followed():
    text = "\n".join(
        [
            "#ifdef A",
            "one",
            "#elif defined(B) && B > 1",
            "two",
            "#else",
            "three",
            "#endif",
            "#ifndef A",
            "four",
            "#endif",
        ]
    )
    assert active(text, {"A": "1"}).split() == ["one"]
    assert active(text, {"B": "2"}).split() == ["two", "four"]
    assert active(text, {"B": "1"}).split() == ["three", "four"]


# Feature by feature


def test_what_differs_between_scenes_is_what_the_feature_needs():
    """Each: a scene, one with a feature more, what that one's programs read beyond, and defines beyond."""
    pairs = (
        ("points, unlit", "points", {("shade", "ps_lights"), ("shade", "ps_normal")}, "PS_HAS_SUNS"),
        ("points", "points, colours", {("resolve", "ps_color"), ("shade", "ps_color")}, "PS_COLOR"),
        ("points", "points, shadows of a sun", {("shade", "ps_shadow_maps")}, "PS_SHADOWS"),
        ("points, shadows of a sun", "points, shadows of a wide light", set(), "PS_SHADOW_SOFT"),
        ("points", "points, shading normals", {("resolve", "ps_shading_normal")}, "PS_SHADING_NORMAL"),
        ("points, unlit", "points, shading normals", {("resolve", "ps_shading_normal")}, "PS_SHADING_NORMAL"),
        ("points", "many instances", {("project", "ps_instances")}, None),
        ("points", "points, indices", {("data", "ps_owner")}, "PS_OWNER"),
        ("points that move", "points that move, motion",
         {("resolve", "ps_velocity")}, "PS_VELOCITY"),
        ("visibility buffer, small balls", "visibility buffer, points that move, motion",
         {("attributes", "ps_velocity")}, "PS_VELOCITY"),
        ("points and polygons, motion", "points that move, motion", {("resolve", "ps_velocity")}, "PS_VELOCITY"),
        ("environment picture", "environment picture, out of focus", {("background", "ps_backdrop")}, "PS_BACKDROP"),
        ("pane", "panes and a cube", {("translucent", "ps_depth")}, "PS_AMONG_OPAQUE"),
        ("pane", "panes and a cube", {("reach", "ps_shadow_panes"), ("reach", "ps_pane_lights")}, "PS_SHADOW_PANES"),
        ("panes and a cube", "coloured panes", {("translucent", "ps_tint")}, "PS_PANES_COLORED"),
        ("panes and a cube", "coloured panes", {("light", "ps_tint"), ("light", "ps_shaded")}, "PS_SHADED"),
        ("coloured panes", "coloured panes, shadows of a wide light, too", {("shade", "ps_pane_faces")},
         "PS_SHADOW_FACES"),
        ("smoke", "coloured smoke, shadows", {("translucent", "ps_tint")}, "PS_TINT"),
        ("smoke", "smoke that is held out", {("add", "ps_cut")}, "PS_HOLDOUT"),
        ("visibility buffer, polygons", "visibility buffer, polygons, eye-dome lighting",
         {("eye dome", "ps_centre"), ("centre", "ps_depths")}, "PS_NEIGHBOURS"),
        ("visibility buffer, normals from a picture", "visibility buffer, normals from a picture finer than pixels",
         {("attributes", "ps_baked_normal_levels")}, "PS_LEVELS"),
        ("tube", "ribbon", {("lines", "ps_side")}, "PS_RIBBON"),
        ("EWA", "points, colours", {("push", "ps_front")}, "PS_FRONT"),
        ("one cube", "points and polygons", {("push", "ps_front")}, "PS_FRONT"),
        ("polygons, colours from a picture", "polygons, roughness from a picture",
         {("polygons", "ps_baked_surface")}, "PS_SURFACE"),
        ("captured splats", "captured splats, blended as trained", set(), "PS_TRAINED"),
        ("visibility buffer, a cube, passes of light", "visibility buffer, a cube, ambient occlusion",
         {("shade", "ps_gathered_light")}, "PS_TERM_OCCLUSION"),
    )  # fmt: skip
    for plain, more, samplers, define in pairs:
        before, after = found(plain).device, found(more).device
        assert samplers <= names(after), more
        assert not samplers & names(before), plain
        assert define is None or (define in told(after) and define not in told(before)), (plain, more)


def test_attributes_of_normals_are_not_sent_where_nothing_is_lit():
    lit, unlit = (found(name).device for name in ("points, shading normals", "points, shading normals, unlit"))
    assert lit.uploaded_bytes > unlit.uploaded_bytes
    assert "PS_SHADING_NORMAL" not in told(unlit)
    assert "PS_NORMAL" not in told(unlit)


def test_blending_as_trained_costs_nothing_where_it_does_not_hold():
    """The same passes, textures and programs as where it is not asked for."""
    plain, asked = (
        found("visibility buffer, captured splats, smoke and a cube"),
        found("captured splats, smoke and a cube, as trained was asked for"),
    )
    assert plain.ran == asked.ran
    assert plain.device.interfaces == asked.device.interfaces
    assert plain.bytes == asked.bytes
    alone, trained = (found(f"captured splats{more}").device for more in ("", ", blended as trained"))
    changed = {interface.name for interface in trained.interfaces if ("PS_TRAINED", "1") in interface.defines}
    assert changed == {"captured", "background", "add"}
    assert alone.uploaded_bytes == trained.uploaded_bytes


def test_a_picture_of_colours_sends_no_constants_beside_it():
    device = found("polygons, colours from a picture").device
    assert ("polygons", "ps_baked_color") in names(device)
    assert not {("polygons", "ps_baked_surface"), ("polygons", "ps_materials")} & names(device)


def test_where_nothing_opaque_is_drawn_there_is_no_g_buffer():
    for name in ("environment picture", "pane", "smoke", "smoke, depth and motion", "painter"):
        device = found(name).device
        outputs = {output for interface in device.interfaces for _, output in interface.outputs}
        assert not {"out_normal", "out_front"} & outputs
        assert "shade" not in device.names
        assert "ps_centre" not in {s for i in device.interfaces if i.name == "background" for _, s in i.samplers}


def test_without_a_pyramid_no_near_ends_are_kept():
    for name in ("one cube", "wide balls", "tube", "EWA"):
        assert "PS_FRONT" not in told(found(name).device)
        assert "push" not in found(name).device.names


def test_what_only_glows_is_not_lit():
    device = found("points that only glow").device
    assert found("points that only glow").skipped["lights"] == "1 of 1: nothing that is drawn reflects light"
    shade = next(interface for interface in device.interfaces if interface.name == "shade")
    assert "ps_lights" not in {sampler for _, sampler in shade.samplers}
    assert "PS_NORMAL" not in told(device)


def test_the_viewport_presents_without_a_depth_where_nothing_has_one():
    for name, reads in (("smoke, interactive", False), ("points and polygons, interactive", True)):
        row = ROWS[name]
        case = row.case()
        device = rows.NullDevice()
        request = rows.Request(case.camera, case.settings, row.passes, 2, interactive=True)
        frame = rows.Renderer(device, STORE).start(case.scene, request)
        frame.sample()
        frame.present()
        present = device.calls[-1].interface
        assert present.name == "present"
        assert ("ps_centre" in {sampler for _, sampler in present.samplers}) == reads
        assert {declared for _, declared in present.samplers} <= words(present)
        assert not idle_defines(present)
        frame.release()


def test_the_viewport_presents_a_world_of_one_colour_from_one_texel():
    case, device = solid_cases.empty(), rows.NullDevice()
    request = rows.Request(case.camera, case.settings, rows.COMBINED, 2, interactive=True)
    frame = rows.Renderer(device, STORE).start(case.scene, request)
    for _ in range(2):
        frame.present()
        (read,) = device.calls[-1].textures.values()
        assert (device.calls[-1].interface.name, read.size) == ("present", (1, 1))
        frame.sample()
    frame.release()
    assert not device.alive


@pytest.mark.parametrize("name", ROWS)
def test_every_scene_is_drawn_by_a_device_as_it_is_planned(name):
    """All variants compile, and the same passes run as on the device that only records, but those that a reading
    decides: which tiles still differ."""
    row = ROWS[name]
    case = row.case()
    request = rows.Request(case.camera, case.settings, row.passes, row.samples, interactive=row.interactive)
    renderer = drawing.opengl()
    renderer.kept.clear()  # orders and light of pictures before
    result = renderer.render(case.scene, request)
    assert {entry["name"] for entry in result.report["passes"]} == set(found(name).ran)
    assert all(np.isfinite(picture).all() for picture in result.pixels.values())
