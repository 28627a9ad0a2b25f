"""Narrow splats that are looked at in a few places of a pixel, in place of each sub-sample."""

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import MANY
from pointsplat_addon.core.numeric.pixel_filter import blackman_harris, weights_of_blurred
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.kernel import SUPPORT
from pointsplat_addon.render.frame.visibility.translucent import TranslucentLayers
from pointsplat_addon.render.passes.translucent.centres import SMALL, centres_of
from pointsplat_addon.render.passes.translucent.few_places import DENSE, PLACES, steep_pixels
from pointsplat_addon.render.passes.translucent.strata import touched_tiles
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from tests.support.transmittance import voxels

COMBINED = frozenset({"combined"})
SIZE = 64, 48


def drawn(scene, eye, samples=16):
    request = Request(eye, Settings(use_shadows=False), COMBINED, samples)
    return drawing.opengl().render(scene, request).pixels["combined"].astype(np.float64)


def both(scene, eye, monkeypatch, samples=16):
    """The picture, and that of which each sub-sample is looked at."""
    found = drawn(scene, eye, samples)
    with monkeypatch.context() as changed:
        changed.setattr(TranslucentLayers, "_exact_pixels", lambda *_: None)
        return found, drawn(scene, eye, samples)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.2, -0.1), (-0.15, 0.2)])
@pytest.mark.parametrize("own", [0.2, 0.3, 0.45])
def test_places_and_their_weights_are_the_pixel_filter(own, offset):
    """Sums of splats that fill a half-plane, whatever its angle, beside the filter's own picture of it."""
    weights = weights_of_blurred(PLACES.lattice, offset, 1.5, PLACES.deviation).reshape(-1)
    assert weights.sum() == pytest.approx(1, abs=1e-12)
    y, x = (axis.reshape(-1) - 1 for axis in np.indices((3, 3)))
    at = (PLACES.lattice.positions + np.stack([x, y], axis=1)[:, None] + np.array(offset)).reshape(-1, 2)
    t = (np.arange(-400, 400) + 0.5) / 100
    edge = (np.arange(-150, 151)) / 100
    within = blackman_harris(t, 1.5)
    within /= within.sum()
    for angle in np.radians([0, 10, 30, 45]):
        normal = np.array([np.cos(angle), np.sin(angle)])
        # The filter's share of each distance from the line, blurred by a splat.
        place = (t[:, None] * normal[0] + t * normal[1]).reshape(-1)
        shares = np.histogram(place, np.arange(-601, 602) / 100 + 0.005, weights=np.outer(within, within).reshape(-1))[
            0
        ]
        middle = np.arange(-600, 602) / 100
        expected = np.array([shares @ normal_below((e - middle) / own) for e in edge])
        total = np.hypot(own, PLACES.deviation)
        seen = np.array([weights @ normal_below((e - at @ normal) / total) for e in edge])
        assert np.abs(seen - expected).max() < 6e-3


def normal_below(x):
    return 0.5 * (1 + np.tanh(0.7978845608 * (x + 0.044715 * x**3)))


@pytest.mark.parametrize("depth", [0.3, 2.0])
def test_smoke_at_few_places_is_that_of_all_sub_samples(depth, monkeypatch):
    """A ball of voxels of half a pixel before a cube and the world."""
    ball = points(f"ball {depth}", voxels(1.0, 1.0, 28, depth, seen=lambda p: (p**2).sum(axis=1) < 0.25))
    cube = build.mesh(meshes.cube_mesh("cube behind", 0.3), "POLYGONS"), moved((0.2, 2, 0.1))
    scene = build.scene((ball, moved((0, 0, 0))), cube, world=World())
    few, all_of_them = both(scene, camera((0, -30, 0), field_of_view=8, resolution=SIZE), monkeypatch)
    assert 0 < np.abs(few - all_of_them).max() < 0.004 * all_of_them[..., :3].max()


