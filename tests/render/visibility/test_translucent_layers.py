"""Translucent splats over the sub-samples of the visibility buffer."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import FEW, MANY, ONE
from pointsplat_addon.core.numeric.pixel_filter import filter_weights
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.kernel import SUPPORT
from pointsplat_addon.render.frame.visibility import tiles as picture_tiles
from pointsplat_addon.render.passes.tiles import TILE
from pointsplat_addon.render.passes.translucent.cells import (
    BLOCK,
    PixelBlock,
    blocks,
    first_cell,
    largest_block,
    number_texels,
    splats_in,
)
from pointsplat_addon.render.passes.translucent.strata import (
    bounds,
    tiles_by_layer,
    touched_tiles,
    weight_rows,
    widened,
)
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, cases, clouds, drawing, meshes
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from tests.support.transmittance import voxels

COMBINED = frozenset({"combined"})


def picture(made, eye, samples=16, technique="VISIBILITY", interactive=False, **more):
    settings = Settings(technique=technique, use_shadows=False, adaptive_threshold=0.0, **more)
    request = Request(eye, settings, COMBINED, samples, interactive=interactive)
    result = drawing.opengl().render(made, request)
    assert result.report["technique"]["name"] == technique
    return result.pixels["combined"].astype(np.float64)


def glowing(*things, **more):
    """A scene of things that send white light out, and a fog that sends none, without lights."""
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.ones((1, 3)))
    return build.scene(*things, lights=(), table=table, **{"world": World(), "transparent": True, **more})


def turned_cubes():
    """Two cubes whose edges run along no axis, one behind the other."""
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, 0, s, 0], [s * s, c, -s * c, 0], [-s * c, s, c * c, 0], [0, 0, 0, 1]])
    cube = build.mesh(meshes.cube_mesh("turned", 0.3), "POLYGONS")
    return (cube, moved((-0.25, 0, 0)) @ turn), (cube, moved((0.3, 1, 0.1)) @ turn)


@pytest.mark.parametrize("samples", [1, 5, 16, 40])
@pytest.mark.parametrize("depth", [1.0, np.array([0.2, 1.0, 3.0])])
def test_edges_behind_a_fog_are_those_without_it_times_what_it_lets_through(samples, depth):
    """An even fog before everything: each pixel is what is opaque in it times the fog's transmittance, whatever the
    pixel's share of the edge."""
    eye = camera((0, -30, 0), field_of_view=2, resolution=(64, 48))
    fog = points(f"fog before cubes {np.size(depth)}", voxels(2.4, 0.5, 12, depth / 0.5)), moved((0, -3, 0))
    alone, veiled = (picture(glowing(*turned_cubes(), *more), eye, samples) for more in ((), (fog,)))
    own = picture(glowing(fog), eye, 16)
    through = np.broadcast_to(np.exp(-depth), 3)
    assert own[..., 3].mean() == pytest.approx(1 - through[1], rel=5e-3)
    # What the fog lets through, pixel by pixel, is known from its alpha: the green channel's.
    expected = alone[..., 1] * (1 - own[..., 3])
    assert np.abs(veiled[..., 1] - expected).max() < 2e-3  # measured 5e-4
    assert np.abs(veiled[..., :3].mean(axis=(0, 1)) / alone[..., :3].mean(axis=(0, 1)) - through).max() < 5e-3
    assert np.abs(veiled[..., 3] - (own[..., 3] + alone[..., 3] * (1 - own[..., 3]))).max() < 2e-3


def test_a_fog_behind_edges_shows_beside_them_alone():
    """Nothing of it leaks over what is before it, and its own share of the pixel is what the edge leaves."""
    eye = camera((0, -30, 0), field_of_view=2, resolution=(64, 48))
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0])
    black = build.mesh(meshes.cube_mesh("black", 0.3), "POLYGONS"), turned_cubes()[0][1]
    glow = points("glow behind cube", voxels(2.4, 0.5, 12, 2.0, emission=(2.0, 2.0, 2.0))), moved((0, 3, 0))
    made = [build.scene(*t, lights=(), world=World(), table=table, transparent=True) for t in ((black,), (glow,))]
    cut = picture(made[0], eye)[..., 3]
    whole = picture(build.scene(black, glow, lights=(), world=World(), table=table, transparent=True), eye)
    expected = picture(made[1], eye)[..., 0] * (1 - cut)
    assert np.abs(whole[..., 0] - expected).max() < 2e-3 * expected.max()
    assert whole[cut > 1 - 1e-6][:, 0].max() < 1e-6


