"""Pictures of strands against the exact outlines of balls that move along their segments, in float64."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.scene.valid.geometry import valid_strands
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.strand.preparation import with_levels
from pointsplat_addon.core.strand.segments import sample_offsets
from scripts.scenes import build, cameras, clouds, meshes, solid_cases
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

pytest.importorskip("moderngl")
COMBINED = frozenset({"combined"})
PLAIN = Settings(technique="IMAGE_SPACE", use_shadows=False)
PARTS = 400  # places along a segment that the reference looks at


def covered(lines: Strands, camera) -> np.ndarray:
    """(H, W) bool: pixels whose centre's ray meets a ball somewhere along a segment, before the eye and between the
    planes in which the strand ends."""
    fx, fy, cx, cy = camera.pixel_from_view()
    width, height = camera.resolution
    x, y = np.meshgrid((np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy)
    view = lines.position.astype(float) @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
    found = np.zeros((height, width), bool)
    ray = np.stack([x, y, -np.ones_like(x)], -1) if camera.perspective else np.broadcast_to([0.0, 0, -1], (*x.shape, 3))
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    t = np.linspace(0, 1, PARTS)
    foot = np.zeros(3) if camera.perspective else np.stack([x, y, np.zeros_like(x)], -1)
    for a, b in zip(lines.start[:-1], lines.start[1:], strict=True):
        least, most = np.full((height, width), -np.inf), np.full((height, width), np.inf)
        for end, other in ((view[a], view[a + 1]), (view[b - 1], view[b - 2])):
            through, at = ray @ (other - end), (end - foot) @ (other - end)
            with np.errstate(divide="ignore"):
                least, most = (
                    np.where(through > 0, np.maximum(least, at / through), least),
                    np.where(through < 0, np.minimum(most, at / through), most),
                )
        for i in range(a, b - 1):
            radius = lines.radius[i] * (1 - t) + lines.radius[i + 1] * t
            for place, r in zip(view[i] * (1 - t[:, None]) + view[i + 1] * t[:, None], radius, strict=True):
                to = place - foot
                along = (ray * to).sum(-1)
                outside = (to * to).sum(-1) - along**2 - r * r
                half = np.sqrt(np.maximum(-outside, 0))
                end = np.minimum(along + half, most)
                depth = -(ray[..., 2] * end)
                found |= (outside < 0) & (end > np.maximum(along - half, least)) & (depth > camera.near)
    return found


def made(key: str, points: list, radius, **more) -> Strands:
    position = np.concatenate(points).astype(np.float32)
    start = np.concatenate([[0], np.cumsum([len(p) for p in points])])
    return Strands(
        key, key, position, start, np.broadcast_to(np.asarray(radius, np.float32), len(position)).copy(), **more
    )


def geometry(lines: Strands) -> Geometry:
    return Geometry(lines.key, lines.name, strands=lines, primitive="LINES")


def case(lines: Strands, camera, settings: Settings = PLAIN, **more) -> Case:
    return Case(build.scene((geometry(lines), build.moved()), transparent=True, **more), camera, settings)


def alpha(of: Case, samples: int = 1) -> np.ndarray:
    return render(of, COMBINED, samples).pixels["combined"][..., 3]


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def bow(points: int = 5) -> np.ndarray:
    u = np.linspace(-1, 1, points)
    return np.stack([1.1 * u, np.cos(3 * u), 0.7 * np.sin(2 * u)], axis=1)


EYES = {
    "before": cameras.camera((0, -5, 0)),
    "obliquely": cameras.camera((4, -1.5, 1.5)),
    "wide": cameras.camera((0.3, -2.2, 0.4), field_of_view=100),
    "parallel": cameras.camera((1, -5, 1), parallel=3.5),
}


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("taper", [1.0, 0.2])
def test_tubes_cover_exactly_the_pixels_of_their_balls(eye, taper):
    radius = np.geomspace(0.25, 0.25 * taper, 5)
    lines = made(f"bow {taper}", [bow()], radius)
    camera = replace(EYES[eye], resolution=(96, 80))
    got, want = alpha(case(lines, camera)) > 0.5, covered(lines, camera)
    assert want.sum() > 300
    assert iou(got, want) > 0.999  # measured 1 in all


def test_a_tube_that_the_near_plane_cuts_shows_its_inside_and_covers_the_same():
    lines = made("cut", [np.array([[0.05, 3.0, -0.3], [0.0, -6.0, 0.1]])], [0.2, 0.4])
    camera = cameras.camera((0, -4, 0), resolution=(96, 80), near=0.3)
    got, want = alpha(case(lines, camera)) > 0.5, covered(lines, camera)
    assert want.sum() > 2000
    assert iou(got, want) > 0.999  # measured 1


def test_the_eye_within_a_tube_sees_nothing_else():
    lines = made("around", [np.array([[0, -8.0, 0], [0, 3.0, 0]])], 1.0)
    assert alpha(case(lines, cameras.camera((0, -4, 0)))).min() == 1.0


def test_a_huge_radius_fills_the_picture():
    lines = made("huge", [np.array([[-1e4, 1e4, 0], [1e4, 1e4, 0]])], 9.9e3)
    camera = cameras.camera((0, -4, 0), far=1e6)
    assert alpha(case(lines, camera)).min() == 1.0


def test_tubes_are_round():
    lines = made("straight", [np.array([[0.0, 0, -3], [0, 0, 3]])], 0.5)
    camera = cameras.camera((0, -4, 0), parallel=1.5)
    pixels = render(case(lines, camera), frozenset({"normal", "depth"})).pixels
    x = (np.arange(48) + 0.5 - 24) / 32
    on = np.abs(x) < 0.49
    want = np.stack([x / 0.5, -np.sqrt(np.maximum(1 - (x / 0.5) ** 2, 0)), 0 * x], axis=1)[on]
    # Half floats of up to 1: measured 2.3e-4.
    assert np.abs(pixels["normal"][20][on] - want).max() < 1e-3
    # Float32 at a depth of 4: measured 1.3e-7.
    assert np.abs(pixels["depth"][20][on][:, 0] - (4 - 0.5 * -want[:, 1])).max() < 1e-5


def ribbon(key: str, count: int = 200) -> Strands:
    u = np.linspace(-1, 1, count)
    normal = np.stack([0 * u, -np.cos(2.5 * u), np.sin(2.5 * u)], axis=1).astype(np.float32)
    return made(key, [np.stack([u, 0 * u, 0 * u], axis=1)], 0.3, normal=normal)


def test_a_twisted_ribbon_is_as_high_as_its_turn_leaves_of_its_width():
    camera = cameras.camera((0, -5, 0), parallel=2.4, resolution=(240, 120))
    got = alpha(case(ribbon("twisted"), camera), 16)
    column = np.abs((np.arange(240) + 0.5 - 120) / 100) < 0.98
    want = 60 * np.abs(np.cos(2.5 * (np.arange(240) + 0.5 - 120) / 100))
    # Outlines may be a quarter of a pixel off on either side; measured 0.58 of up to 60.
    assert np.abs(got.sum(axis=0) - want)[column].max() < 0.7
    hard = got > 0.5
    rows = np.abs(np.arange(120) + 0.5 - 60)[:, None] < 0.5 * want
    assert iou(hard[:, column], rows[:, column]) > 0.98  # measured 0.994


def test_a_ribbon_has_two_sides():
    """Turned about, its normals are still towards the eye, and it is lit the same."""
    flat = ribbon("flat")
    toward = replace(flat, key="toward", normal=np.tile(np.array([0, -1, 0], np.float32), (200, 1)))
    away = replace(toward, key="away", normal=np.tile(np.array([0, 1, 0], np.float32), (200, 1)))
    pictures = [render(case(x, cameras.camera()), frozenset({"combined", "normal"})).pixels for x in (toward, away)]
    for key in ("combined", "normal"):
        assert np.array_equal(pictures[0][key], pictures[1][key])
    assert pictures[0]["combined"][20, 24, 3] == 1


PIXEL = 2 / 128  # of the view below


def field(key: str, width: float, angle: float, rough: float = 0.0) -> Strands:
    """288 strands of 8 places, `width` pixels wide, that lie beside and behind one another without an overlap."""
    rng = np.random.default_rng(7)
    d, e = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
    points = []
    for row in range(36):
        for column in range(8):
            middle = (row - 17.5) * 1.5 * PIXEL * e + (column - 3.5) * 7 * PIXEL * d
            shift = rough * PIXEL * rng.normal(size=(8, 1)) * e
            points.append(middle + np.linspace(-3, 3, 8)[:, None] * PIXEL * d + shift)
    return made(key, points, 0.5 * width * PIXEL)


@pytest.mark.parametrize("samples", [16, 256])
@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 1.2])
def test_strands_thinner_than_a_pixel_cover_what_they_are_wide(angle, samples):
    camera = cameras.camera((0, -4, 0), parallel=2.0, resolution=(128, 128))
    got = alpha(case(field(f"thin {angle}", 0.1, angle), camera), samples).sum()
    want = 288 * 6 * 0.1
    assert abs(got / want - 1) < 0.03  # measured 0.0083 with 16 samples, 0.0013 with 256


def test_what_is_left_out_of_distant_strands_is_held_by_the_rest():
    """Strands that curl below a pixel cover their own length, not that of what they are simplified to."""
    turn = np.linspace(0, 12 * np.pi, 97)
    curl = np.stack([0.3 * PIXEL * np.cos(turn), 0 * turn, 0.4 * turn * PIXEL], axis=1)
    points = [curl + PIXEL * np.array([3.0 * i, 0, 16.0 * j]) for i in range(-18, 18) for j in range(-3, 3)]
    lines = made("curls", points, 0.03 * PIXEL)
    camera = cameras.camera((0, -4, 0), parallel=2.0, resolution=(128, 128))
    result = render(case(lines, camera), COMBINED, 64)
    length = np.linalg.norm(np.diff(curl[:, ::2], axis=0), axis=1).sum() / PIXEL
    assert result.report["lines"]["segments"] < 97 * len(points) / 3
    got = result.pixels["combined"][..., 3].sum()
    assert abs(got / (len(points) * length * 0.06) - 1) < 0.02  # measured 0.0010


@pytest.mark.parametrize("pixels", [0.5, 0.75, 0.95])
def test_closed_tips_keep_their_area_where_points_are_left_out(pixels):
    """The last of eight segments narrows to nothing; from here every second point or more is left out."""
    camera = cameras.camera((0, -5, 0), parallel=4, resolution=(96, 96))
    u, radius = np.linspace(-0.4, 0.4, 9), np.full(9, pixels / 2 * 4 / 96)
    radius[-1] = 0
    turn = np.linspace(0, 2 * np.pi, 20, endpoint=False) + 0.1
    points = [
        np.stack([u * np.cos(a) + 1.5 * np.cos(5 * a) * 0.9, 0 * u, u * np.sin(a) + 1.4 * np.sin(a)], axis=1)
        for a in turn
    ]
    lines = made(f"tips {pixels}", points, np.tile(radius, 20))
    result = render(case(lines, camera), COMBINED, 256)
    assert result.report["lines"]["segments"] <= 20 * 4
    exact = 20 * pixels * (0.8 * 96 / 4) * (1 - 1 / 16)
    found = result.pixels["combined"][..., 3].sum() / exact - 1
    assert abs(found) < 0.03  # measured 0.0154, and 0.08 where strips of a pixel had the width of their ends


def test_a_tapering_strand_covers_less_and_less():
    lines = made("taper", [np.array([[-1 + PIXEL, 0, z], [1 - PIXEL, 0, z]]) for z in np.arange(-40, 40) * 1.5 * PIXEL],
                 np.tile([0.4 * PIXEL, 0], 80))  # fmt: skip
    camera = cameras.camera((0, -4, 0), parallel=2.0, resolution=(128, 128))
    got = alpha(case(lines, camera), 64).sum(axis=0) / 80
    want = 0.8 * (1 - (np.arange(128) - 0.5) / 126)
    assert np.abs(got - want)[3:-3].max() < 0.005  # measured 0.0019


def test_turns_spread_every_strand_over_the_samples():
    for count in (1, 5, 16, 24):
        turn = sample_offsets(count)
        assert sorted(turn) == [k / count for k in range(count)]
        phase = np.random.default_rng(0).random(500)
        for share in (0.03, 0.3, 0.77):
            times = (((phase[:, None] + turn) % 1) < share).sum(axis=1)
            assert set(times) <= {int(share * count), int(share * count) + 1}
    # The first half of 16 has half of each.
    assert set((sample_offsets(16)[:8] * 16).astype(int) // 2) == set(range(8))


def test_what_is_no_strand_is_left_out_and_the_rest_is_drawn():
    good = bow()
    bad = good + np.array([0, 0, 0.4])
    bad[2] = np.nan
    same = np.tile([[0.5, 0, 0.5]], (4, 1))
    points = [good, np.array([[0, 0, 0.9]]), bad, same, good - np.array([0, 0, 0.4])]
    radius = np.concatenate([np.full(5, 0.05), [0.2], np.full(5, 0.05), np.full(4, 0.2), np.zeros(5)])
    lines = made("bad", points, radius)
    result = render(case(lines, cameras.camera()), COMBINED)
    assert result.report["warnings"] == [
        "bad: 1 point is not finite and is left out",
        "bad: 2 strands have less than two positions and are left out",
        "bad: 1 strand has no radius and is left out",
    ]
    strands = with_levels(valid_strands(lines)[0])
    assert list(np.diff(strands.start)) == [5, 2, 2]
    left = made("good", [good, bad[:2], bad[3:]], 0.05)
    assert np.array_equal(result.pixels["combined"][..., 3], alpha(case(left, cameras.camera())))
    rest = replace(lines, key="bad radius", radius=np.where(np.arange(20) == 1, np.nan, radius).astype(np.float32))
    assert alpha(case(rest, cameras.camera())).sum() > 0
    empty = made("none", [np.zeros((0, 3))], 0.1)
    assert alpha(case(empty, cameras.camera())).sum() == 0


def test_a_strand_of_a_million_points_is_one_of_few_segments():
    t = np.linspace(-1, 1, 1_000_000)
    lines = made("long", [np.stack([t, 0 * t, 0.5 * np.sin(3 * t)], axis=1)], 0.06)
    result = render(case(lines, cameras.camera()), COMBINED)
    assert result.report["lines"]["segments"] < 200
    assert result.pixels["combined"][..., 3].sum() > 48 * 0.4


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA", "PAINTER"])
def test_strands_hide_and_are_hidden_under_every_technique(technique):
    """A tube through a sphere of points and a cube: what lies in them is not seen, what lies before them is."""
    lines = made("through", [np.array([[-2.0, -1, -0.6], [2.0, 1, 0.6]])], 0.1)
    hybrid = solid_cases.mixed()
    both = [(g, m) for g, m in zip(hybrid.scene.geometries, hybrid.scene.instances.world_from_object, strict=True)]
    plain = Case(
        build.scene(*both, (geometry(lines), build.moved())), hybrid.camera, replace(PLAIN, technique=technique)
    )
    passes = frozenset({"combined", "object_index", "depth"})
    index = render(plain, passes).pixels["object_index"][..., 0]
    assert {1, 2, 3} <= set(np.unique(index))
    alone = render(Case(build.scene((geometry(lines), build.moved())), hybrid.camera, PLAIN), passes).pixels
    shown = render(plain, passes).pixels
    mine = index == 3
    assert np.count_nonzero(mine) < np.count_nonzero(alone["object_index"])
    assert np.abs(shown["depth"] - alone["depth"])[mine].max() < 1e-5
    # Measured 0, but for the painter, whose splats reach over what stands beside them: 0.040.
    assert np.abs(shown["combined"] - alone["combined"])[mine].mean() < (0.05 if technique == "PAINTER" else 1e-6)


def test_a_thin_tube_is_as_bright_as_the_same_one_near_by():
    """The mean of a wide tube's shading across it, and what is shaded as a whole."""

    def mean(width: float, roughness: float) -> np.ndarray:
        table = build.materials(roughness=[roughness], base_color=[[0.8, 0.5, 0.2]])
        lines = made(f"bright {width}", [np.array([[0.13, 0, -3], [0.13, 0, 3]])], 0.5 * width * 2 / 48)
        one = case(lines, cameras.camera((0, -4, 0), parallel=2.0), table=table, world=World(np.full(3, 0.2)))
        pixels = render(one, COMBINED, 64).pixels["combined"]
        return pixels[..., :3].sum(axis=(0, 1)) / pixels[..., 3].sum()

    for roughness, bound in ((0.3, 0.04), (0.6, 0.07), (1.0, 0.1)):
        wide, narrow = mean(20, roughness), mean(1.6, roughness)
        assert np.abs(narrow / wide - 1).max() < bound  # measured 0.025, 0.051, 0.087


