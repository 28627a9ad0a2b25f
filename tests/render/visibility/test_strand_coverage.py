"""Strands in the visibility buffer cover what closed forms say: width times length, in all widths and directions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import MANY
from pointsplat_addon.core.numeric.pixel_filter import FILTER_SIZE, blackman_harris
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.device.protocol import EMPTY
from pointsplat_addon.render.frame.frame import Frame
from scripts.scenes import build, cameras
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render

COMBINED = frozenset({"combined"})
SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
BLOCK, BLOCKS = 32, 12  # pixels of a strand's own square, and squares along a side of the picture
SIDE = BLOCK * BLOCKS  # pixels, and units of the parallel camera
EYE = cameras.camera((0, -100, 0), resolution=(SIDE, SIDE), parallel=float(SIDE), near=1, far=300)
LENGTH = 20.0  # pixels
ALONG_AXES = np.arctan2([0, 1, -1, 1, 4, 3], [1, 4, 4, 1, 1, 5])  # of pixels, of the lattice, and their diagonals


def case(geometry: Geometry, camera: Camera, **more) -> Case:
    return Case(build.scene((geometry, np.eye(4)), transparent=True, **more), camera, SETTINGS)


def covered(geometry: Geometry, camera: Camera = EYE, lattices: int = 1) -> np.ndarray:
    """(H, W) float64: the share of each pixel's sub-samples that a geometry covers, before the pixel filter."""
    drawn = case(geometry, camera)
    # One that is shown while it is drawn has all of this picture in one tile.
    frame = Frame(opengl(), drawn.scene, drawn.request(COMBINED, lattices * MANY.count), presented=True)
    try:
        found = np.zeros(camera.window[:1:-1])
        for _ in range(lattices):
            frame.sample()
            assert frame.targets.visibility is not None
            found += frame.frame_plan.cropped((frame.targets.visibility.buffer.read() != EMPTY).mean(axis=2))
        return found / lattices
    finally:
        frame.release()


def alpha(geometry: Geometry, camera: Camera, samples: int = MANY.count) -> np.ndarray:
    return render(case(geometry, camera), COMBINED, samples).pixels["combined"][..., 3]


def by_strand(geometry: Geometry) -> np.ndarray:
    """(N,) float64: pixels that each of the strands of `field` covers."""
    return covered(geometry).reshape(BLOCKS, BLOCK, BLOCKS, BLOCK).sum(axis=(1, 3)).reshape(-1)


def field(
    width: float, angles: float | None = None, points: int = 2, bend: float = 0.0, ribbons: bool = False
) -> Geometry:
    """A strand of LENGTH by `width` pixels in each of the squares, in random directions or in one, that may bend by so
    many radians at each inner point."""
    rng = np.random.default_rng(5)
    middle = (np.stack(np.meshgrid(*[np.arange(BLOCKS)] * 2), axis=-1).reshape(-1, 2) + 0.5) * BLOCK - SIDE / 2
    middle = middle + rng.uniform(-0.5, 0.5, middle.shape)
    turn = rng.uniform(0, np.pi, (len(middle), 1)) if angles is None else np.full((len(middle), 1), angles)
    turn = turn + bend * np.cumsum(rng.choice([-1, 1], (len(middle), points - 1)), axis=1)
    step = LENGTH / (points - 1) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    places = np.concatenate([np.zeros((len(middle), 1, 2)), np.cumsum(step, axis=1)], axis=1)
    places += middle[:, None] - places.mean(axis=1, keepdims=True)
    strands = np.stack([places[..., 0], np.zeros(places.shape[:2]), places[..., 1]], axis=-1)
    toward = np.tile(np.array([0, -1, 0], np.float32), (strands.shape[0] * points, 1)) if ribbons else None
    key = f"field {width} {angles} {points} {bend} {ribbons}"
    return build.strand_lines(key, list(strands), width / 2, **({} if toward is None else {"normal": toward}))


@pytest.mark.parametrize("ribbons", [False, True])
@pytest.mark.parametrize("width", [0.005, 0.02, 0.05, 0.1, 0.2, 0.25, 0.4, 0.8, 1.5])
def test_straight_strands_cover_width_times_length(width, ribbons):
    """Of each that is narrower than a cell no more than one sub-sample is uncertain; of others, their edges."""
    found = by_strand(field(width, ribbons=ribbons)) / (width * LENGTH)
    cells = width * LENGTH * MANY.count
    thin = width < MANY.spacing / np.sqrt(2)
    # Measured 0.53 to 0.72 sub-samples of thin ones; 5.2 of others. Points thrown at random: the root of `cells`.
    assert found.std() * cells < (0.8 if thin else 6)
    # Measured at most 2.2 standard deviations.
    assert abs(found.mean() - 1) < 3 * (0.8 if thin else 6) / cells / BLOCKS
    if width >= 0.05:
        assert abs(found.mean() - 1) < 0.01


