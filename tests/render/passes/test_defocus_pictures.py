"""Pictures of what is out of focus, against the float64 reference and against samples through the lens."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.light import environment
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat import blur as blur_module
from pointsplat_addon.core.splat.ewa import CELL_SHARE
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.frame.lens_samples import LensSamples
from pointsplat_addon.render.passes.defocus import tile_lists
from pointsplat_addon.render.plan.request import Request, Result
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, drawing, meshes
from scripts.scenes.build import materials, mesh, moved, points, strand_lines
from scripts.scenes.cameras import camera
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.meshes import cube_mesh, plane_mesh
from scripts.scenes.store import STORE
from tests.reference import backdrop, defocus

COMBINED = frozenset({"combined"})
SPLAT, LENS = (
    Settings(technique="VISIBILITY", use_shadows=False),
    Settings(technique="IMAGE_SPACE", use_shadows=False, dof_method="LENS_SAMPLES"),
)
BLACK = World(np.zeros(3))


def asked(case: Case, aperture: Aperture | None, samples: int = 16, passes=COMBINED, **settings) -> Request:
    given = replace(case.settings, use_adaptive_sampling=False, **settings)
    return Request(replace(case.camera, aperture=aperture), given, passes, samples)


def drawn(case: Case, aperture: Aperture | None, samples: int = 16, passes=COMBINED, **settings) -> Result:
    return drawing.opengl().render(case.scene, asked(case, aperture, samples, passes, **settings))


def glowing(key: str, position, radius: float, color=(1.0, 1.0, 1.0)):
    """Disks that face the camera of `camera()` and glow."""
    position = np.atleast_2d(np.asarray(position, np.float32))
    rows = np.ones((len(position), 1), np.float32)
    return points(key, PointCloud(
        position, normal=rows * np.array([[0, -1, 0]], np.float32), radii=rows * np.float32(radius),
        color=np.zeros((len(position), 3), np.float32), emission=rows * np.array([color], np.float32),
    ))  # fmt: skip


def dark(*things, **more) -> Scene:
    return build.scene(*things, lights=(), world=BLACK, **more)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean()))


# The shader and its reference


def composited(at: np.ndarray, principal: np.ndarray, splats: defocus.Splats, slopes, perspective: bool) -> np.ndarray:
    """What pixels (N, 2) show, (N, 4); slopes (M, 4): those of light that passes are in the order of their planes in
    the middle of each tile."""
    if slopes is None:
        return defocus.composite(at + 0.5 - principal, splats)
    result, tile = np.empty((len(at), 4)), at // tile_lists.TILE
    planes = tile_lists.Planes(slopes.astype(np.float32), perspective)
    place, depth = splats.centre.astype(np.float32) + principal.astype(np.float32), splats.depth.astype(np.float32)
    for one in np.unique(tile, axis=0):
        mine = (tile == one).all(axis=1)
        # Of one plane, rounding decides: as there.
        x, y = ((one + 0.5) * tile_lists.TILE).astype(np.float32)[:, None] - place.T
        plane = planes.depth(np.arange(len(depth)), depth, x, y)
        order = np.argsort(np.where(splats.translucent, plane, depth), kind="stable")
        here = defocus.Splats(**{name: values[order] for name, values in vars(splats).items()})
        result[mine] = defocus.composite(at[mine] + 0.5 - principal, here)
    return result


@pytest.mark.parametrize(
    "name", ["sphere", "smoke", "tinted_smoke", "panes", "tinted_panes", "foliage", "strands", "parallel"]
)
def test_the_shader_is_the_reference(name):
    """Everything that the pass `light` left, composited in float64; without what is in focus."""
    case = CASES[name]()
    # Nothing is in focus.
    aperture = Aperture(0.1, 1.5) if case.camera.perspective else Aperture(0.5, 10.0)
    frame = Frame(drawing.opengl(), replace(case.scene, transparent=True), asked(case, aperture, 1))
    frame.sample()
    found = frame.pixels()["combined"].astype(float)
    assert frame.out_of_focus is not None
    lit = frame.out_of_focus.lit
    kept = {key: frame.device.read(texture).reshape(-1, 4)[: lit.count] for key, texture in lit.textures.items()}
    kept = {key: texels.astype(float) for key, texels in kept.items()}
    principal = np.array(frame.view.pixel_from_view()[2:], np.float32).astype(float)  # as the shader knows it
    corner = frame.frame_plan.corner
    frame.release()

    place, shape, source = kept["ps_centre"], kept["ps_shape"], kept["ps_source"]
    order = np.argsort(place[:, 2], kind="stable")
    order = order[place[order, 3] > 0]
    place, shape, source = place[order], shape[order], source[order]
    kind, k = (shape[:, 3] // 8).astype(int), shape[:, 3] % 8
    conic = np.stack([shape[:, 0], shape[:, 1], shape[:, 1], shape[:, 2]], axis=1).reshape(-1, 2, 2)
    covariance = np.linalg.inv(conic)
    peak = defocus.kernel(np.zeros(len(k)), k, np.linalg.det(covariance))
    splats = defocus.Splats(
        place[:, :2], place[:, 2], covariance, k, place[:, 3] / peak, source[:, :3], source[:, 3],
        back=kind % 2 == 1, translucent=kind // 2 % 2 == 1, disconnected=kind // 8 % 2 == 1,
    )  # fmt: skip
    height, width, _ = found.shape
    y, x = np.mgrid[:height, :width]
    at = np.stack([x.ravel(), y.ravel()], axis=1) + corner
    slopes = kept["ps_slope"][order] if "ps_slope" in kept else None
    channels = []
    for channel in range(3 if "ps_tint" in kept else 1):
        seen = splats
        if "ps_tint" in kept:
            tint = kept["ps_tint"][order, channel]
            seen = replace(splats, weight=np.where(splats.translucent, splats.weight * tint, splats.weight))
        channels.append(composited(at, principal, seen, slopes, case.camera.perspective).reshape(height, width, 4))
    red, green, blue = channels * (3 // len(channels))
    expected = np.stack([red[..., 0], green[..., 1], blue[..., 2], green[..., 3]], axis=-1)
    scale = max(float(source[:, :3].max()), 1.0)
    # The shader stops where less than a thousandth of the light from behind is left.
    error = np.abs(found - expected) / scale
    assert error.max() < 1e-3  # measured 3.8e-4
    assert np.sqrt((error**2).mean()) < 5e-5  # measured 1.4e-5
    assert found[..., 3].max() > 0.3


# Optics


@pytest.mark.parametrize(("focus", "radius"), [(2.0, 0.3), (3.0, 0.8), (8.0, 0.6), (5.0, 1.5)])
@pytest.mark.parametrize("parallel", [None, 4.0])
def test_a_splats_energy_is_kept_and_half_of_it_lies_within_its_share_of_the_disk(focus, radius, parallel):
    """Křivánek's radius of half the energy is that of Cycles' disk, C / sqrt 2."""
    seen = camera(resolution=(128, 128), parallel=parallel)
    aperture = Aperture(radius, focus)
    blur = blur_module.defocus_blur(replace(seen, aperture=aperture))
    assert blur is not None
    disk = float(blur.radius(np.array(4.0)))
    assert 8 < disk < 60
    pixel = seen.pixel_from_view()[0] / (4.0 if parallel is None else 1.0)
    energies, halves = [], []
    for place in np.random.default_rng(0).uniform(-0.5, 0.5, (4, 2)) / pixel:
        key = f"one glowing disk at {place}"
        case = Case(dark((glowing(key, [place[0], 0, place[1]], 0.02), moved())), seen, SPLAT)
        found = drawn(case, aperture).pixels["combined"][..., 0].astype(float)
        y, x = np.mgrid[:128, :128] + 0.5 - 64
        r = np.hypot(x - pixel * place[0], y - pixel * place[1])
        order = np.argsort(r, axis=None)
        energies.append(found.sum())
        halves.append(np.interp(found.sum() / 2, np.cumsum(found.ravel()[order]), r.ravel()[order]))
    # A disk alone covers the cell that it goes around.
    area = np.pi * (0.02 * pixel) ** 2 * CELL_SHARE
    assert np.abs(np.array(energies) / area - 1).max() < 0.01  # measured 0.0036
    assert np.abs(np.array(halves) / (disk / np.sqrt(2)) - 1).max() < 0.03  # measured 0.015


def chequered_board(primitive: str) -> Geometry:
    """A board of 16 x 16 squares across the view, of triangles, or of points in no order."""
    if primitive == "POLYGONS":
        squares = np.arange(512, dtype=np.uint16) // 2
        board = plane_mesh("board in focus", 1.0, 16)
        return mesh(replace(board, material=(squares + squares // 16) % 2, materials=(0, 1)), primitive)
    rng = np.random.default_rng(0)
    u = (np.arange(160) + rng.uniform(0.3, 0.7, (2, 160, 160))) / 80 - 1
    x, y = u[0].ravel(), u[1].transpose().ravel()
    count = len(x)
    position = np.stack([x, rng.normal(0, 1e-4, count), y], axis=1).astype(np.float32)
    light = (np.floor(8 * x) + np.floor(8 * y)) % 2
    return points("points in focus", PointCloud(
        position, normal=np.tile(np.array([0, -1, 0], np.float32), (count, 1)),
        radii=np.full((count, 1), 0.011, np.float32),
        color=np.repeat(0.1 + 0.8 * light[:, None], 3, axis=1).astype(np.float32),
    ))  # fmt: skip


@pytest.mark.parametrize("primitive", ["POLYGONS", "POINTS"])
def test_what_is_in_focus_is_as_sharp_as_without_a_lens(primitive):
    """A pattern in the plane of focus, alone and before what is blurred."""
    table = materials(2, base_color=[[0.9, 0.9, 0.9], [0.1, 0.1, 0.1]])
    board = chequered_board(primitive)
    case = Case(build.scene((board, moved()), table=table), camera(resolution=(96, 96)), SPLAT)
    # First with a lens: nodes that were built for it are used without one, too.
    seen, sharp = (drawn(case, aperture) for aperture in (Aperture(0.1, 4.0), None))
    assert {"name": "defocus", "because": "nothing is out of focus"} in seen.report["skipped"]
    assert np.abs(seen.pixels["combined"] - sharp.pixels["combined"]).max() <= 2 / 255  # measured 0
    far = glowing(f"far behind {primitive}", [[0.0, 3.0, 0.0]], 0.5)
    case = replace(case, scene=build.scene((board, moved()), (far, moved()), table=table))
    # In image space a wide disk behind asks for a pyramid of more levels.
    seen, sharp = (drawn(case, aperture, technique="EWA") for aperture in (Aperture(0.3, 4.0), None))
    inner = (slice(24, 72), slice(24, 72))
    error = np.abs(seen.pixels["combined"][inner] - sharp.pixels["combined"][inner]).max()
    assert error <= 2 / 255  # measured 1.8e-4


def squares(name: str, size: float, cells: int) -> Mesh:
    """A wall of light and dark squares."""
    row = np.arange(2 * cells * cells, dtype=np.uint16) // 2
    return replace(plane_mesh(name, size, cells), material=(row + row // cells) % 2, materials=(0, 1))


@pytest.mark.parametrize("primitive", ["POLYGONS", "POINTS"])
@pytest.mark.parametrize("near", [0, 1])
def test_nothing_leaks_through_what_is_sharp_and_sharp_things_do_not_leak(primitive, near):
    """A card in focus, light or dark, before a chequered wall that is not: three pixels within its outline and more the
    picture is that of many samples through the lens; all around it, where hidden parts of the wall show, nearly so."""
    table = materials(2, base_color=[[0.9, 0.9, 0.9], [0.02, 0.02, 0.02]], roughness=np.ones(2), specular=np.zeros(2))
    card = replace(plane_mesh(f"card {near} {primitive}", 0.6, 32), material=None, materials=(near,))
    wall = squares(f"wall behind {primitive}", 6.0, 32)
    scene = build.scene((mesh(card, primitive), moved()), (mesh(wall, primitive), moved((0, 4, 0))), table=table)
    case, aperture = Case(scene, camera(resolution=(96, 96)), SPLAT), Aperture(0.3, 4.0)
    pixels = case.camera.pixel_from_view()[0] / 4.0
    low, high = (int(np.ceil(48 - 0.6 * pixels)) + 3, int(48 + 0.6 * pixels) - 3)
    inner = (slice(low, high), slice(low, high))
    splat = drawn(case, aperture).pixels["combined"]
    lens = drawn(case, aperture, 256, dof_method="LENS_SAMPLES").pixels["combined"]
    error = np.abs(splat - lens).max(axis=-1)
    assert error[inner].max() <= 2 / 255  # measured 1.2e-4
    error[low - 6 : high + 6, low - 6 : high + 6] = 0
    assert error.max() < 0.08  # measured 0.058
    assert np.ptp(splat[: low - 6, ..., 0]) > 0.1  # the wall is seen, and blurred


@pytest.mark.parametrize("primitive", ["POLYGONS", "POINTS"])
def test_what_is_blurred_before_something_sharp_lets_it_through_at_its_rim_alone(primitive):
    """A dark card before a chequered wall in focus: where no disk of confusion reaches, the wall is as sharp as always;
    three pixels within what the whole lens sees covered, nothing of it shows. Truth: polygons through the lens. Points
    are finer than a pixel, so that they show where the chequers' colours change."""
    table = materials(2, base_color=[[0.9, 0.9, 0.9], [0.02, 0.02, 0.02]], roughness=np.ones(2), specular=np.zeros(2))
    card = replace(plane_mesh(f"near card {primitive}", 0.5, 32), material=None, materials=(1,))
    wall = squares(f"sharp wall {primitive}", 2.0, 16)
    scene, exact = (
        build.scene((mesh(card, kind), moved((0, -1.5, 0))), (mesh(wall, kind), moved()), table=table)
        for kind in (primitive, "POLYGONS")
    )
    case, aperture = Case(scene, camera(resolution=(96, 96)), replace(SPLAT, tolerance=0.5)), Aperture(0.3, 4.0)
    focal = case.camera.pixel_from_view()[0]
    disk = focal * 0.3 * (1 / 2.5 - 1 / 4)
    splat = drawn(case, aperture).pixels["combined"]
    lens = drawn(replace(case, scene=exact), aperture, 256, dof_method="LENS_SAMPLES").pixels["combined"]
    error = np.abs(splat - lens).max(axis=-1)
    half = 0.5 * focal / 2.5
    inner = slice(int(np.ceil(48 - half + disk)) + 3, int(48 + half - disk) - 3)
    assert error[inner, inner].max() <= 2 / 255  # measured 6e-8
    outer = np.ones(error.shape, bool)
    around = slice(int(48 - half - disk) - 3, int(np.ceil(48 + half + disk)) + 3)
    outer[around, around] = False
    sharp = drawn(case, None).pixels["combined"]
    assert np.abs(splat - sharp).max(axis=-1)[outer].max() <= 2 / 255  # measured 0
    # Measured: 0.032 and 0.102; at a tolerance of one pixel points have 0.165, along the chequers.
    assert error.max() < {"POLYGONS": 0.04, "POINTS": 0.15}[primitive]