def test_cut_out_strands_leave_holes_in_alpha():
    lines = made("held", [bow()], 0.2)
    held = build.scene((geometry(lines), build.moved()), holdout=[True])
    pixels = render(Case(held, cameras.camera(), PLAIN), COMBINED).pixels["combined"]
    assert np.array_equal(pixels[..., 3] == 0, alpha(case(lines, cameras.camera())) == 1)


@pytest.mark.parametrize("radius", [0.005, 0.03, 0.2])
@pytest.mark.parametrize("flat", [False, True])
def test_what_no_light_falls_on_is_black_and_covers_the_same(radius, flat):
    """Without light no normals are drawn: thinner than a raster line, up to two of them, and wider."""
    lines = made(f"dark {radius} {flat}", [bow()], radius)
    if flat:
        lines = replace(lines, normal=np.tile(np.array([[0, -1, 0]], np.float32), (5, 1)))
    lit = case(lines, cameras.camera())
    dark = case(lines, cameras.camera(), lights=(), world=World())
    seen = render(dark, COMBINED, 8).pixels["combined"]
    assert seen[..., 3].sum() > 0
    assert np.array_equal(seen[..., 3], alpha(lit, 8))
    assert not seen[..., :3].any()


@pytest.mark.parametrize("width", [0.004, 0.02])
def test_strands_take_as_much_light_from_a_plane_as_they_cover(width):
    """A fifth of the light, however fine they are; the eye is between them and the plane."""
    x = np.arange(-1.5, 1.5, 5 * width)
    points = [np.array([[a, -0.6, -1.5], [a, -0.6, 0], [a, -0.6, 1.5]]) for a in x]
    lines = made(f"grid {width}", points, width / 2)
    plane = (build.mesh(meshes.plane_mesh("below a grid", 2.0), "POLYGONS"), build.moved())
    grid = (geometry(lines), build.moved())
    camera = cameras.camera((0, -0.5, 0), field_of_view=60)
    sun = [build.sun(3.0, (0, 1, 0))]

    def mean(*things) -> float:
        scene = build.scene(*things, lights=sun, world=World())
        return float(
            render(Case(scene, camera, Settings(technique="IMAGE_SPACE")), COMBINED, 4)
            .pixels["combined"][..., :3]
            .mean()
        )

    found = mean(plane, grid) / mean(plane)
    assert abs(found - 0.8) < 0.01  # measured 0.0017


