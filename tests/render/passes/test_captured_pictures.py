"""Captured splats against the published formula in float64, alone and among other things."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.passes.tiles import TILE
from pointsplat_addon.render.passes.translucent.strata import open_tiles, tiles_by_layer
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, one_splat, random_splats
from tests.reference import captured as reference
from tests.support.transmittance import voxels

SIZE = (96, 72)
CAMERAS = {
    "perspective": camera((0, -6, 0), resolution=SIZE, field_of_view=50),
    "shifted": camera((0, -6, 0), resolution=SIZE, field_of_view=50, shift=(0.2, -0.1)),
    "among them": camera((0, -0.3, 0), resolution=SIZE, field_of_view=90),
    "border": camera((0, -6, 0), resolution=SIZE, field_of_view=50, region=(20, 14, 50, 40)),
    "parallel": camera((1, -6, 2), resolution=SIZE, parallel=4.0),
    "parallel, shifted": camera((1, -6, 2), resolution=SIZE, parallel=4.0, shift=(0.1, 0.2)),
}
TABLE = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.array([[0.2, 0.5, 0.8]]))


def picture(*things, eye, samples=1, **more):
    """(H, W, 4) float64 of things that send light out, without lights."""
    made = build.scene(*things, lights=(), table=TABLE, **{"world": World(), "transparent": True, **more})
    request = Request(eye, Settings(use_shadows=False), frozenset({"combined"}), samples)
    return drawing.opengl().render(made, request).pixels["combined"].astype(np.float64)


@pytest.mark.parametrize("coefficients", [0, 3, 8, 15, 24])
@pytest.mark.parametrize("name", CAMERAS)
def test_pictures_are_those_of_the_published_formula(name, coefficients):
    """Splats of all shapes, twice, once sheared and mirrored: where rounding decides whether alpha reaches 1/255, one
    pixel differs by up to that much."""
    splats, eye = random_splats(700, coefficients, seed=coefficients), CAMERAS[name]
    geometry = captured(f"published {coefficients}", splats)
    found = picture((geometry, SHEARED), (geometry, moved()), eye=eye)
    expected = reference.picture([(splats, SHEARED), (splats, moved())], eye)
    assert found[..., 3].max() > 0.5
    assert reference.psnr(found, expected) > 80  # measured 89 and more
    assert np.abs(found - expected).max() < 0.02  # measured 0.008


def test_what_the_low_pass_widens_loses_opacity_where_training_knew():
    splats = random_splats(700, 3, size=0.01, antialiased=True)
    eye = CAMERAS["perspective"]
    found = picture((captured("antialiased", splats), SHEARED), eye=eye)
    assert reference.psnr(found, reference.picture([(splats, SHEARED)], eye)) > 80
    other = replace(splats, antialiased=False)
    assert picture((captured("aliased", other), SHEARED), eye=eye)[..., 3].mean() > 2 * found[..., 3].mean()


@pytest.mark.parametrize("times", [2, 4])
@pytest.mark.parametrize("size", [0.004, 0.01, 0.05])
def test_wide_pixels_of_a_moving_view_hide_as_much_as_those_for_which_they_stand(size, times):
    splats, eye = captured(f"coarse {size}", random_splats(700, 3, size=size)), CAMERAS["perspective"]
    still, coarse = (
        picture((splats, moved()), eye=one).mean(axis=(0, 1)) for one in (eye, eye.with_coarser_pixels(times))
    )
    # What has become too faint to be drawn is missing: of the smallest splats a tenth. By the wide pixels' own formula
    # they would hide three times as much with pixels twice as wide.
    np.testing.assert_array_less(coarse, 1.005 * still)  # measured 1.0002
    np.testing.assert_array_less(0.88 * still, coarse)  # measured 0.898


@pytest.mark.parametrize("samples", [4, 16, 40])
def test_samples_change_nothing_where_nothing_is_opaque(samples):
    """The low-pass is the pixel filter: pictures are those that training saw."""
    splats, eye = captured("samples", random_splats(300)), CAMERAS["perspective"]
    world = World(np.array([0.2, 0.3, 0.4]))
    one, many = (
        picture((splats, moved()), eye=eye, samples=count, world=world, transparent=False) for count in (1, samples)
    )
    np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize("samples", [1, 16, 40])
def test_a_quad_among_them_hides_what_lies_behind_it(samples):
    """A turned quad half-way through: each side of its edge shows its own formula; on the edge, shares of both."""
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1.0]])
    quad = build.mesh(meshes.plane_mesh("quad among captured", 0.8), "POLYGONS"), turn
    splats, eye = random_splats(700, 8), CAMERAS["perspective"]
    found = picture(quad, (captured("around a quad", splats), moved()), eye=eye, samples=samples)
    alone, seen = picture(quad, eye=eye, samples=samples), reference.project(splats, moved(), eye)
    before, everything = reference.blend(seen, SIZE, 6.0), reference.blend(seen, SIZE)
    share = alone[..., 3:]
    expected = share * before + (1 - share) * everything + (1 - before[..., 3:]) * alone
    whole = ((share > 0.9999) | (share < 1e-6))[..., 0]
    assert reference.psnr(found[whole], expected[whole]) > 80
    if samples > 1:
        # Pixels beside the edge that only the filter brings it to have one layer.
        assert np.abs(found - expected).max() < 0.1  # measured 0.085


def test_the_edge_of_what_they_hide_does_not_shine_through():
    """An opaque splat over the edge of a bright quad: nothing of the quad is left in it, nor of the pixel filter."""
    splat = captured("over an edge", one_splat((0, -1, 0), (1.0, 0.01, 1.0), color=(0, 0, 0)))
    quad = build.mesh(meshes.plane_mesh("quad behind captured", 0.5), "POLYGONS"), moved((0.43, 0.2, 0))
    eye = camera((0, -6, 0), resolution=(40, 30), field_of_view=10)
    found = [picture(*([(splat, moved())] * 3), *things, eye=eye, samples=16) for things in ((), (quad,))]
    through = 1 - found[0][..., 3]
    bright = picture(quad, eye=eye, samples=16)
    assert np.abs(found[1] - found[0] - through[..., None] * bright).max() < 1e-5


def test_one_order_with_smoke():
    """A splat before a slab of smoke, and one behind it: each hides what is behind, and no more."""
    eye = camera((0, -30, 0), field_of_view=3, resolution=(48, 40))
    smoke = build.points("slab", voxels(2.4, 0.5, 12, 1.0 / 0.5)), moved()
    # One that cannot be seen: smoke alone is then drawn as it is among captured splats.
    unseen = captured("unseen", one_splat((0, 0, 0), opacity=0.0)), moved()
    front = captured("before smoke", one_splat((-0.2, -4, 0), 0.2, 0.8, (0.9, 0.3, 0.2))), moved()
    back = captured("behind smoke", one_splat((0.2, 4, 0), 0.3, 0.9, (0.2, 0.4, 0.9))), moved()
    alone = [picture(thing, unseen, eye=eye) for thing in (front, smoke, back)]
    expected = np.zeros_like(alone[0])
    for layer in reversed(alone):
        expected = layer + (1 - layer[..., 3:]) * expected
    assert alone[1][20, 24, 3] == pytest.approx(1 - np.exp(-1), abs=0.02)
    for samples in (1, 16):
        found = picture(back, smoke, front, eye=eye, samples=samples)
        assert np.abs(found - expected).max() < 1e-5


def test_a_holdout_cuts_its_hole():
    eye = camera((0, -6, 0), resolution=(40, 30), field_of_view=20)
    distant, close = one_splat((0, 1, 0), 0.5), one_splat((0, -1, 0), 0.2)
    far, near = captured("far", distant), captured("near", close)
    found = picture((far, moved()), (near, moved()), eye=eye, holdout=[False, True])
    behind, splat = (reference.picture([(made, moved())], eye) for made in (distant, close))
    expected = behind * (1 - splat[..., 3:])
    assert np.abs(found - expected).max() < 1e-5


def test_light_does_not_change_them():
    splats, eye = captured("lit", random_splats(200)), CAMERAS["perspective"]
    dark = picture((splats, moved()), eye=eye)
    made = build.scene((splats, moved()), table=TABLE, transparent=True)
    request = Request(eye, Settings(), frozenset({"combined"}), 1)
    np.testing.assert_array_equal(drawing.opengl().render(made, request).pixels["combined"], dark.astype(np.float32))


def test_a_lens_blurs_what_is_out_of_focus():
    """By samples through the lens, whatever method is asked for: what is in focus stays as it is."""
    eye = replace(camera((0, -6, 0), resolution=(60, 40), field_of_view=20), aperture=Aperture(0.2, 6.0))
    for y, factor in ((0, 1.0), (6, None)):
        splat = captured(f"through a lens {y}", one_splat((0, y, 0), 0.08, 0.9))
        sharp = picture((splat, moved()), eye=replace(eye, aperture=None))
        found = picture((splat, moved()), eye=eye, samples=32)
        if factor is not None:
            assert np.abs(found - sharp).max() < 1e-3
        else:
            assert found[..., 3].max() < 0.7 * sharp[..., 3].max()
            assert found[..., 3].sum() == pytest.approx(sharp[..., 3].sum(), rel=0.02)


def test_another_view_sorts_again_and_the_same_one_does_not():
    splats, renderer = random_splats(500), drawing.opengl()
    made = build.scene((captured("orbit", splats), moved()), lights=(), transparent=True)

    def passes(eye):
        request = Request(eye, Settings(use_shadows=False), frozenset({"combined"}), 1)
        result = renderer.render(made, request)
        expected = reference.picture([(splats, moved())], eye)
        assert reference.psnr(result.pixels["combined"], expected) > 80
        return {entry["name"] for entry in result.report["passes"]}

    first, second = CAMERAS["perspective"], camera((3, 5, 1), resolution=SIZE, field_of_view=50)
    assert "order" in passes(first)
    assert "order" not in passes(first)
    assert "order" in passes(second)


def test_the_same_view_again_shows_the_picture_of_before():
    """Over another world, too, but not where something opaque stands among them."""
    splats, eye, renderer = random_splats(500), CAMERAS["perspective"], drawing.opengl()
    thing, seen = (captured("again", splats), moved()), reference.picture([(splats, moved())], eye)
    quad = build.mesh(meshes.plane_mesh("quad between views", 0.8), "POLYGONS"), moved()
    request = Request(eye, Settings(use_shadows=False), frozenset({"combined"}), 1)
    for value, others, again in ((0.1, (), False), (0.9, (), True), (0.1, (quad,), False), (0.4, (), False)):
        made = build.scene(thing, *others, lights=(), table=TABLE, world=World(np.full(3, value)))
        result = renderer.render(made, request)
        assert ("captured" not in {entry["name"] for entry in result.report["passes"]}) == again
        if not others:
            expected = seen[..., :3] + (1 - seen[..., 3:]) * value
            assert reference.psnr(result.pixels["combined"][..., :3], expected) > 80  # measured 96


def test_what_is_open_is_drawn_where_something_is():
    """A tile that a surface fills, one at its edge, and an open one."""
    covered = np.zeros((TILE, 3 * TILE), int)
    covered[:, : TILE + 4] = 1
    layers = covered + (covered == 0)
    layers[0, TILE] = 2  # an edge
    every = np.ones((1, 3), bool)
    np.testing.assert_array_equal(open_tiles(layers, covered, every), [[False, True, True]])
    np.testing.assert_array_equal(open_tiles(layers, covered, np.array([[True, True, False]])), [[False, True, False]])
    np.testing.assert_array_equal(tiles_by_layer(covered, every)[0], [[True, True, False]])
