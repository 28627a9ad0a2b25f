"""EWA: splats against their closed forms, what mixes and what does not, extremes, and what a view compiles."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.splat.ewa import low_pass
from pointsplat_addon.devices.null import LIMITS, NullDevice
from pointsplat_addon.render.passes.outputs import BACKGROUND_DEPTH
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import compare
from scripts.scenes import awkward_cases, build, cameras, clouds, drawing, meshes, solid_cases
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.drawing import render
from scripts.scenes.store import STORE
from scripts.studies import technique_error
from tests.reference import ewa, opaque
from tests.support.splats import (
    EWA,
    EXTREMES,
    NORMALS,
    ONLY_COMBINED,
    VIEWS,
    dark,
    lone,
    of_nodes,
    on_screen,
    shape_picture,
    splats,
)

PROGRAMS = {"splats", "visibility", "blend", "normalise"}
IMAGE_SPACE = {"project", "identify", "resolve", "pull", "push"}


def closed_form(case: Case, samples: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Of the splats of the only cloud: their weights (H, W, N), and whether they hold the pixels' centres."""
    width, height = case.camera.resolution
    centre, a, b, middle, pixels = on_screen(case)
    moments = ewa.projected_covariance(centre, a, b, case.camera.pixel_from_view()[:2], case.camera.perspective)
    found = ewa.resampling_weights(pixels, middle, moments, low_pass(samples))
    offset = pixels[:, None] - middle
    within = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(moments), offset) <= 4
    return found.reshape(height, width, -1), within.reshape(height, width, -1)


def picture(case: Case, samples: int = 1, passes=ONLY_COMBINED) -> np.ndarray:
    return render(case, passes, samples).pixels["combined"].astype(float)


# Closed forms


@pytest.mark.parametrize("parallel", [None, 4.0])
@pytest.mark.parametrize("normal", NORMALS)
@pytest.mark.parametrize("radii", [[0.05], [0.09], [0.13, 0.06]])
def test_one_splat_is_its_closed_form_gaussian(parallel, normal, radii):
    """As wide as no pixel is surrounded by others that it holds: those within a surface count as whole."""
    case, color = lone("lone", normal, radii, parallel)
    weight, within = closed_form(case)
    expected = ewa.coverage(weight[..., 0], within[..., 0])
    found = picture(case)
    assert 0.01 < expected.max() < 1
    assert np.abs(found[..., 3] - expected).max() < 1e-3  # measured 2.5e-4: half floats
    assert np.abs(found[..., :3] - expected[..., None] * color).max() < 1e-3  # measured 3.9e-4: half floats


def test_splats_of_one_surface_are_the_normalised_sum():
    """Disks on a plane, each in a colour of its own: at every pixel that some of them reaches."""
    rng = np.random.default_rng(3)
    place = rng.uniform(-0.6, 0.6, (40, 2))
    position = np.stack([place[:, 0], np.zeros(40), place[:, 1]], axis=1)
    thing = splats("on a plane", position, (0, -1, 0), [0.2], rng.uniform(0, 1, (40, 3)))
    case = dark(thing, camera=cameras.camera((0.5, -4, 1)))
    weight, _ = closed_form(case)
    found = picture(case)
    cloud = thing.cloud
    assert cloud is not None
    assert cloud.emission is not None
    total = weight.sum(axis=2)
    some = (total > 1e-2) & (found[..., 3] > 0)
    expected = (weight @ cloud.emission)[some] / total[some, None]
    mean = found[some][:, :3] / found[some][:, 3:]
    assert some.sum() > 300
    assert np.abs(mean - expected).max() < 2e-3  # measured 6.9e-4: half floats, and the plane's normal in 24 bits