def test_strands_that_a_sample_shows_lie_all_over_however_they_were_laid_out():
    """Hair on a Fibonacci sphere, whose azimuths are multiples of the golden ratio."""
    root = clouds.sphere_points(4000)
    lines = with_levels(made("fibonacci", [np.stack([p, 1.2 * p]) for p in root], 0.01))
    shown = (lines.phase + sample_offsets(16)[3]) % 1 < 0.1
    assert abs(shown.mean() - 0.1) < 0.01  # measured 0.0005
    sector = np.floor((np.arctan2(root[:, 1], root[:, 0]) / (2 * np.pi) % 1) * 8).astype(int)
    shares = np.bincount(sector[shown], minlength=8) / np.bincount(sector)
    assert np.abs(shares - 0.1).max() < 0.05  # of 500 each; measured 0.028


def test_strands_that_come_to_a_picture_are_drawn_and_those_that_go_are_not():
    """Targets are lent from one frame to the next: not to one with strands from one without."""
    lines = made("come and go", [bow()], 0.1)
    camera = replace(EYES["before"], resolution=(52, 44))
    cube = build.mesh(meshes.cube_mesh("beside strands", 0.5), "POLYGONS"), build.moved((0, 0, 1))
    alone = Case(build.scene(cube, transparent=True), camera, PLAIN)
    both = Case(build.scene(cube, (geometry(lines), build.moved()), transparent=True), camera, PLAIN)
    first, second, third, fourth = (alpha(c).sum() for c in (alone, both, alone, both))
    assert first == third < second == fourth