@pytest.mark.parametrize("width", [0.05, 0.15])
@pytest.mark.parametrize("angle", [*ALONG_AXES, 0.3, 1.1])
def test_thin_strands_cover_as_much_in_all_directions(width, angle):
    """Also where they run along the lattice, and single points would find all of a strand, or nothing."""
    found = by_strand(field(width, float(angle))) / (width * LENGTH)
    assert abs(found.mean() - 1) < 0.01
    assert found.std() * width * LENGTH * MANY.count < 0.9


@pytest.mark.parametrize("points", [8, 21])
@pytest.mark.parametrize("width", [0.1, 0.16, 0.22, 0.5])
def test_bends_neither_add_nor_take(width, points):
    """Segments share their ends: no column of cells is covered twice."""
    found = by_strand(field(width, points=points, bend=0.4)) / (width * LENGTH)
    assert abs(found.mean() - 1) < 0.01


@pytest.mark.parametrize("samples", [1, 5])
@pytest.mark.parametrize("width", [0.05, 0.2, 0.5, 0.9, 1.5])
def test_few_sub_samples_show_thin_strands_too(width, samples):
    """All strands together: with one sub-sample a pixel those below a pixel are as rare as they are thin."""
    found = alpha(field(width), EYE, samples).sum() / (width * LENGTH * BLOCKS**2)
    assert abs(found - 1) < 0.01  # measured at most 0.007; nothing at all with one, when its lines were told by widths


def test_many_lattices_together_are_the_filters_integral():
    """A straight strand of a tenth of a pixel, pixel by pixel."""
    side, angle, width = 24, 0.37, 0.1
    eye = cameras.camera((0, -100, 0), resolution=(side, side), parallel=float(side), near=1, far=300)
    ends = np.array([-1.0, 1.0])[:, None] * 40 * np.array([np.cos(angle), 0, np.sin(angle)])
    found = alpha(build.strand_lines("line", [ends], width / 2), eye, samples=256 * MANY.count)
    # Along the line, points so close to each other that the filter is a line's integral.
    t = np.linspace(-40, 40, 40_001)
    place = t[:, None] * [np.cos(angle), np.sin(angle)] + side / 2
    exact = np.zeros((side, side))
    inside = ((place > 1) & (place < side - 1)).all(axis=1)
    low = np.floor(place[inside]).astype(int)
    for y in (-1, 0, 1):
        for x in (-1, 0, 1):
            at = low + np.array([x, y])
            weight = np.prod(blackman_harris(place[inside] - at - 0.5, FILTER_SIZE), axis=1)
            np.add.at(exact, (at[:, 1], at[:, 0]), weight)
    whole = blackman_harris(np.linspace(-2, 2, 40_001), FILTER_SIZE).sum() * 1e-4
    exact *= width * (t[1] - t[0]) / whole**2
    inner = slice(3, -3)
    assert np.sqrt(np.mean((found - exact)[inner, inner] ** 2)) < 0.005  # measured 0.002, of up to 0.15