@pytest.mark.parametrize("turn", [0, 30, 60])
def test_surfaces_one_radius_apart_do_not_mix(turn):
    angle = np.radians(turn)
    normal = np.array([np.sin(angle), -np.cos(angle), 0])
    cells = (np.arange(14) - 6.5) * 0.1
    u, w = (a.ravel()[:, None] for a in np.meshgrid(cells, cells))
    plane = u * np.array([np.cos(angle), np.sin(angle), 0]) + w * np.array([0, 0, 1.0])
    radius = 0.08
    front = splats(f"front {turn}", plane, normal, [radius], (1, 0, 0))
    behind = splats(f"behind {turn}", plane - radius * normal, normal, [radius], (0, 0, 1))
    camera = cameras.camera(resolution=(144, 120))
    alone = picture(dark(front, camera=camera))
    both = picture(dark(front, behind, camera=camera))
    inside = alone[..., 3] == 1
    assert inside.sum() > 100
    assert both[inside][:, 2].max() == 0
    assert np.abs(both[inside][:, 0] - 1).max() < 1e-3  # measured 4.9e-4: half floats


@pytest.mark.parametrize("samples", [4, 16])
def test_a_wall_behind_a_panel_does_not_show(samples):
    """Its splats reach in front of the panel that it ends at, as their rims do; not their colours beside those."""
    cells = (np.arange(14) - 6.5) * 0.1
    u, w = (a.ravel() for a in np.meshgrid(cells, cells))
    panel = np.stack([u, np.zeros_like(u), w], axis=1)
    y, z = (a.ravel() for a in np.meshgrid(0.05 + 0.1 * np.arange(4), cells))
    wall = np.stack([np.full_like(y, 0.23), y, z], axis=1)
    radius = 0.05 * np.sqrt(2)
    scene = (
        splats("panel", panel, (0, -1, 0), [radius], (1, 0, 0)),
        splats("wall", wall, (1, 0, 0), [radius], (0, 0, 1)),
    )
    camera = cameras.camera((2, -3, 0.5), resolution=(96, 80))
    narrow = replace(EWA, filter_size=0.75)  # rims are few samples of a pixel, which lie elsewhere in a wider filter
    found = picture(dark(*scene, camera=camera, settings=narrow), samples)
    inside = picture(dark(scene[0], camera=camera, settings=narrow), samples)[..., 3] == 1
    assert inside.sum() > 500
    assert found[inside][:, 2].mean() < 0.006  # measured 0.0041; 0.0152 where the steeper of both ranges counts
    assert found[inside][:, 2].max() < 0.35  # measured 0.289: rims


def test_near_splats_lie_where_the_rays_meet_them():
    """A wide tilted disk close to the eye, whose outline is far from an affine one's."""
    thing = splats("near disk", (0.1, 0, 0), (0.5, -1, 0.6), [0.55])
    camera = cameras.camera((0, -0.9, 0.1), (0, 0, 0), field_of_view=70, near=0.05, resolution=(96, 96))
    case = dark(thing, camera=camera)
    result = render(case, frozenset({"combined", "depth"}))
    expected = opaque.picture(case.scene, camera)
    seen, there = result.pixels["depth"][..., 0] < BACKGROUND_DEPTH, expected.depth < BACKGROUND_DEPTH
    assert there.sum() > 1000
    assert np.count_nonzero(seen != there) <= 2  # measured 0; the normal has 24 bits
    both = seen & there
    assert np.abs(result.pixels["depth"][..., 0][both] / expected.depth[both] - 1).max() < 2e-3  # measured 4.3e-4


# Extremes


@pytest.mark.parametrize("name", EXTREMES)
@pytest.mark.parametrize("parallel", [None, 4.0])
def test_extreme_splats_are_finite_and_do_not_flash(name, parallel):
    """No more than the pixels that their outline has, each up to the end of its kernel."""
    given = {"position": (0, 0, 0), **EXTREMES[name]}
    thing = splats(f"extreme {name}", **given)
    camera = cameras.camera(parallel=parallel, near=-10.0 if parallel else 0.1)
    result = render(replace(dark(thing, camera=camera), settings=EWA), ALL_PASSES)
    for key, array in result.pixels.items():
        assert np.isfinite(array if not key.startswith("crypto") else array[..., 1::2]).all(), key
    alpha = result.pixels["combined"][..., 3]
    exact = opaque.picture(dark(thing, camera=camera).scene, camera).combined[..., 3]
    outline = np.count_nonzero(exact)
    perimeter = 2 * sum(camera.resolution)
    assert alpha.sum() <= outline + 0.5 * perimeter
    if name in ("tiny", "without a radius", "behind the eye") and parallel is None:
        assert alpha.sum() < 1e-6


