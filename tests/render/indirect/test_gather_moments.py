"""What is gathered once from all sides, for all that is in a cell, against closed forms; and which cells these are."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.moments import irradiance, lobes
from pointsplat_addon.core.indirect.surfels import Surfels, joined
from pointsplat_addon.core.indirect.tree import build_tree
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.frame.indirect.receivers import Groups, Receivers
from pointsplat_addon.render.frame.indirect.scattered import scattered_cells
from pointsplat_addon.render.indirect.light import BakedLight, IndirectLight
from pointsplat_addon.render.passes.indirect.pages import node_rows
from scripts.scenes import drawing
from tests.support.surfels import surfels_of

TURNED = np.random.default_rng(5).normal(size=(64, 3))
TURNED /= np.linalg.norm(TURNED, axis=1, keepdims=True)


def seen(surfels: Surfels, radiance: float, place: tuple[float, float, float], sky: float) -> np.ndarray:
    """(64, 24): moments at a place, once for each of TURNED; all sides of surfels send `radiance`."""
    tree = build_tree(surfels)
    sides = np.full((len(surfels), 3), radiance)
    baked = BakedLight(np.zeros(3), node_rows(tree, tree.radiance(surfels, sides, sides)), tree.cube)
    names = ("PS_HAS_WORLD",) if sky else ()
    light = IndirectLight(drawing.opengl().device, baked, World(np.full(3, sky)), names)
    found = light.moments(np.array([place]), {})
    light.release()
    return np.repeat(found.astype(float), len(TURNED), axis=0)


def plane(side: float, cells: int, axis: int = 2, at: float = 0.0, up: float = 1.0) -> Surfels:
    """A square across an axis, whose normals point up that, or down."""
    where = ((np.arange(cells) + 0.5) / cells - 0.5) * side
    first, second = (a.ravel() for a in np.meshgrid(where, where))
    position, normal = np.zeros((2, cells**2, 3))
    position[:, (axis + 1) % 3], position[:, (axis + 2) % 3], position[:, axis] = first, second, at
    normal[:, axis] = up
    return surfels_of(position, normal, np.array((side / cells) ** 2))


def test_surfaces_above_a_black_floor_see_half_a_sky():
    """Turned by an angle t from the zenith, a surface has (1 + cos t) / 2 of the sky. Found: off by 0.029 at most,
    0.013 on average, and by 0.0097 the open share of the sky."""
    found = seen(plane(400.0, 200), 0.0, (0.3, 0.2, 1.0), 1.0)
    expected = 0.5 * (1 + TURNED[:, 2])
    off = np.abs(irradiance(found, TURNED)[:, 0] - expected)
    assert off.max() < 0.035
    assert off.mean() < 0.016
    assert np.abs(lobes(found, TURNED, np.full(64, 1e-3))[:, 3] - 0.5).max() < 0.012


@pytest.mark.parametrize("high", [0.3, 0.6, 1.2])
def test_a_wall_fills_half_of_what_is_seen_beside_it(high):
    """Upright, so that half of each piece is seen in either hemisphere, or lying; of pieces a spacing wide, so many of
    these away. Found: 0.967 to 0.982; beside the upright one 0.70 to 0.85 where what only stands for surfaces near it
    does not rise above the horizon."""
    places = np.random.default_rng(2).uniform(-0.06, 0.06, (8, 3))
    for axis in (0, 2):
        wall, towards = plane(3.6, 60, axis), -np.eye(3)[axis]
        places[:, axis] = high * 0.06
        found = [irradiance(seen(wall, 1.0, tuple(place), 0.0)[:1], towards[None])[0, 0] for place in places]
        assert 0.955 < np.mean(found) < 1.0


def test_all_sides_of_a_closed_room_are_as_bright():
    """Walls that send 1, in a cube of 2: each surface within has an irradiance of pi, and each lobe shows 1. Found:
    off by 0.0136 and 0.0283 at most."""
    walls = joined([plane(2.0, 40, axis, at, -at) for axis in range(3) for at in (1.0, -1.0)])
    for place in ((0.0, 0.0, 0.0), (0.7, -0.5, 0.9)):
        found = seen(walls, 1.0, place, 0.0)
        bright, shown = irradiance(found, TURNED), lobes(found, TURNED, np.full(64, 8.0))
        assert np.abs(bright - 1).max() < 0.017
        assert np.abs(shown[:, :3] - 1).max() < 0.034


def groups_with(position: np.ndarray, normal: np.ndarray) -> tuple[Groups, Receivers]:
    count = len(position)
    rows, none = np.arange(count), np.zeros((0, 0, 2), np.float32)
    groups = Groups(np.zeros(3), position, normal.astype(np.float32), np.ones(count, np.float32), rows)
    return groups, Receivers(rows, np.zeros((count, 2), np.float32), np.full(count, -2.0), none)


def test_only_what_is_turned_all_ways_shares_a_gather():
    rng = np.random.default_rng(3)
    position = rng.uniform(-2, 2, (2000, 3))
    position[:, 2] = 0.01
    flat = np.tile([[0.0, 0.0, 1.0]], (2000, 1))
    assert len(scattered_cells(*groups_with(position, flat)).key) == 0
    corner = np.where(rng.random(2000)[:, None] < 0.5, flat, np.array([[1.0, 0.0, 0.0]]))
    assert len(scattered_cells(*groups_with(position, corner)).key) == 0
    normal = rng.normal(size=(2000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = scattered_cells(*groups_with(position, normal))
    level = np.full(2000, -1.0)
    within = (np.abs(position[:, :2]) < 1.4).all(axis=1)  # at the rim are cells of which few receivers are known
    assert found.hold(position[within], level[within]).all()
    # What is the same in all cells is so between them.
    at = found.between(position[within], level[within], np.ones((len(found.key), 3)))
    np.testing.assert_allclose(at, 1, rtol=1e-12)