# Against samples through the lens


@pytest.mark.parametrize("name", [
    "cube", "sphere", "mixed", "textured", "instances", "balls", "environment", "lights", "parallel", "culled", "smoke",
    "panes", "foliage", pytest.param("split_mesh", marks=pytest.mark.long), "strands",
])  # fmt: skip
def test_pictures_are_nearer_to_many_samples_through_the_lens_than_four_are(name):
    case = CASES[name]()
    size = case.camera.resolution
    if size == cameras.RESOLUTION:
        case = replace(case, camera=replace(case.camera, resolution=(2 * size[0], 2 * size[1])))
    aperture = Aperture(0.5, 2.5)
    splat, few, many, sharp = (
        drawn(case, aperture, 16).pixels["combined"],
        drawn(case, aperture, 4, dof_method="LENS_SAMPLES").pixels["combined"],
        drawn(case, aperture, 256, dof_method="LENS_SAMPLES").pixels["combined"],
        drawn(case, None, 16).pixels["combined"],
    )  # fmt: skip

    def error(picture: np.ndarray) -> float:
        return float(np.sqrt(((picture - many)[..., :3] ** 2).mean()))

    assert error(splat) < error(few)  # measured 0.92 of it for balls, 0.86 mixed, 0.18 to 0.6 all else
    assert error(splat) < 0.6 * error(sharp)  # measured 0.55 for balls, 0.48 mixed, 0.11 to 0.38 all else
    np.testing.assert_allclose(
        splat.mean(axis=(0, 1)), many.mean(axis=(0, 1)), rtol=0.1
    )  # measured 0.086: balls, which end alike


