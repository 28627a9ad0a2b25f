"""What scenes cost, feature by feature: each row is drawn on the device that only records (devices/null.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import (
    build,
    cameras,
    captured_cases,
    detailed_cases,
    drawing,
    indirect_cases,
    lit_cases,
    solid_cases,
    translucent_cases,
)
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.store import STORE
from tests.support.leave_out.scenes import (
    backlit,
    before_a_picture,
    behind_a_wall,
    bent_picture,
    clear_smoke,
    coated,
    corner_colors,
    dense_mesh,
    far_crowd,
    far_light,
    further_lights,
    glow,
    hair,
    held_smoke,
    in_fog,
    looking_away,
    many_instances,
    mixed_materials,
    normals,
    one_light,
    out_of_focus,
    painted_picture,
    pane,
    picture_only,
    ribbon,
    rough_picture,
    small_balls,
    smoke_and_cube,
    stretched,
    through_a_lens,
    tube,
    two_cubes,
    two_smokes,
    unlit,
    with_column,
    with_scene,
    with_settings,
    world_only,
)

COMBINED = frozenset({"combined"})


@dataclass(frozen=True, eq=False)
class Row:
    """A scene with one thing more, or less, than another row."""

    case: Callable[[], Case]
    passes: frozenset[str] = COMBINED
    samples: int = 1
    interactive: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """What a picture took."""

    device: NullDevice
    ran: tuple[str, ...]  # passes, in order of first run
    skipped: dict[str, str]  # the others, and why
    bytes: int  # on the device while it was drawn
    report: dict


ROWS: dict[str, Row] = {
    "nothing": Row(solid_cases.empty),
    "world of one colour": Row(world_only),
    "environment picture": Row(picture_only),
    "environment picture, 16 samples": Row(picture_only, samples=16),
    "environment picture, transparent film": Row(lambda: with_scene(picture_only(), transparent=True)),
    "one cube": Row(solid_cases.cube),
    "one cube, unlit": Row(lambda: unlit(solid_cases.cube())),
    "one cube, shadows": Row(lambda: with_settings(solid_cases.cube(), use_shadows=True, shadow_resolution=64)),
    "two cubes, shadows": Row(lambda: with_settings(two_cubes(), use_shadows=True, shadow_resolution=64)),
    "two cubes, shadows of a wide light": Row(lambda: one_light(two_cubes(), 0.3)),
    "one cube, transparent film": Row(lambda: with_scene(solid_cases.cube(), transparent=True)),
    "dense mesh": Row(dense_mesh),
    "mesh of points and polygons": Row(detailed_cases.split_mesh),
    "polygons, colours from a picture": Row(lambda: painted_picture("POLYGONS")),
    "points, colours from a picture": Row(lambda: painted_picture("POINTS")),
    "polygons, roughness from a picture": Row(lambda: rough_picture("POLYGONS")),
    "points, roughness from a picture": Row(lambda: rough_picture("POINTS")),
    "polygons, colours from a picture, depth": Row(lambda: painted_picture("POLYGONS"), COMBINED | {"depth"}),
    "polygons, colours at corners": Row(corner_colors),
    "polygons, colours at corners, depth": Row(corner_colors, COMBINED | {"depth"}),
    "points": Row(solid_cases.plain_sphere),
    "points, unlit": Row(lambda: unlit(solid_cases.plain_sphere())),
    "points, colours": Row(solid_cases.sphere),
    "points, shading normals": Row(normals),
    "points, shading normals, unlit": Row(lambda: unlit(normals())),
    "points, shadows of a sun": Row(
        lambda: with_settings(solid_cases.plain_sphere(), use_shadows=True, shadow_resolution=64)
    ),
    "points, shadows of a wide light": Row(lambda: one_light(solid_cases.plain_sphere(), 0.3)),
    "points that only glow": Row(glow),
    "points and polygons, backs culled": Row(solid_cases.culled),
    "leaves": Row(detailed_cases.foliage),
    "small balls": Row(small_balls),
    "wide balls": Row(solid_cases.wide_balls),
    "many instances": Row(many_instances),
    "many instances that share levels": Row(detailed_cases.many_towers),
    "points and polygons": Row(solid_cases.mixed),
    "points and polygons, unlit": Row(solid_cases.unlit),
    "points and polygons, border": Row(solid_cases.region),
    "points and polygons, parallel camera": Row(solid_cases.parallel),
    "points and polygons, interactive": Row(solid_cases.mixed, interactive=True),
    "points and polygons, adaptive": Row(solid_cases.mixed, samples=16),
    "emission of points and polygons": Row(lit_cases.emission),
    "mixed materials": Row(mixed_materials),
    "a coat": Row(coated),
    "a surface lit from behind": Row(backlit),
    "a tint of reflections": Row(lambda: with_column(tint=np.array([[1] * 3, [1, 0.5, 0.2], [1] * 3], np.float32))),
    "a rough diffuse surface": Row(lambda: with_column(diffuse_roughness=np.array([0, 0.7, 0], np.float32))),
    "sheen": Row(lambda: with_column(sheen=np.array([[0] * 4, [1, 0.5, 0.2, 0.5], [0] * 4], np.float32))),
    "a toon": Row(lambda: with_column(toon=np.array([[-1, -1], [0.5, 0.2], [-1, -1]], np.float32))),
    "a material that is cut out": Row(lambda: with_column(holdout=np.array([0, 1, 0], np.float32))),
    "visibility buffer, stretched reflections": Row(stretched),
    "holdouts": Row(solid_cases.holdout),
    "every kind of light": Row(lit_cases.lights),
    "points in an environment picture": Row(lit_cases.environment),
    "pane": Row(pane),
    "panes and a cube": Row(translucent_cases.panes),
    "coloured panes": Row(
        lambda: with_scene(translucent_cases.tinted_panes(), lights=translucent_cases.tinted_panes().scene.lights[:1])
    ),
    "coloured panes, shadows of a wide light, too": Row(translucent_cases.tinted_panes),
    "smoke": Row(translucent_cases.in_smoke),
    "smoke, transparent film": Row(lambda: with_scene(translucent_cases.in_smoke(), transparent=True)),
    "smoke, interactive": Row(translucent_cases.in_smoke, interactive=True),
    "smoke twice, shadows": Row(two_smokes),
    "smoke among points and polygons, shadows": Row(translucent_cases.smoke),
    "coloured smoke, shadows": Row(translucent_cases.tinted_smoke),
    "smoke that is held out": Row(held_smoke),
    "fog alone": Row(lambda: in_fog(solid_cases.empty())),
    "one cube in fog, shadows": Row(lambda: in_fog(one_light(solid_cases.cube(), 0.0))),
    "two cubes in fog, shadows of a wide light": Row(lambda: in_fog(one_light(two_cubes(), 0.3))),
    "visibility buffer, two cubes in fog, shadows": Row(
        lambda: with_settings(in_fog(one_light(two_cubes(), 0.3)), technique="VISIBILITY")
    ),
    "smoke in fog": Row(translucent_cases.in_fog),
    "tube": Row(tube),
    "ribbon": Row(ribbon),
    "hair, shadows": Row(hair, samples=8),
    "strands and a cube, shadows": Row(detailed_cases.strands, samples=4),
    "visibility buffer, polygons": Row(lambda: with_settings(solid_cases.cube(), technique="VISIBILITY")),
    "visibility buffer, normals from a picture": Row(lambda: bent_picture(0.1), samples=16),
    "visibility buffer, normals from a picture finer than pixels": Row(lambda: bent_picture(64.0), samples=16),
    "visibility buffer, small balls": Row(
        lambda: with_settings(solid_cases.balls(), technique="VISIBILITY"), COMBINED | {"depth"}
    ),
    "visibility buffer, wide balls among polygons": Row(
        lambda: with_settings(solid_cases.wide_balls(), technique="VISIBILITY")
    ),
    "visibility buffer, all passes": Row(
        lambda: with_settings(solid_cases.wide_balls(), technique="VISIBILITY"), ALL_PASSES
    ),
    "visibility buffer, panes and a cube": Row(
        lambda: with_settings(translucent_cases.panes(), technique="VISIBILITY")
    ),
    "visibility buffer, panes with functions": Row(
        lambda: with_settings(translucent_cases.panes_of_functions(), technique="VISIBILITY")
    ),
    "visibility buffer, coloured panes, shadows of a wide light, too": Row(
        lambda: with_settings(translucent_cases.tinted_panes(), technique="VISIBILITY")
    ),
    "visibility buffer, panes in smoke": Row(translucent_cases.panes_in_smoke),
    "visibility buffer, panes in coloured smoke": Row(translucent_cases.panes_in_coloured_smoke),
    "visibility buffer, panes in smoke, interactive": Row(translucent_cases.panes_in_smoke, interactive=True),
    "visibility buffer, coloured smoke, shadows": Row(
        lambda: with_settings(translucent_cases.tinted_smoke(), technique="VISIBILITY")
    ),
    "visibility buffer, smoke and a cube, interactive": Row(smoke_and_cube, interactive=True),
    "visibility buffer, a cube in held out smoke": Row(lambda: smoke_and_cube(holdout=True)),
    "visibility buffer, smoke alone": Row(lambda: with_settings(translucent_cases.in_smoke(), technique="VISIBILITY")),
    "captured splats": Row(lambda: with_settings(captured_cases.captured_alone(), technique="VISIBILITY"), samples=16),
    "captured splats, panes and a cube": Row(captured_cases.captured_among_panes, samples=16),
    "captured splats from far away": Row(captured_cases.captured_far),
    "captured splats, blended as trained": Row(captured_cases.captured_trained),
    "captured splats, blended as trained, transparent film": Row(
        lambda: with_scene(captured_cases.captured_trained(), transparent=True)
    ),
    "captured splats from far away, blended as trained": Row(
        lambda: with_settings(captured_cases.captured_far(), captured_blending="TRAINED")
    ),
    "captured splats, smoke and a cube, as trained was asked for": Row(
        lambda: with_settings(captured_cases.captured_among(), captured_blending="TRAINED")
    ),
    "captured splats, relit and shadowed, and a cube": Row(captured_cases.captured_lit),
    "captured splats, a matte and a cube": Row(captured_cases.captured_matte),
    "captured splats, depth": Row(captured_cases.captured_alone, COMBINED | {"depth"}),
    "captured splats in smoke": Row(captured_cases.captured_in_smoke),
    "visibility buffer, captured splats, smoke and a cube": Row(captured_cases.captured_among),
    "visibility buffer, panes and a cube, out of focus": Row(
        lambda: out_of_focus(with_settings(translucent_cases.panes(), technique="VISIBILITY"), 4.0), samples=4
    ),
    "visibility buffer, points and polygons, out of focus, depth": Row(
        lambda: with_settings(through_a_lens("SPLAT"), technique="VISIBILITY"), COMBINED | {"depth"}
    ),
    "visibility buffer, many polygons behind a wall": Row(behind_a_wall),
    "visibility buffer, a far crowd": Row(far_crowd),
    "visibility buffer, polygons, eye-dome lighting": Row(
        lambda: with_settings(solid_cases.cube(), technique="VISIBILITY", use_eye_dome=True)
    ),
    "indirect light in a corner": Row(indirect_cases.in_a_corner),
    "indirect light in a corner, out of focus": Row(lambda: out_of_focus(indirect_cases.in_a_corner()), samples=4),
    "indirect light among balls and strands": Row(indirect_cases.among_balls_and_strands),
    "indirect light under smoke": Row(indirect_cases.under_smoke),
    "indirect light among mirrors": Row(indirect_cases.among_mirrors),
    "indirect light beside captured splats": Row(indirect_cases.beside_captured),
    "captured splats alone, indirect light asked for": Row(
        lambda: with_settings(captured_cases.captured_alone(), technique="VISIBILITY", use_indirect=True)
    ),
    "EWA": Row(lambda: with_settings(solid_cases.sphere(), technique="EWA")),
    "EWA, adaptive": Row(lambda: with_settings(solid_cases.sphere(), technique="EWA"), samples=16),
    "EWA among polygons": Row(lambda: with_settings(solid_cases.mixed(), technique="EWA")),
    "painter": Row(lambda: with_settings(solid_cases.sphere(), technique="PAINTER")),
    "painter among polygons": Row(lambda: with_settings(solid_cases.mixed(), technique="PAINTER")),
    "painter among polygons, normal and depth": Row(
        lambda: with_settings(solid_cases.mixed(), technique="PAINTER"), COMBINED | {"normal", "depth"}
    ),
    "points, depth and position": Row(solid_cases.plain_sphere, COMBINED | {"depth", "position"}),
    "points, normal": Row(solid_cases.plain_sphere, COMBINED | {"normal"}),
    "points, mist": Row(solid_cases.plain_sphere, COMBINED | {"mist"}),
    "points, mist, transparent film": Row(
        lambda: with_scene(solid_cases.plain_sphere(), transparent=True), COMBINED | {"mist"}
    ),
    "points, indices": Row(solid_cases.plain_sphere, COMBINED | {"object_index", "material_index"}),
    "points, Cryptomatte": Row(solid_cases.plain_sphere, COMBINED | {"crypto_object"}, samples=4),
    "points that move": Row(solid_cases.flowing),
    "points that move, motion": Row(solid_cases.flowing, COMBINED | {"vector"}),
    "visibility buffer, points that move, motion": Row(
        lambda: with_settings(solid_cases.flowing(), technique="VISIBILITY"), COMBINED | {"vector"}
    ),
    "points and polygons, motion": Row(solid_cases.moving, COMBINED | {"vector"}),
    "smoke, depth and motion": Row(translucent_cases.in_smoke, COMBINED | {"depth", "vector"}),
    "a light that is off": Row(lambda: further_lights(replace(far_light(), color=np.zeros(3)))),
    "a light too far to matter": Row(lambda: further_lights(far_light())),
    "a world too dark to matter": Row(lambda: with_scene(solid_cases.plain_sphere(), world=World(np.full(3, 1e-5)))),
    "a black environment picture": Row(
        lambda: with_scene(solid_cases.plain_sphere(), world=World(np.zeros(3), np.zeros((4, 8, 3), np.float32)))
    ),
    "an emission too weak to matter": Row(
        lambda: with_scene(solid_cases.plain_sphere(), materials=build.materials(emission=np.full((1, 3), 1e-4)))
    ),
    "points and polygons out of view": Row(lambda: looking_away(solid_cases.mixed())),
    "smoke out of view": Row(lambda: looking_away(two_smokes())),
    "smoke without density": Row(clear_smoke),
    "points and polygons, out of focus": Row(lambda: through_a_lens("SPLAT"), samples=4),
    "points and polygons, out of focus, depth": Row(lambda: through_a_lens("SPLAT"), COMBINED | {"depth"}, samples=4),
    "points and polygons, samples of the lens": Row(lambda: through_a_lens("LENS_SAMPLES"), samples=4),
    "environment picture, out of focus": Row(
        lambda: replace(picture_only(), camera=replace(cameras.camera(), aperture=Aperture(0.3, 3.0))), samples=4
    ),
    "points in focus in an environment picture": Row(before_a_picture, samples=4),
    "visibility buffer, a cube, passes of light": Row(
        lambda: with_settings(solid_cases.cube(), technique="VISIBILITY"),
        COMBINED | {"diffuse_direct", "diffuse_color", "environment"},
    ),
    "visibility buffer, a cube, ambient occlusion": Row(
        lambda: with_settings(solid_cases.cube(), technique="VISIBILITY"), COMBINED | {"ambient_occlusion"}
    ),
    "nothing, every pass": Row(solid_cases.empty, ALL_PASSES),
    "points and polygons, every pass": Row(solid_cases.mixed, ALL_PASSES),
}  # fmt: skip


def draw(row: Row, device: NullDevice | None = None) -> Found:
    """The row's picture, recorded, with nothing kept from others."""
    STORE.clear()
    device = device or NullDevice()
    case = row.case()
    request = Request(case.camera, case.settings, row.passes, row.samples, interactive=row.interactive)
    renderer = Renderer(device)
    renderer.costs = drawing.FREE_POINTS
    report = renderer.render(case.scene, request).report
    size = device.peak_bytes
    renderer.release()
    ran = tuple(entry["name"] for entry in report["passes"])
    return Found(device, ran, {entry["name"]: entry["because"] for entry in report["skipped"]}, size, report)


@cache
def found(name: str) -> Found:
    """The picture of ROWS[name]; drawn once in a process."""
    return draw(ROWS[name])


# What shaders use


def read(device: NullDevice) -> set[int]:
    """Ids of the textures that shaders or the host read."""
    ids = set(device.seen)
    for call in device.calls:
        ids |= {id(call.textures[name]) for _, name in call.interface.samplers}
        ids |= {id(image) for image in call.images.values()}
    return ids


def written(device: NullDevice) -> set[int]:
    """Ids of the textures that shaders write."""
    ids = {id(image) for call in device.calls for image in call.images.values()}
    return ids | {id(texture) for call in device.calls if call.target for texture in call.target.colors}


# docs/notes/leave_out.md