def test_smoke_agrees_with_that_of_many_samples():
    case = cases.CASES["tinted_smoke"]()
    eye = replace(case.camera, resolution=(160, 120))
    found, truth = picture(case.scene, eye), picture(case.scene, eye, 65, "IMAGE_SPACE")
    inner = (found - truth)[:, 1:-1]  # the plane behind the smoke ends with the picture
    assert np.sqrt(np.square(inner).mean()) < 2e-4  # measured 4e-5


@pytest.mark.parametrize(("name", "worst"), [("panes", 1e-3), ("panes_of_functions", 1e-3)])  # measured 4.7e-4
def test_panes_agree_with_those_of_many_sub_samples(name, worst):
    """Splats of them, of 65 samples, are off by 0.0037: their outlines are soft."""
    case = cases.CASES[name]()
    eye = replace(case.camera, resolution=(160, 120))
    assert np.sqrt(np.square(picture(case.scene, eye) - picture(case.scene, eye, 272)).mean()) < worst


def test_a_holdout_of_fog_takes_of_edges_what_it_hides():
    eye = camera((0, -30, 0), field_of_view=2, resolution=(64, 48))
    fog = points("fog held before cubes", voxels(2.4, 0.5, 12, 2.0, emission=(9.0, 9.0, 9.0))), moved((0, -3, 0))
    alone = picture(glowing(*turned_cubes()), eye)
    held = picture(glowing(*turned_cubes(), fog, holdout=(False, False, True)), eye)
    assert np.abs(held - alone * np.exp(-1.0)).max() < 5e-3


def variation(image, reach):
    """How much an image (H, W, C) varies within `reach` pixels of each pixel, at most of all channels: (H, W)."""
    height, width = image.shape[:2]
    padded = np.pad(image, [(reach, reach), (reach, reach), (0, 0)], "edge")
    moves = range(2 * reach + 1)
    return np.ptp([padded[y : y + height, x : x + width] for y in moves for x in moves], axis=0).max(axis=2)


@pytest.mark.parametrize("samples", [5, 40])
def test_tiles_of_a_picture_meet_without_seams(monkeypatch, samples):
    """Sub-samples on the edge of a triangle are rounded to it or not, by their places in a tile: here of white ones and
    of glass. Where that is so, it is if all of them are opaque, too. A seam would show elsewhere."""
    glass = cases.CASES["panes"]().scene
    opaque = replace(glass.materials, alpha=np.ones_like(glass.materials.alpha), translucent=None)
    polygons = tuple(replace(geometry, primitive="POLYGONS") for geometry in glass.geometries)
    scenes = glass, replace(glass, materials=opaque, geometries=polygons)
    eye = camera((0.5, -4, 0.5), resolution=(150, 130))
    whole = [picture(scene, eye, samples) for scene in scenes]
    monkeypatch.setattr(picture_tiles, "MOST_CELLS", 60_000)
    drawing.opengl().pool.release()
    parts = [picture(scene, eye, samples) for scene in scenes]
    drawing.opengl().pool.release()
    difference, of_opaque = (np.abs(a - b).max(axis=2) for a, b in zip(whole, parts, strict=True))
    smooth, rounded = variation(whole[0], 1) < 1e-3, of_opaque > 1e-4
    assert smooth.mean() > 0.75  # measured 0.79
    assert rounded.mean() < 0.001  # measured 0.0007
    assert difference[smooth].max() < 1e-5  # measured 8.1e-7
    assert difference[~rounded].max() < 0.01  # measured 2.9e-5 and 0.0020
    assert difference.max() < of_opaque.max()