def test_a_disk_larger_than_the_screen_fills_it():
    thing = splats("huge", (0, 0, 0), (0, -1, 0), [500.0], (0.3, 0.6, 0.9))
    found = picture(dark(thing, camera=cameras.camera()))
    assert np.abs(found - (0.3, 0.6, 0.9, 1)).max() < 1e-3  # measured 5.9e-4: half floats


@pytest.mark.parametrize("name", CASES)
def test_every_pass_of_every_scene_is_finite(name):
    case = CASES[name]()
    result = render(replace(case, settings=replace(case.settings, technique="EWA")), samples=2)
    for key, array in result.pixels.items():
        assert np.isfinite(array if not key.startswith("crypto") else array[..., 1::2]).all(), key
    combined = result.pixels["combined"]
    assert combined.min() >= 0
    assert combined[..., 3].max() <= 1 + 1e-6


@pytest.mark.parametrize("name", ["sphere", "mixed", "holdout", "parallel", "culled", "region"])
def test_pictures_are_near_those_of_image_space(name):
    """The same surfaces at the same places: only edges and what is finer than a pixel differ."""
    case = CASES[name]()
    found = [
        render(replace(case, settings=replace(case.settings, technique=technique)), ONLY_COMBINED, 16).pixels[
            "combined"
        ]
        for technique in ("IMAGE_SPACE", "EWA")
    ]
    assert np.abs(found[0] - found[1]).mean() < 0.02  # measured 0.0168


# What a view needs


def record(case: Case, device=None, samples: int = 1):
    device = device or NullDevice()
    result = Renderer(device, STORE).render(case.scene, case.request(ONLY_COMBINED, samples))
    return device, result


def with_technique(case: Case, technique: str) -> Case:
    return replace(case, settings=replace(case.settings, technique=technique))


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA"])
def test_the_other_technique_compiles_nothing_and_says_why(technique):
    device, result = record(with_technique(solid_cases.sphere(), technique))
    names = {interface.name for interface in device.interfaces}
    used, unused = (PROGRAMS, IMAGE_SPACE) if technique == "EWA" else (IMAGE_SPACE, PROGRAMS)
    assert used <= names
    assert not unused & names
    why = {entry["name"]: entry["because"] for entry in result.report["skipped"]}
    assert {why[name] for name in unused - {"identify"}} == {
        "points are drawn by EWA" if technique == "EWA" else "points are drawn in image space"
    }
    soft = any("PS_COVERAGE" in dict(interface.defines) for interface in device.interfaces)
    assert soft == (technique == "EWA")


def test_polygons_alone_know_nothing_of_ewa():
    device, _ = record(with_technique(solid_cases.cube(), "EWA"))
    assert not (PROGRAMS | IMAGE_SPACE) & {interface.name for interface in device.interfaces}
    assert not any("PS_COVERAGE" in dict(interface.defines) for interface in device.interfaces)


def test_only_near_and_wide_splats_are_met_by_rays_and_only_balls_have_round_normals():
    def defines(case):
        return {name for interface in record(case)[0].interfaces for name, _ in interface.defines}

    few = Case(build.scene((build.points("few far", clouds.sphere_cloud(4000)), build.moved())),
               cameras.camera((0, -30, 0)), EWA)  # fmt: skip
    assert "PS_LARGE" not in defines(few)
    assert "PS_LARGE" in defines(with_technique(awkward_cases.inside(), "EWA"))
    assert "PS_BALLS" not in defines(few)
    cloud = replace(clouds.sphere_cloud(4000), normal=None)
    balls = Case(build.scene((build.points("far balls", cloud), build.moved())), cameras.camera((0, -60, 0)), EWA)
    assert "PS_BALLS" in defines(balls)