@pytest.mark.parametrize("primitive", ["POLYGONS", "POINTS"])
def test_a_coarse_cut_has_no_holes(primitive):
    """A floor of one colour before a dark world, blurred by a pixel or two, as viewports show it while they move."""
    flat = moved()
    flat[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    floor = mesh(plane_mesh(f"floor without holes {primitive}", 30.0, 64), primitive)
    seen = camera((0, -4, 1.5), (0, 0, 0.4), (96, 64))
    case = Case(build.scene((floor, flat), world=BLACK), seen, SPLAT)
    # The lower rows are blurred by 1 to 3 pixels.
    coarse, fine = (drawn(case, Aperture(0.1, 8.0), 1, tolerance=t).pixels["combined"][:24, :, 0] for t in (16.0, 1.0))
    assert np.abs(coarse / fine - 1).max() < 0.01  # measured 4.2e-4; 0.8 of splats as wide as 16 pixels


# What a scene does not need


@pytest.mark.parametrize("name", ["mixed", "smoke", "strands"])
def test_without_depth_of_field_nothing_of_it_is_compiled_or_computed(name):
    def recorded(aperture: Aperture | None) -> NullDevice:
        device = NullDevice()
        case = CASES[name]()
        request = Request(replace(case.camera, aperture=aperture), case.settings, COMBINED, 4)
        Renderer(device, STORE).render(case.scene, request)
        return device

    plain, narrow, wide = (recorded(a) for a in (None, Aperture(0.0, 4.0), Aperture(0.3, 2.0)))
    assert plain.names == narrow.names
    assert plain.interfaces == narrow.interfaces
    assert plain.uploaded_bytes == narrow.uploaded_bytes
    defines = {name for interface in plain.interfaces for name, _ in interface.defines}
    assert not defines & {"PS_DEFOCUS", "PS_FOCUS"}
    assert "defocus" in wide.names
    assert "defocus" not in plain.names


def test_lens_samples_take_no_pass_of_splats(monkeypatch):
    seen = drawn(CASES["mixed"](), Aperture(0.3, 2.0), 4, dof_method="LENS_SAMPLES")
    assert "defocus" in {entry["name"] for entry in seen.report["skipped"]}
    assert LensSamples is not None


# All else


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "VISIBILITY"])
@pytest.mark.parametrize("passes", [ALL_PASSES, frozenset({"combined", "depth"})])
@pytest.mark.parametrize("name", ["mixed", "smoke", "strands", "holdout", "moving", "panes"])
def test_other_passes_are_those_of_a_camera_without_a_lens(name, passes, technique):
    case = CASES[name]()
    blurred, sharp = (drawn(case, a, 5, passes, technique=technique).pixels for a in (Aperture(0.3, 2.0), None))
    assert blurred.keys() == sharp.keys()
    for key in sharp:
        if key != "combined":
            np.testing.assert_array_equal(blurred[key], sharp[key])