def test_the_first_picture_of_a_view_that_moves_is_near_the_others():
    """Its splats are drawn at half the size."""
    scene = glowing(*turned_cubes(), (points("coarse", voxels(1.0, 1.0, 12, 1.0)), moved((0, -1, 0))))
    eye = camera((0, -30, 0), field_of_view=2, resolution=(128, 96))
    coarse, fine = picture(scene, eye, 5, interactive=True), picture(scene, eye, 5)
    assert 0 < np.abs(coarse - fine).mean() < 3e-3


# What is looked at where


@pytest.mark.parametrize("lattice", [ONE, FEW, MANY])
def test_weights_of_all_sub_samples_add_up(lattice):
    weights = filter_weights(lattice, (0.1, -0.2), 1.5)
    rows = weight_rows(weights, np.arange(lattice.count))[..., 0]
    assert rows[:, 2].sum() == pytest.approx(1)
    np.testing.assert_allclose(rows[:, 3:].sum(axis=1), rows[:, 2], rtol=1e-6)


@pytest.mark.parametrize("lattice", [ONE, FEW, MANY])
def test_blocks_share_tiles_and_hold_their_cells(lattice):
    """Each tile is in one block, and all sub-samples that its pixels and their neighbours take in lie in the block's
    target, as many cells from its first as they lie from the picture's."""
    random = np.random.default_rng(4)
    size, margin = (TILE * (BLOCK + 3) - 5, TILE * (BLOCK + 1) - 9), 2
    tiles = random.random((BLOCK + 1, BLOCK + 3)) > 0.8
    shared = np.zeros(tiles.shape, int)
    columns, rows = lattice.size(largest_block(size, margin))
    corner = np.array(lattice.corner(size))
    for found, own in blocks(tiles, size, margin):
        shared += own
        first = np.array(first_cell(lattice, found, size))
        for row, column in np.argwhere(own):
            low = np.maximum(TILE * np.array([column, row]) - margin, 0)
            high = np.minimum(TILE * np.array([column + 1, row + 1]) + margin, size) - 1
            assert (found.low <= low).all()
            assert (found.high > high).all()
            for x, y in ((low[0], low[1]), (high[0], low[1]), (low[0], high[1]), (high[0], high[1])):
                central = corner + np.array([lattice.p * x - lattice.q * y, lattice.q * x + lattice.p * y])
                cells = central + lattice.offsets - first
                assert (cells >= 0).all()
                assert (cells < (columns, rows)).all()
    np.testing.assert_array_equal(shared, tiles)


def test_sub_samples_are_found_by_their_cells():
    numbers = number_texels(MANY)[..., 0]
    reach = len(numbers) // 2
    for number, (column, row) in enumerate(MANY.offsets):
        assert numbers[row + reach, column + reach] == number


def test_splats_that_reach_into_a_block_are_found():
    random = np.random.default_rng(5)
    count, middle, found = 300, (90.0, 100.0), PixelBlock((80, 70), (120, 140))
    centre = np.column_stack([random.uniform(-100, 100, (count, 2)), np.ones(count), random.random(count) > 0.2])
    shape = np.column_stack([random.uniform(0.1, 30, count), np.zeros(count), random.uniform(0.1, 30, count)])
    half = np.sqrt(SUPPORT * shape[:, [0, 2]])
    low, high = centre[:, :2] + middle - half, centre[:, :2] + middle + half
    expected = (centre[:, 3] > 0) & (low < found.high).all(axis=1) & (high > found.low).all(axis=1)
    np.testing.assert_array_equal(splats_in(found, centre, shape, middle), np.flatnonzero(expected))
    assert 0.1 < expected.mean() < 0.5


def test_tiles_that_splats_touch_are_found():
    random = np.random.default_rng(3)
    size, middle, count = (200, 170), (90.0, 100.0), 40
    centre = np.column_stack([random.uniform(-150, 150, (count, 2)), np.ones(count), random.random(count) > 0.2])
    shape = np.column_stack([random.uniform(0.1, 30, count), np.zeros(count), random.uniform(0.1, 30, count)])
    found = touched_tiles(centre, shape, middle, size, 1.0)
    expected = np.zeros_like(found)
    for (x, y, _, there), (xx, _, yy) in zip(centre, shape, strict=True):
        half = np.sqrt(SUPPORT * np.array([xx, yy])) + 1.0
        low, high = np.array([x, y]) + middle - half, np.array([x, y]) + middle + half
        for row, column in np.ndindex(*expected.shape):
            corner = TILE * np.array([column, row])
            expected[row, column] |= bool(there) and bool(((low < corner + TILE) & (high >= corner)).all())
    assert found.shape == (11, 13)
    np.testing.assert_array_equal(found, expected)
    assert 0.1 < found.mean() < 0.9


