"""Panes before, within and behind smoke and points: layers of triangles among splats, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.passes.translucent.strata import splats_over
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from tests.support.transmittance import voxels

COMBINED = frozenset({"combined"})
SENT = np.array([[0, 0, 0], [0.1, 0.4, 0.2], [0.7, 0.1, 0.3], [0.3, 0.6, 0.9]])  # by panes of each row, and a wall
ALPHAS = 1.0, 0.3, 0.5, 1.0
WALL = 3
SOURCE = np.array([0.5, 0.2, 0.9])  # of a thick smoke
EYE = camera((0, -30, 0), field_of_view=2, resolution=(64, 48))
STACKS = {
    "before": [(-1.0, 1)],
    "behind": [(1.0, 1)],
    "within": [(0.1, 1)],
    "two within": [(-0.2, 1), (0.3, 2)],
    "everywhere": [(-0.6, 2), (-0.2, 1), (0.0, 1), (0.3, 2), (1.0, 1)],
}


def pane(y: float, row: int, left: float = -8.0):
    corners = np.array([[left, 0, -8], [8, 0, -8], [8, 0, 8], [left, 0, 8]], np.float32)
    made = meshes.flat_mesh(f"pane {row} from {left}", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    return build.mesh(replace(made, materials=(row,)), "POLYGONS"), moved((0, y, 0))


def smoke(cells: int, depth: np.ndarray):
    even = float(depth[0]) if np.ptp(depth) == 0 else depth
    return points(f"smoke {cells} {depth}", voxels(2.4, 1.0, cells, even, emission=tuple(SOURCE * depth))), moved(
        (0, 0, 0)
    )


def picture(*things, samples=16, interactive=False, **more):
    table = build.materials(
        4, base_color=np.zeros((4, 3)), specular=[0] * 4, emission=SENT, alpha=ALPHAS,
        translucent=np.array([alpha < 1 for alpha in ALPHAS]),
    )  # fmt: skip
    made = build.scene(*things, lights=(), table=table, world=World(), transparent=True, **more)
    settings = Settings(technique="VISIBILITY", use_shadows=False, adaptive_threshold=0.0)
    result = drawing.opengl().render(made, Request(EYE, settings, COMBINED, samples, interactive=interactive))
    return result.pixels["combined"].astype(np.float64), {p["name"] for p in result.report["passes"]}


def expected(stack, depth: np.ndarray, wall: bool) -> np.ndarray:
    """What is seen of smoke from -0.5 to 0.5, among panes, before a wall: RGB, and alpha by the channels' mean."""
    light, passed, at = np.zeros(3), np.ones(3), -9.0
    for y, row in [*stack, (9.0, WALL if wall else None)]:
        through = np.exp(-depth * max(min(y, 0.5) - max(at, -0.5), 0))
        light, passed, at = light + passed * SOURCE * (1 - through), passed * through, y
        if row is not None:
            light, passed = light + passed * ALPHAS[row] * SENT[row], passed * (1 - ALPHAS[row])
    return np.append(light, 1 - passed.mean())


@pytest.mark.parametrize("depth", [np.full(3, 1.0), np.array([0.3, 1.0, 3.0])], ids=["grey", "coloured"])
@pytest.mark.parametrize("cells", [8, 40], ids=["wide", "narrow"])
@pytest.mark.parametrize("wall", [True, False])
@pytest.mark.parametrize("stack", STACKS)
def test_smoke_between_panes_counts_where_it_is(stack, wall, cells, depth):
    behind = (pane(3.0, WALL),) if wall else ()
    found, passes = picture(*(pane(*one) for one in STACKS[stack]), smoke(cells, depth), *behind)
    assert "compose" in passes  # they are layers of triangles
    error = found - expected(STACKS[stack], depth, wall)
    assert np.abs(error).max() < 2e-3  # measured 1.9e-3; of smoke without panes 2.0e-3
    assert np.abs(error.mean(axis=(0, 1))).max() < 5e-4  # measured 3.5e-4


@pytest.mark.parametrize("cells", [8, 40], ids=["wide", "narrow"])
def test_the_edge_of_a_pane_within_smoke_shares_pixels(cells):
    """A pixel that the edge crosses shows both sides by their shares, as where there is no smoke."""
    depth, left = np.full(3, 1.0), 0.0037
    found, _ = picture(pane(0.1, 2, left), smoke(cells, depth), pane(3.0, WALL))
    alone, _ = picture(pane(0.1, 2, left), pane(3.0, WALL))
    sides = np.array([expected(stack, depth, True) for stack in ([], [(0.1, 2)])])[:, :3]
    bare = np.array([expected(stack, np.zeros(3), True) for stack in ([], [(0.1, 2)])])[:, :3]
    share = (alone[..., 2] - bare[0, 2]) / (bare[1, 2] - bare[0, 2])
    assert ((share > 0.05) & (share < 0.95)).any()
    truth = sides[0] + share[..., None] * (sides[1] - sides[0])
    assert np.abs(found[..., :3] - truth).max() < 1.5e-3  # measured 9.6e-4


@pytest.mark.parametrize("cells", [8, 40], ids=["wide", "narrow"])
def test_a_first_picture_in_motion_is_near(cells):
    """Its splats are drawn at half the size."""
    things = [pane(0.1, 2, 0.0), smoke(cells, np.full(3, 1.0)), pane(3.0, WALL)]
    (coarse, _), (fine, _) = picture(*things, samples=5, interactive=True), picture(*things, samples=5)
    assert 0 < np.abs(coarse - fine).mean() < 1e-3  # measured 3.0e-4


def test_a_smoke_that_is_held_out_leaves_panes_to_splats():
    things = pane(1.0, 2), smoke(8, np.full(3, 2.0)), pane(3.0, WALL)
    found, passes = picture(*things, holdout=(False, True, False))
    bare = expected([(1.0, 2)], np.zeros(3), True)
    assert "compose" not in passes
    assert np.abs(found - bare * np.exp(-2.0)).max() < 2e-3  # measured 7.8e-4


def test_splats_over_tiles_are_those_whose_boxes_touch_them():
    random = np.random.default_rng(3)
    tiles = random.random((5, 7)) > 0.8
    centre = np.concatenate(
        [random.uniform(-60, 160, (500, 2)), np.ones((500, 1)), random.integers(0, 2, (500, 1))], axis=1
    )
    shape = np.tile([4.0, 0.0, 9.0, 36.0], (500, 1)).astype(np.float32)
    found = splats_over(tiles, centre.astype(np.float32), shape, (3.0, -2.0))
    half = 3.5 * np.array([2.0, 3.0])
    for index in range(500):
        low, high = centre[index, :2] + (3.0, -2.0) - half, centre[index, :2] + (3.0, -2.0) + half
        touched = any(
            (low < 16.0 * (np.array(at[::-1]) + 1)).all() and (high >= 16.0 * np.array(at[::-1])).all()
            for at in np.argwhere(tiles)
        )
        assert (index in found) == (touched and centre[index, 3] > 0)