@pytest.mark.parametrize("name", ["mixed", "smoke", "split_mesh"])
def test_a_border_shows_the_pixels_of_the_whole_picture(name):
    case = CASES[name]()
    width, height = case.camera.resolution
    region = (width // 4, height // 3, width // 2, height // 2)
    whole = drawn(case, Aperture(0.3, 2.0)).pixels["combined"]
    part = drawn(replace(case, camera=replace(case.camera, region=region)), Aperture(0.3, 2.0)).pixels["combined"]
    x, y, w, h = region
    assert np.abs(part - whole[y : y + h, x : x + w]).max() < 0.005  # measured 0.0005


@pytest.mark.parametrize("aperture", [
    Aperture(0.15, 1e-9), Aperture(0.15, 1e30), Aperture(1e6, 4.0), Aperture(1e-9, 4.0),
    Aperture(0.3, 4.0, 5, 1.0, 1e-3), Aperture(30.0, 0.05),
])  # fmt: skip
@pytest.mark.parametrize("name", ["mixed", "parallel", "smoke", "not_finite", "inside", "strands", "holdout"])
def test_extreme_lenses_have_finite_pictures(name, aperture):
    pixels = drawn(CASES[name](), aperture, 4).pixels["combined"]
    assert np.isfinite(pixels).all()
    assert pixels[..., 3].max() <= 1 + 1e-5


def test_alpha_is_one_where_a_world_is_behind_and_never_more():
    for name in ("mixed", "smoke", "panes", "strands"):
        case = CASES[name]()
        alpha = drawn(case, Aperture(0.3, 2.0), 4).pixels["combined"][..., 3]
        np.testing.assert_allclose(alpha, 1, atol=1e-5)


def test_a_picture_that_is_shown_between_samples_ends_as_the_finished_one():
    case = CASES["mixed"]()
    request = Request(replace(case.camera, aperture=Aperture(0.3, 2.0)), case.settings, COMBINED, 8, interactive=True)
    renderer = drawing.opengl()
    frame = renderer.start(case.scene, request)
    try:
        while frame.sample():
            pass
        shown = frame.pixels()["combined"]
    finally:
        frame.release()
    whole = renderer.render(case.scene, request).pixels["combined"]
    np.testing.assert_allclose(shown, whole, atol=1e-6)


@pytest.mark.parametrize("radius", [0.15, 0.3, 1.2])
def test_a_ball_of_few_points_that_is_partly_in_focus_keeps_its_outline(radius):
    """In image space points are seen together with those around them. Through a wide lens the outline is that of the
    ball itself, from which samples of so few points, larger by their radii, differ by 0.064."""
    points_of, of_mesh = (
        points("few points, partly in focus", clouds.sphere_cloud()),
        mesh(meshes.sphere_mesh("ball of those points", 96), "POLYGONS"),
    )
    table = materials(base_color=[[0.0, 0.0, 0.0]], specular=[0.0])
    splat, lens = (
        drawn(
            Case(
                build.scene((of, moved((0, 0, 0), 0.7)), table=table, lights=(), world=World(np.ones(3))),
                camera((0, -4, 0.6), (0, 0, 0.3), (96, 64)), replace(SPLAT, technique="IMAGE_SPACE"),
            ), Aperture(radius, 4.0), samples, dof_method=method,
        ).pixels["combined"][..., 0]
        for of, samples, method in (
            (points_of, 16, "SPLAT"), (of_mesh if radius > 1 else points_of, 64, "LENS_SAMPLES"),
        )
    )  # fmt: skip
    # Measured 0.061 and 0.025; 0.59 and 0.081 where only what is in focus was.
    assert np.abs(splat - lens)[lens > 0.99].max() < 0.2
    assert rms(splat - lens) < 0.04


TURN = np.linspace(0, 2.5, 10)
BEND = 0.8 * np.stack([np.cos(TURN), 0.3 * np.sin(TURN), np.sin(TURN) - 0.5], axis=1)
# With their sizes, and by how much at most their areas may differ; measured at most 0.0050, 0.0014, 0.0041 and 0.017.
SILHOUETTES = {
    "cube": (mesh(cube_mesh("dark cube", 0.5), "POLYGONS"), 1.0, 0.01),
    "ball": (mesh(meshes.sphere_mesh("dark ball", 48), "POLYGONS"), 0.7, 0.005),
    "card": (mesh(plane_mesh("dark card", 0.6, 4), "POLYGONS"), 1.0, 0.01),
    "bent tube": (strand_lines("dark tube", [BEND], 0.08), 1.0, 0.025),
}


@pytest.mark.parametrize("aperture", [Aperture(0.25, 7.0), Aperture(0.25, 2.6)])
@pytest.mark.parametrize("name", SILHOUETTES)
def test_silhouettes_out_of_focus_are_those_of_lens_samples(name, aperture):
    """Dark bodies before a white world: how much of the picture they cover, the difference, and what leaks through."""
    of, size, area = SILHOUETTES[name]
    table = materials(base_color=[[0.0, 0.0, 0.0]], specular=[0.0], roughness=[1.0])
    scene = build.scene((of, moved((0, 0, 0), size)), table=table, lights=(), world=World(np.ones(3)))
    case = Case(scene, camera((1.2, -3.6, 1.1), (0, 0, 0), (160, 120)), SPLAT)
    splat, lens = (
        1 - drawn(case, aperture, samples, dof_method=method).pixels["combined"][..., 0].astype(float)
        for samples, method in ((16, "SPLAT"), (192, "LENS_SAMPLES"))
    )
    assert abs(splat.sum() / lens.sum() - 1) < area
    assert rms(splat - lens) < 0.01  # measured 0.0048 to 0.0086
    assert (lens - splat)[lens > 0.999].max(initial=0.0) < 0.03  # measured 0.019, along edges of the cube and the ball


@pytest.mark.parametrize("focus", [2.0, 6.5])
@pytest.mark.parametrize("far", [(-0.1, 2.0, 0.0), (0.9, 1.2, 0.5), (-0.3, 1.5, 1.0)])
def test_ends_of_wide_tubes_are_closed_where_they_are_out_of_focus(far, focus):
    axis = np.linspace((-0.5, -1.2, -0.3), far, 3)
    tube = strand_lines(f"closed tube to {far}", [axis], 0.45)
    case = Case(build.scene((tube, moved())), camera(resolution=(96, 72)), SPLAT)
    splat, lens = (
        drawn(case, Aperture(0.25, focus), n, dof_method=m).pixels["combined"]
        for n, m in ((16, "SPLAT"), (96, "LENS_SAMPLES"))
    )
    assert rms(splat - lens) < 0.03  # measured 0.020, and 0.106 to 0.19 without ends


# Panes


def panes_at_a_slant(aperture: Aperture, gap: float) -> tuple[Frame, np.ndarray]:
    """The frame and the picture of two panes that glow, the nearer one red with an alpha of 0.4, the other one green
    with 0.5, turned by 55 degrees, before nothing."""
    table = materials(
        2, base_color=np.zeros((2, 3)), emission=[[1.0, 0, 0], [0, 1.0, 0]], alpha=[0.4, 0.5],
        translucent=np.array([True, True]),
    )  # fmt: skip
    sine, cosine = np.sin(np.radians(55)), np.cos(np.radians(55))
    turned = np.eye(4)
    turned[:3, :3] = [[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]
    behind = turned.copy()
    behind[:3, 3] = gap * turned[:3, 1]
    near, far = (replace(plane_mesh(f"pane {row} of two", 5.0), materials=(row,)) for row in (0, 1))
    scene = build.scene(
        (mesh(near), turned), (mesh(far), behind), table=table, lights=(), world=BLACK, transparent=True
    )
    case = Case(scene, camera(), SPLAT)
    frame = Frame(drawing.opengl(), scene, asked(case, aperture, 1))
    while frame.sample():
        pass
    return frame, frame.pixels()["combined"].astype(float)


@pytest.mark.parametrize("gap", [0.003, 0.03, 0.3])
@pytest.mark.parametrize("aperture", [Aperture(0.05, 2.5), Aperture(0.2, 2.5), Aperture(0.2, 8.0), Aperture(0.1, 4.0)])
def test_panes_out_of_focus_are_in_their_order_however_close_they_lie(aperture, gap):
    """Splats of the nearer one have their middles behind those of the other one a little beside them."""
    frame, found = panes_at_a_slant(aperture, gap)
    frame.release()
    error = np.abs(found - [0.4, 0.6 * 0.5, 0, 1 - 0.6 * 0.5])[:, 12:-12]
    assert error.max() < 0.01  # measured 0.0082; 0.09 where the two mix
    assert rms(error) < 0.003  # measured 0.0026


def test_panes_far_out_of_focus_take_few_splats():
    """As opaque triangles do, and not one for each pixel."""
    blurred, _ = panes_at_a_slant(Aperture(0.3, 1.5), 0.3)
    sharper, _ = panes_at_a_slant(Aperture(0.02, 3.0), 0.3)
    few, many = (frame.frame_plan.splats for frame in (blurred, sharper))
    for frame in (blurred, sharper):
        frame.release()
    assert 0 < few < 0.05 * many  # measured 0.033


def test_dense_translucent_meshes_far_out_of_focus_take_few_splats():
    """Whose triangles are smaller than samples a pixel apart: nodes stand for these."""
    table = materials(1, alpha=[0.4], translucent=np.array([True]))
    scene = build.scene((mesh(meshes.sphere_mesh("dense glass", 120)), moved()), table=table, lights=(), world=BLACK)
    counts = []
    for aperture in (Aperture(0.4, 1.2), Aperture(0.02, 3.0)):
        frame = Frame(drawing.opengl(), scene, asked(Case(scene, camera(), SPLAT), aperture, 1))
        counts.append(frame.frame_plan.splats)
        frame.release()
    assert 0 < counts[0] < 0.01 * counts[1]  # measured 134 and 29,040


# The world


def hills() -> World:
    """A sky above hills, and lamps of a texel each."""
    direction = environment.texel_directions(256, 128)
    x, y, z = np.moveaxis(direction, -1, 0)
    azimuth = np.arctan2(y, x)
    image = np.where(z[..., None] > 0, [0.3, 0.5, 0.9] - 0.4 * z[..., None], np.array([0.35, 0.28, 0.2]))
    image[(z < 0.12 + 0.08 * np.sin(7 * azimuth)) & (z > -0.02)] = 0.08, 0.16, 0.06
    image[76:84:3, 58:76:6] = 8, 5, 3
    return World(np.zeros(3), image.astype(np.float32))


def before_the_world(parallel: float | None = None) -> Case:
    """A card in focus before it."""
    table = materials(2, base_color=[[0.9, 0.9, 0.9], [0.1, 0.1, 0.1]])
    board = replace(chequered_board("POLYGONS"), key="board before the world")
    scene = build.scene((board, moved((0, 0, 0), 0.4)), table=table, world=hills())
    # The visibility buffer's window is wider, and so the world's texels lie elsewhere.
    settings = replace(SPLAT, technique="IMAGE_SPACE")
    return Case(scene, camera(resolution=(96, 64), parallel=parallel), settings)


@pytest.mark.parametrize("ratio", [1.0, 0.5])
@pytest.mark.parametrize("radius", [0.02, 0.1, 0.4, 2.0])
def test_a_picture_of_the_world_is_blurred_as_through_the_lens(radius, ratio):
    """By circles of confusion of half a pixel to more than half the picture; what is before it stays as it is."""
    case, aperture = before_the_world(), Aperture(radius, 4.0, ratio=ratio)
    splat = drawn(case, aperture)
    assert "backdrop" in {entry["name"] for entry in splat.report["passes"]}
    lens = drawn(case, aperture, 256, dof_method="LENS_SAMPLES").pixels["combined"]
    sharp = drawn(case, None, 64).pixels["combined"]
    beside = np.ones(lens.shape[:2], bool)
    beside[17:47, 33:63] = False  # of the card, whose squares 16 samples do not filter as 256 do
    error, before = (picture[beside] - lens[beside] for picture in (splat.pixels["combined"], sharp))
    # Measured 0.77 of it with a disk of 0.7 pixels, whose sharp picture is as near, 0.06 with 66 pixels: 256 places on
    # the lens draw each lamp 256 times.
    assert rms(error) < (0.9 if radius < 0.1 else 0.1) * rms(before)
    assert rms(error) < 0.012  # measured 0.0086
    assert np.abs(error.mean(axis=0)).max() < 0.003  # measured 0.0021


def test_what_is_out_of_focus_lets_a_blurred_world_through():
    case, aperture = before_the_world(), Aperture(0.4, 2.0)
    splat, lens = (drawn(case, aperture, n, dof_method=m).pixels["combined"]
                   for n, m in ((16, "SPLAT"), (256, "LENS_SAMPLES")))  # fmt: skip
    assert rms(splat - lens) < 0.02  # measured 0.0147
    assert rms(drawn(case, None).pixels["combined"] - lens) > 0.1  # measured 0.137


@pytest.mark.parametrize("aperture", [Aperture(0.02, 4.0), Aperture(0.4, 4.0), Aperture(0.4, 4.0, ratio=0.5)])
def test_the_blurred_world_is_the_references(aperture):
    case = before_the_world()
    frame = Frame(drawing.opengl(), case.scene, asked(case, aperture, 1))
    frame.sample()
    assert frame.backdrop is not None
    found, grid = frame.device.read(frame.backdrop.texture)[..., :3], frame.backdrop.grid
    frame.release()
    image, turn = case.scene.world.image, case.scene.world.world_rotation
    assert image is not None
    picture = backdrop.sharp_backdrop(environment.build_atlas(image), grid, frame.view, turn)
    error = np.abs(found - backdrop.blur_backdrop(picture, grid))
    assert error.max() < 0.003 * picture.max()  # measured 0.0012
    assert found.std() > 0.02


def test_a_world_that_is_not_blurred_takes_no_pass_for_it():
    case = before_the_world()
    lens = Aperture(0.3, 4.0)
    for what, aperture, more, because in (
        (case, None, {}, "the camera has no depth of field"),
        (case, Aperture(1e-4, 4.0), {}, "the world is in focus"),
        (case, lens, {"dof_method": "LENS_SAMPLES"}, "each sample sees it through a point on the lens"),
        (before_the_world(parallel=3.0), lens, {}, "parallel rays see one direction of the world"),
        (replace(case, scene=replace(case.scene, transparent=True)), lens, {}, "the film is transparent"),
        (replace(case, scene=replace(case.scene, world=World(np.ones(3)))), lens, {}, "the world is of one colour"),
    ):
        device = NullDevice()
        request = Request(replace(what.camera, aperture=aperture), replace(what.settings, **more), COMBINED, 2)
        report = Renderer(device, STORE).render(what.scene, request).report
        assert {"name": "backdrop", "because": because} in report["skipped"]
        assert not {name for name in device.names if "backdrop" in name}


@pytest.mark.parametrize("most", [1 << 24, 300])
def test_tiles_list_the_splats_whose_kernels_reach_their_pixels(most, monkeypatch):
    """From the front; tiles are larger where there would be too many entries. Against each pixel's own sum."""
    monkeypatch.setattr(tile_lists, "MOST_ENTRIES", most)
    rng = np.random.default_rng(1)
    count, size, k = 60, (37, 22), 1.0
    wide = rng.uniform(0.3, 30, (count, 2))
    turn = rng.uniform(0, np.pi, count)
    axes = np.stack([np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)], axis=1).reshape(-1, 2, 2)
    conic = np.einsum("nji,nj,njk->nik", axes, 1 / wide, axes)
    place = np.concatenate(
        [rng.uniform(-25, 25, (count, 2)), rng.uniform(1, 9, (count, 1)), np.ones((count, 1))], axis=1
    )
    place[:3, 3], place[3, 0] = 0.0, np.nan
    shape = np.stack([conic[:, 0, 0], conic[:, 0, 1], conic[:, 1, 1], np.full(count, k + 8)], axis=1)
    middle = np.array([18.0, 11.0])
    focal = np.array([1.0, 1.0, *middle])
    lists = tile_lists.tile_lists(place.astype(np.float32), shape.astype(np.float32), focal, size)
    y, x = np.mgrid[: size[1], : size[0]] + 0.5
    offset = np.stack([x, y], axis=-1)[:, :, None] - middle - place[:, :2]
    with np.errstate(invalid="ignore"):
        reached = np.einsum("hwni,nij,hwnj->hwn", offset, conic, offset) < 2 * (k + 2)
    reached &= place[:, 3] > 0
    assert lists.tile == (4 if most > 1 << 20 else 8)
    assert len(lists.entries) <= most
    for row, column in np.ndindex(lists.tiles.shape[:2]):
        first, number = lists.tiles[row, column]
        entries = lists.entries[first : first + number]
        pixels = np.s_[row * lists.tile : (row + 1) * lists.tile, column * lists.tile : (column + 1) * lists.tile]
        assert set(np.flatnonzero(reached[pixels].any(axis=(0, 1)))) <= set(entries)
        assert (np.diff(place[entries, 2]) >= 0).all()
        assert not set(entries) & {0, 1, 2, 3}