def test_tiles_with_further_layers_are_among_those_with_fewer():
    layers = np.ones((40, 50), int)
    layers[20, 49], layers[:, 3] = 3, 2
    first, second, third = tiles_by_layer(layers, np.ones((3, 4), bool))
    assert first.all()
    np.testing.assert_array_equal(second, [[1, 0, 0, 0], [1, 0, 0, 1], [1, 0, 0, 0]])
    np.testing.assert_array_equal(third, [[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    assert bounds(third) == (48, 16, 64, 32)
    assert len(tiles_by_layer(layers, np.zeros((3, 4), bool))) == 1
    assert widened(third).sum() == 6


@pytest.mark.parametrize("samples", [1, 16])
def test_translucent_splats_alone_draw_layers_where_there_are_several_samples(samples):
    made = build.scene((points("balls alone", clouds.smoke_cloud(4)), moved()), lights=())
    eye = camera(resolution=(32, 24))
    result = drawing.opengl().render(made, Request(eye, Settings(technique="VISIBILITY"), COMBINED, samples))
    assert ("expand" in {entry["name"] for entry in result.report["passes"]}) == (samples > 1)


@pytest.mark.parametrize("cells", [8, 40])
def test_smoke_alone_has_the_mean_of_many_pictures(cells):
    """Of wide splats, and of some narrower than a pixel."""
    made = glowing((points(f"smoke alone {cells}", clouds.smoke_cloud(cells)), moved()))
    eye = camera((0, -5, 0), resolution=(24, 24))
    once, often = picture(made, eye, 16), picture(made, eye, 64, "IMAGE_SPACE")
    assert np.abs(once - often).max() < 0.007  # measured 0.0050


def glowing_panes(apart: float, order: tuple[int, int]):
    """Two panes that shine, of two materials, the first of `order` in front; and what both show, RGBA."""
    alpha, shine = np.array([0.4, 0.7]), np.array([[1.0, 0.1, 0.0], [0.0, 0.2, 1.0]])
    table = build.materials(
        2, alpha=alpha, translucent=np.array([True, True]), base_color=np.zeros((2, 3)), specular=[0, 0], emission=shine
    )
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
    flat = [meshes.flat_mesh(f"glowing pane {row}", corners, np.array([[0, 1, 2], [0, 2, 3]])) for row in (0, 1)]
    things = [
        (build.mesh(replace(flat[row], materials=(row,)), "POLYGONS"), moved((0, y, 0)))
        for row, y in zip(order, (0, apart), strict=True)
    ]
    front, back = order
    shown = alpha[front] * shine[front] + (1 - alpha[front]) * alpha[back] * shine[back]
    made = build.scene(*things, lights=(), table=table, world=World(), transparent=True)
    return made, np.append(shown, 1 - (1 - alpha).prod())


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize(("apart", "turn"), [(0.02, 0.0), (0.02, 1.0), (0.001, 0.0)])
@pytest.mark.parametrize("distance", [2.5, 1000.0])
def test_of_two_panes_the_nearer_one_veils_the_other(order, apart, turn, distance):
    """Pixels are 0.02 wide: panes a pixel apart seen aslant, and a twentieth of one face on."""
    made, expected = glowing_panes(apart, order)
    place = distance * np.array([np.sin(turn), -np.cos(turn), 0])
    eye = camera(place, field_of_view=float(np.degrees(2 * np.arctan(0.4 / distance))), resolution=(40, 40),
                 near=distance / 100, far=distance * 2)  # fmt: skip
    found = picture(made, eye)[8:-8, 8:-8]
    assert np.abs(found - expected).max() < 1e-3  # measured 6.3e-4; with slices as thick as splats 0.28