def test_what_is_opaque_shows_through_thick_smoke_nowhere(monkeypatch):
    """Stripes as narrow as pixels, behind smoke through which nothing is seen."""
    smoke = points("thick", voxels(2.4, 1.2, 40, 25.0)), moved((0, 0, 0))
    floor = meshes.plane_mesh("stripes", 6.0, 1)
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.ones((1, 3)))
    glow = build.mesh(floor, "POLYGONS"), moved((0, 3, 0))
    eye = camera((0, -30, 0), field_of_view=3, resolution=SIZE)
    shown = drawn(build.scene(smoke, glow, lights=(), table=table, world=World()), eye)
    assert np.abs(shown[8:-8, 8:-8, :3]).max() < 1e-4


def some_splats(count=3000, seed=1):
    rng = np.random.default_rng(seed)
    centre = np.column_stack([rng.uniform(-20, 90, (count, 2)), rng.uniform(1, 2, count), rng.choice([0, 0.05], count)])
    spread = rng.uniform(0.1, 0.5, (count, 2)) ** 2
    shape = np.column_stack([spread[:, 0], np.zeros(count), spread[:, 1], np.ones(count)])
    return centre.astype(np.float32), shape.astype(np.float32)


def test_centres_miss_no_pixel_that_splats_touch():
    centre, shape = some_splats()
    point = 1.3, -2.6
    found = centres_of(centre, shape, point, SIZE)
    assert found is not None
    touched = touched_tiles(centre, shape, point, SIZE, 0.0, tile=1)
    inner = slice(found.reach, -found.reach)
    assert found.touched()[inner, inner][touched].all()
    pixels = np.zeros(SIZE[::-1], bool)
    pixels[10:12, 30:45] = True
    half = np.sqrt(SUPPORT * shape[:, [0, 2]])
    low, high = centre[:, :2] + point - half, centre[:, :2] + point + half
    reach = (centre[:, 3] > 0) & (low < (45, 12)).all(axis=1) & (high > (30, 10)).all(axis=1)
    near = found.near(pixels)
    assert np.isin(np.flatnonzero(reach), near).all()
    assert len(near) < 4 * reach.sum()  # measured: 2.0 times


def test_centres_are_of_small_splats_alone():
    centre, shape = some_splats()
    shape[np.flatnonzero(centre[:, 3] > 0)[5], 0] = (SMALL + 1) ** 2
    assert centres_of(centre, shape, (0.0, 0.0), SIZE) is None


def test_dense_splats_and_steep_depths_are_looked_at_in_each_sub_sample():
    centre, shape = some_splats()
    found = centres_of(centre, shape, (0.0, 0.0), SIZE)
    assert found is not None
    assert not steep_pixels(centre, shape, found, PLACES.steep).any()
    dense = np.flatnonzero((found.pixel >= 0) & (centre[:, 3] > 0))[7]
    more = centre.copy()
    more[dense, 3] = 2 * DENSE
    there = steep_pixels(more, shape, found, PLACES.steep)
    x, y = np.clip(centre[dense, :2].astype(int), 0, (SIZE[0] - 1, SIZE[1] - 1))
    assert there[y, x]
    assert there.sum() <= (2 * found.reach + 1) ** 2
    # Twenty layers of a wall that ends at x = 30: a depth of 3.6 beside none.
    y, x = (axis.reshape(-1) + 0.5 for axis in np.mgrid[0:48, 30:64])
    wall = np.column_stack([x, y, np.ones(len(x)), np.full(len(x), 0.15)]).astype(np.float32).repeat(20, axis=0)
    round_ones = np.tile(np.array([0.16, 0, 0.16, 1], np.float32), (len(wall), 1))
    found = centres_of(wall, round_ones, (0.0, 0.0), SIZE)
    assert found is not None
    there = steep_pixels(wall, round_ones, found, PLACES.steep)
    assert there[2:-2, 29].all()
    assert not there[2:-2, 34:60].any()


def test_pictures_of_few_sub_samples_have_no_fewer_places(monkeypatch):
    ball = points("ball of few", voxels(1.0, 1.0, 28, 1.0)), moved((0, 0, 0))
    scene = build.scene(ball, world=World())
    eye = camera((0, -30, 0), field_of_view=8, resolution=SIZE)
    few, all_of_them = both(scene, eye, monkeypatch, samples=4)
    assert np.array_equal(few, all_of_them)
    assert PLACES.lattice.count < MANY.count