def test_a_tapering_strand_covers_less_and_less():
    """From 0.4 pixels to nothing, across the width of a cell."""
    z = np.arange(-150, 150, 3.3)
    ends = [np.array([[-180.0, 0, a], [180.0, 0, a + 30.0]]) for a in z]
    found = covered(build.strand_lines("tapering", ends, np.tile([0.2, 0.0], len(z)))).sum(axis=0) / len(z)
    x = np.arange(SIDE) + 0.5 - SIDE / 2
    want = 0.4 * np.clip((180 - x) / 360, 0, 1) * np.hypot(360, 30) / 360
    inside = np.abs(x) < 179
    # The mean of 8 columns of pixels; measured 0.0027.
    off = (found - want)[inside][: inside.sum() // 8 * 8].reshape(-1, 8).mean(axis=1)
    assert np.abs(off).max() < 0.005


def test_what_is_left_out_of_distant_strands_is_held_by_the_rest():
    """Strands that curl below a pixel cover their own length, not that of what they are simplified to."""
    turn = np.linspace(0, 12 * np.pi, 97)
    curl = np.stack([0.3 * np.cos(turn), 0 * turn, 0.4 * turn], axis=1)
    points = [curl + np.array([3.0 * i, 0, 17.0 * j]) for i in range(-50, 50) for j in range(-8, 8)]
    lines = build.strand_lines("curls", points, 0.03)
    result = render(case(lines, EYE), COMBINED, 16)
    length = np.linalg.norm(np.diff(curl[:, ::2], axis=0), axis=1).sum()
    assert result.report["lines"]["segments"] < 97 * len(points) / 3
    assert abs(covered(lines).sum() / (len(points) * length * 0.06) - 1) < 0.01  # measured 0.0026


def fan(radius: float, lines: Sequence[tuple[np.ndarray, np.ndarray]], key: str) -> Geometry:
    return build.strand_lines(f"{key} {radius}", [np.stack(ends) for ends in lines], radius)


@pytest.mark.parametrize("view", [pytest.param("wide", marks=pytest.mark.long), "narrow pixels"])
def test_thin_strands_cover_their_share_of_tubes_that_rays_meet(view):
    """In all parts of a wide picture, near and far, and where pixels are not square: outlines are straight, and as far
    apart as tubes are wide."""
    rng = np.random.default_rng(3)
    eye = cameras.camera((0, 0, 0), (0, 1, 0), resolution=(256, 192), field_of_view=100, near=0.1, far=100)
    if view == "narrow pixels":
        clip = eye.clip_from_view.copy()
        clip[0] *= 0.5
        eye = replace(eye, clip_from_view=clip)
    lines = []
    for direction in rng.uniform([-0.9, 1, -0.65], [0.9, 1, 0.65], (150, 3)):
        middle, way = direction * rng.uniform(3, 6), rng.normal(size=3)
        way *= 0.7 / np.linalg.norm(way)
        lines.append((middle - way, middle + way))
    thin, wide = 0.0004, 0.04
    found = sum(covered(fan(thin, [line], f"{view} {i}"), eye, 4).sum() for i, line in enumerate(lines[:30]))
    exact = sum(covered(fan(wide, [line], f"{view} {i}"), eye, 4).sum() for i, line in enumerate(lines[:30]))
    assert exact > 500
    assert abs(found / exact * wide / thin - 1) < 0.02


def test_strands_that_the_near_plane_cuts_cover_what_lies_beyond_it():
    """As if they began there, thin or wide, whatever they would cover at the eye."""
    eye = cameras.camera((0, 0, 0), (0, 1, 0), resolution=(96, 80), near=0.5, far=100)
    behind, ahead = np.array([0.35, -2.0, -0.3]), np.array([-0.6, 6.0, 0.4])
    at = behind + (0.5 - behind[1]) / (ahead[1] - behind[1]) * (ahead - behind)
    for radius in (0.0002, 0.002, 0.004):
        whole = covered(build.strand_lines(f"through {radius}", [np.stack([behind, ahead])], radius), eye, 16)
        part = covered(
            build.strand_lines(f"beyond {radius}", [np.stack([at + 1e-5 * (ahead - at), ahead])], radius), eye, 16
        )
        assert part.sum() > 0.5
        assert abs(whole.sum() / part.sum() - 1) < 0.01, radius


@pytest.mark.parametrize("near", [-50.0, 1.0])
def test_parallel_cameras_may_see_behind_themselves(near):
    eye = replace(
        EYE,
        near=near,
        clip_from_view=cameras.camera(resolution=(SIDE, SIDE), parallel=float(SIDE), near=near, far=300).clip_from_view,
    )
    lines = [np.array([[-150.0, -120, z], [150.0, -80, z + 3.0]]) for z in np.arange(-100.0, 100, 5)]
    found = covered(build.strand_lines(f"behind {near}", lines, 0.05), eye).sum()
    share = 1.0 if near < 0 else (20 - near) / 40
    assert abs(found / (len(lines) * 0.1 * np.hypot(300, 3) * share) - 1) < 0.01


def test_strands_in_one_pixel_hide_each_other_as_often_as_their_widths_say():
    """Of many thin ones that lie about a place at random, as much as a product of what each leaves."""
    rng = np.random.default_rng(2)
    z, turn = rng.uniform(-190, 190, 6000), rng.uniform(-0.3, 0.3, 6000)
    ends = [
        np.array([[-300.0, y, a - 300 * np.tan(b)], [300.0, y, a + 300 * np.tan(b)]])
        for a, b, y in zip(z, turn, rng.uniform(-20, 20, 6000), strict=True)
    ]
    width = 0.05
    found = covered(build.strand_lines("crowd", ends, width / 2))[100:-100, 100:-100].mean()
    hits = width * np.mean(1 / np.cos(turn)) * 6000 / 380
    assert abs(found - (1 - np.exp(-hits))) < 0.01