def test_splats_are_projected_once_for_all_samples():
    device, _ = record(with_technique(solid_cases.sphere(), "EWA"), samples=4)
    assert device.names.count("splats") == 1
    assert device.names.count("normalise") == 4


def test_without_blending_of_floats_image_space_takes_over_and_says_so():
    device, result = record(with_technique(solid_cases.sphere(), "EWA"), NullDevice(replace(LIMITS, float_blend=False)))
    assert not PROGRAMS & set(device.names)
    assert any("EWA" in warning for warning in result.report["warnings"])


# Silhouettes and minification


@pytest.mark.parametrize("name", meshes.SHAPES)
@pytest.mark.parametrize("samples", [1, 16])
def test_silhouettes_do_not_thicken_and_surfaces_have_no_holes(name, samples):
    mesh = meshes.shape(name)
    for view in range(len(VIEWS)):
        truth = shape_picture(build.mesh(mesh, "POLYGONS"), view, "AUTO", 64)
        STORE.clear()
        found = compare(shape_picture(build.mesh(mesh, "POINTS"), view, "EWA", samples), truth)
        assert found["inside"] > 5000
        assert found["holes"] == 0
        assert abs(found["thickening"] - 1) < 0.01  # measured 0.0086 with one sample, 0.0031 with 16
        assert found["iou"] > 0.99  # measured 0.9955


NARROW = {"filter_size": 0.75}  # pixels: a wider filter hides what techniques differ by


@pytest.mark.parametrize("tolerance", [1.0, 2.0])
def test_surfaces_are_nearer_to_the_polygons_than_in_image_space(tolerance):
    """In decibels, without the edges. Truths are polygons of which each sample is shaded by itself."""
    mesh = meshes.shape("torus")
    truth = shape_picture(build.mesh(mesh, "POLYGONS"), 0, "IMAGE_SPACE", 64, **NARROW)
    STORE.clear()
    found = {
        technique: compare(shape_picture(build.mesh(mesh, "POINTS"), 0, technique, 16, tolerance, **NARROW), truth)
        for technique in ("IMAGE_SPACE", "EWA")
    }
    assert found["EWA"]["interior_psnr"] - found["IMAGE_SPACE"]["interior_psnr"] > 3  # measured 7.3


@pytest.mark.parametrize("name", meshes.SHAPES)
def test_many_samples_are_nearer_to_the_polygons_than_those_of_any_other_technique(name):
    """In decibels, with the edges."""
    mesh = meshes.shape(name)
    truth = shape_picture(build.mesh(mesh, "POLYGONS"), 0, "IMAGE_SPACE", 64, **NARROW)
    STORE.clear()
    found = {
        technique: compare(shape_picture(build.mesh(mesh, "POINTS"), 0, technique, 16, **NARROW), truth)
        for technique in ("IMAGE_SPACE", "PAINTER", "EWA")
    }
    for other in ("IMAGE_SPACE", "PAINTER"):
        assert found["EWA"]["psnr"] - found[other]["psnr"] > 0.3  # measured 0.42
        assert found["EWA"]["interior_psnr"] > found[other]["interior_psnr"]


@pytest.mark.parametrize("view", technique_error.VIEWS)
def test_a_textured_plane_errs_less_than_by_painting(view):
    """At equal numbers of points."""
    renderer, plane = drawing.opengl(), technique_error.plane(technique_error.VIEWS[view])
    truth, _, _ = technique_error.picture(renderer, plane, "POLYGONS", "IMAGE_SPACE", 1.0, 64)
    found = []
    for technique in ("EWA", "PAINTER"):
        drawn, points, _ = technique_error.picture(renderer, plane, "POINTS", technique, 2.0, 16)
        found.append(technique_error.errors(drawn, truth, points))
    assert found[0].points == found[1].points
    assert found[0].rmse < 0.95 * found[1].rmse  # measured 0.77, 0.69


