"""Panes among captured splats: layers of triangles, between which these are as the published formula has them."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.passes.tiles import TILE
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved, points
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import random_splats
from scripts.scenes.clouds import smoke_cloud
from tests.reference import captured as reference

SENT = np.array([[0, 0, 0], [0.1, 0.4, 0.2], [0.7, 0.1, 0.3], [0.3, 0.6, 0.9]])  # by panes of each row, and a wall
ALPHAS = 1.0, 0.3, 0.5, 1.0
WALL = 3
EYE = camera((0, -6, 0), resolution=(96, 72), field_of_view=40)
NEAR, FAR = random_splats(300, 3, spread=0.25, seed=1), random_splats(300, 3, spread=0.25, seed=2)
CLOUDS = {-1.5: NEAR, 1.5: FAR}  # by their distance behind the middle
STACKS = {
    "before": [(-4.0, 1)],
    "between": [(0.0, 2)],
    "behind": [(4.0, 1)],
    "everywhere": [(-4.0, 2), (0.0, 1), (4.0, 2)],
    "two close together": [(0.0, 1), (0.001, 2)],
}


def pane(y: float, row: int, left: float = -9.0):
    corners = np.array([[left, 0, -9], [9, 0, -9], [9, 0, 9], [left, 0, 9]], np.float32)
    made = meshes.flat_mesh(f"pane {row} from {left}", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    return build.mesh(replace(made, materials=(row,)), "POLYGONS"), moved((0, y, 0))


def clouds():
    return [(captured(f"cloud at {y}", splats), moved((0, y, 0))) for y, splats in CLOUDS.items()]


def picture(*things, matte=None, **more):
    """The picture, (H, W, 4) float64, and the names of its passes. matte: which things are shadow catchers."""
    table = build.materials(
        4, base_color=np.zeros((4, 3)), specular=[0] * 4, emission=SENT, alpha=ALPHAS,
        translucent=np.array([alpha < 1 for alpha in ALPHAS]),
    )  # fmt: skip
    made = build.scene(*things, lights=(), table=table, world=World(), transparent=True, **more)
    if matte is not None:
        made = replace(made, instances=replace(made.instances, matte=np.array(matte)))
    request = Request(EYE, Settings(use_shadows=False), frozenset({"combined"}), 16)
    result = drawing.opengl().render(made, request)
    return result.pixels["combined"].astype(np.float64), {p["name"] for p in result.report["passes"]}


def expected(stack, wall: bool) -> np.ndarray:
    """What is seen of both clouds among panes, before a wall, (H, W, 4)."""
    layers = [(y, reference.picture([(splats, moved((0, y, 0)))], EYE)) for y, splats in CLOUDS.items()]
    layers += [(y, np.append(ALPHAS[row] * SENT[row], ALPHAS[row])) for y, row in stack]
    layers += [(6.0, np.append(SENT[WALL], 1.0))] if wall else []
    seen = np.zeros((*EYE.window[:1:-1], 4))
    for _, layer in sorted(layers, key=lambda one: one[0]):
        seen = seen + (1 - seen[..., 3:]) * layer
    return seen


@pytest.mark.parametrize("wall", [True, False])
@pytest.mark.parametrize("stack", STACKS)
def test_captured_splats_between_panes_are_those_of_the_published_formula(stack, wall):
    """Splats of which a pane lies within the reach are cut by it."""
    behind = (pane(6.0, WALL),) if wall else ()
    found, passes = picture(*(pane(*one) for one in STACKS[stack]), *clouds(), *behind)
    assert "compose" in passes  # they are layers of triangles
    truth = expected(STACKS[stack], wall)
    assert reference.psnr(found, truth) > 100  # measured 107.9, and 138 where no splat reaches a pane
    assert np.abs(found - truth).max() < 1e-3  # measured 2.7e-4


def test_a_panes_edge_shares_pixels():
    """A pixel that the edge crosses shows both sides by their shares, as where there are no splats."""
    left = 0.013
    found, _ = picture(pane(0.0, 2, left), *clouds(), pane(6.0, WALL))
    alone, _ = picture(pane(0.0, 2, left), pane(6.0, WALL))
    share = (alone[..., 2] - SENT[WALL, 2]) / (ALPHAS[2] * (SENT[2, 2] - SENT[WALL, 2]))
    assert (abs(share - 0.5) < 0.45).any()
    open_side, covered = (expected(stack, True) for stack in ([], [(0.0, 2)]))
    truth = open_side + share[..., None] * (covered - open_side)
    assert np.abs(found - truth).max() < 1e-3  # measured 3.7e-4


def test_edges_away_from_panes_are_as_they_are_without_them():
    """Where no pane is near, what is opaque keeps the pixel filter."""
    cube = build.mesh(meshes.cube_mesh("cube among captured and panes", 0.5), "POLYGONS"), moved((-0.9, 0, 0))
    with_pane, passes = picture(pane(-4.0, 1, 0.3), *clouds(), cube)
    without, _ = picture(*clouds(), cube)
    assert "compose" in passes
    assert "difference" in passes
    first = int(48 + EYE.pixel_from_view()[0] * 0.3 / 2)  # of the pixels that show the pane
    away = (first // TILE - 1) * TILE
    assert np.abs(with_pane - without)[:, :away].max() < 1e-6  # measured 3.0e-7
    assert np.abs(with_pane - without)[:, first + 3 :].max() > 0.05


def test_edges_behind_panes_are_filtered_where_no_splat_is():
    """As they are without captured splats, and not as wide as a pixel."""
    cube = build.mesh(meshes.cube_mesh("cube behind a pane", 0.4), "POLYGONS"), moved((1.2, 0.3, 0.1))
    pane_and_cube = pane(-4.0, 1), cube
    found, passes = picture(*pane_and_cube, *clouds())
    alone, _ = picture(*pane_and_cube)
    free = sum(reference.picture([(splats, moved((0, y, 0)))], EYE)[..., 3] for y, splats in CLOUDS.items()) == 0
    rims = np.abs(np.diff(alone[..., 3], axis=1, prepend=0)) > 0.02
    assert "compose" in passes
    assert (free & rims).sum() > 20
    assert np.abs(found - alone)[free].max() < 1e-6  # measured 6.0e-8


@pytest.mark.parametrize("which", ["coloured smoke", "a hole", "a shadow catcher"])
def test_beside_these_panes_are_splats(which):
    """Of which no layers of triangles are drawn among captured splats."""
    things = [pane(0.0, 2), *clouds()]
    more = {}
    if which == "coloured smoke":
        things.append((points("coloured smoke beside captured", smoke_cloud(6, (0.5, 1.0, 3.0))), moved()))
    elif which == "a hole":
        more["holdout"] = [False, True, False]
    else:
        things.append((build.mesh(meshes.cube_mesh("catcher beside captured", 0.3), "POLYGONS"), moved()))
        more["matte"] = [False, False, False, True]
    found, passes = picture(*things, **more)
    assert "compose" not in passes
    assert np.isfinite(found).all()
    assert found[36, 5, 3] == pytest.approx(0.5, abs=1e-3)  # the pane alone; measured 2.6e-5