@pytest.mark.parametrize("tolerance", [2.0, 4.0])
def test_nodes_of_an_octree_close_what_their_points_close(tolerance):
    figures, leaks = of_nodes(EWA, tolerance)
    assert leaks < 20  # measured 16, in 3 pixels, of one sample of 16; 96 in many with ellipses of moments
    assert figures["interior_psnr"] > 50  # measured 53.4
    assert abs(figures["thickening"] - 1) < 0.002  # measured 0.00095


CELL = 0.25  # side of a square of the checkerboard


def checkerboard(technique: str, samples: int, step: float = 0.04) -> tuple[np.ndarray, np.ndarray]:
    """Luminance (H, W) of a plane to the horizon, and how many pixels a square is high in each row."""
    x, y = np.arange(-12, 12, step) + step / 2, np.arange(0.5, 40, step) + step / 2
    x, y = (a.ravel() for a in np.meshgrid(x, y))
    position = np.stack([x, y, np.zeros_like(x)], axis=1)
    color = np.repeat(((np.floor(x / CELL) + np.floor(y / CELL)) % 2)[:, None], 3, axis=1)
    thing = splats(f"checkerboard {step}", position, (0, 0, 1), [step * np.sqrt(0.5)], color)
    camera = cameras.camera((0, 0, 0.5), (0, 3, 0.2), resolution=(160, 100), field_of_view=60, near=0.05)
    case = dark(thing, camera=camera, settings=Settings(technique=technique, use_shadows=False), transparent=False)
    _, fy, _, _ = camera.pixel_from_view()
    rows = np.arange(100) + 0.5
    # Where the ray of each row meets the plane, and how fast that moves.
    to = np.linalg.inv(camera.view_from_world)[:3, :3] @ np.stack([np.zeros(100), (rows - 50) / fy, -np.ones(100)])
    with np.errstate(all="ignore"):
        distance = np.where(to[2] < 0, 0.5 * to[1] / -to[2], np.inf)
        high = CELL / np.abs(np.gradient(distance))
    return picture(case, samples)[..., 0], np.nan_to_num(high)


def test_a_checkerboard_to_the_horizon_becomes_its_mean_without_moire():
    """Where squares are lower than a pixel and lie before the plane's end, one sample shows grey."""
    found, high = checkerboard("EWA", 1)
    aliased, _ = checkerboard("IMAGE_SPACE", 1)
    horizon = np.flatnonzero(found.max(axis=1) > 0).max()
    far = [row for row in range(horizon - 3) if 0 < high[row] < 0.7 and high[row - 1] < 1]
    assert len(far) >= 5
    middle = slice(40, 120)
    assert np.abs(found[far][:, middle] - 0.5).max() < 0.1  # measured 0.056
    assert abs(found[far][:, middle].mean() - 0.5) < 0.01  # measured 0.0006
    # The same splats without a low-pass are black and white there.
    assert np.abs(aliased[far][:, middle] - 0.5).mean() > 0.3  # measured 0.499


def test_tiles_that_are_done_draw_no_splats_and_the_others_miss_none():
    case = with_technique(solid_cases.sphere(), "EWA")
    case = replace(case, camera=cameras.camera(resolution=(160, 128)))
    found = {}
    for adaptive in (False, True):
        settings = replace(case.settings, use_adaptive_sampling=adaptive, adaptive_threshold=0.02)
        result = render(replace(case, settings=settings), ONLY_COMBINED, 64)
        found[adaptive] = result
    assert "samples" in {entry["name"] for entry in found[True].report["skipped"]}
    difference = np.abs(found[True].pixels["combined"] - found[False].pixels["combined"])
    assert difference.max() < 0.02  # measured 0.0195
    assert difference.mean() < 1e-3  # measured 5.4e-5
