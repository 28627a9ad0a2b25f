"""Shadows of panes by layers of depth maps: shares of light against closed forms, and what is left to tables."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.prepare.separation import separate_translucent
from pointsplat_addon.render.shadow import panes
from pointsplat_addon.render.shadow.shadows import Shadows, make_shadows
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

ALPHAS = 1.0, 0.5, 0.3, 0.8  # of the floor, and of panes
MIDDLES = np.array([[0.0, 0.0, 2.0], [0.3, 0.1, 2.5], [-0.2, 0.4, 3.0]])
HALF = 0.6  # of a pane's side
DOWN = np.array([0.0, 0.0, -1.0])
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
LIGHTS = {
    "sun": build.sun(3.0, (0.2, -0.1, -1.0)),
    "point": Light("POINT", np.full(3, 300.0), np.array([0.2, -0.3, 6.0]), DOWN),
    "spot": Light("SPOT", np.full(3, 300.0), np.array([0.2, -0.3, 6.0]), DOWN, spot_cos=0.9, spot_blend=0.0),
    "among panes": Light("POINT", np.full(3, 100.0), np.array([0.5, 0.1, 2.7]), DOWN),
}
EDGE = 0.2  # on the floor: what the filter of a pixel reaches


def table(**more):
    return build.materials(4, alpha=ALPHAS, translucent=np.array([a < 1 for a in ALPHAS]), **more)


def pane(middle, row: int, half: float = HALF):
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], np.float32)
    made = meshes.flat_mesh(f"pane of {row}, {half}", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    return build.mesh(replace(made, materials=(row,)), "POLYGONS"), build.moved(middle)


def floor():
    return build.mesh(meshes.plane_mesh("floor below panes", 4.0), "POLYGONS"), LAID


def case(*things, light: Light, materials=None) -> Case:
    """Seen from below all panes."""
    scene = build.scene(floor(), *things, lights=[light], table=materials or table())
    camera = cameras.camera((0.0, -3.0, 1.6), resolution=(96, 72))
    return Case(scene, camera, Settings(technique="VISIBILITY", use_adaptive_sampling=False))


def shares(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Which share of the light without shadows there is, and where, (N,) and (N, 3): of what is lit."""
    seen = [
        render(one, frozenset({"combined", "position"}), 16).pixels
        for one in (
            case,
            replace(case, settings=replace(case.settings, use_shadows=False)),
            replace(case, scene=replace(case.scene, lights=())),
        )
    ]
    lit, without, dark = (pixels["combined"][..., 0].astype(float) for pixels in seen)
    bright = without - dark > 1e-2
    return ((lit - dark)[bright] / (without - dark)[bright]), seen[0]["position"][bright][:, :3].astype(float)


def crossed(place: np.ndarray, light: Light, middle: np.ndarray) -> np.ndarray:
    """Whether the way from places (N, 3) to the light goes through a pane."""
    way = -light.direction / np.linalg.norm(light.direction) if light.kind == "SUN" else light.position - place
    way = np.broadcast_to(way, place.shape)
    along = (middle[2] - place[:, 2]) / way[:, 2]
    there = place + along[:, None] * way - middle
    return (np.abs(there[:, :2]) < HALF).all(axis=1) & (along > 0) & ((along < 1) | (light.kind == "SUN"))


def expected(place: np.ndarray, light: Light) -> np.ndarray:
    through = [1 - alpha * crossed(place, light, middle) for alpha, middle in zip(ALPHAS[1:], MIDDLES, strict=True)]
    return np.prod(through, axis=0)


def found_shadows(case: Case) -> Shadows:
    scene, _ = separate_translucent(case.scene, Store())
    found, _ = make_shadows(scene, case.settings, Store())
    assert found is not None
    return found


@pytest.mark.parametrize("name", LIGHTS)
def test_panes_behind_each_other_multiply_what_they_let_through(name):
    light = LIGHTS[name]
    drawn = case(*(pane(middle, row) for row, middle in enumerate(MIDDLES, 1)), light=light)
    share, place = shares(drawn)
    around = np.array([(x, y, 0) for x in (-EDGE, 0, EDGE) for y in (-EDGE, 0, EDGE)])
    near = np.array([expected(place + offset, light) for offset in around])
    even = np.ptp(near, axis=0) == 0
    assert len(np.unique(np.round(near[4], 6))) >= 2  # shares of light; with lights above all panes 8
    assert even.mean() > 0.4
    assert np.abs(share - near[4])[even].max() < 1e-4  # measured 3e-7
    # Where edges cross pixels, their centres are compared.
    assert abs((share - near[4]).mean()) < 4e-3  # measured 2.2e-3


def test_what_lies_between_panes_is_shaded_by_those_above_it():
    light = LIGHTS["sun"]
    between = meshes.flat_mesh(
        "card between panes", np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )  # fmt: skip
    card = build.mesh(between, "POLYGONS"), build.moved((0, 0, 0.3))
    drawn = case(pane((0, 0, 0.1), 1, 8.0), pane((0, 0, 3.0), 2, 8.0), card, light=light)
    share, place = shares(drawn)
    on_card = (np.abs(place[:, :2]) < 0.9).all(axis=1) & (place[:, 2] > 0.2)
    assert on_card.sum() > 300
    np.testing.assert_allclose(share[on_card], 1 - ALPHAS[2], atol=1e-3)


@pytest.mark.parametrize("count", [1, 4, panes.MOST_LAYERS])
def test_as_many_layers_are_drawn_as_panes_lie_behind_each_other(count):
    light = LIGHTS["sun"]
    drawn = case(*(pane((0.01 * i, 0, 2 + 0.1 * i), 2, 5.0) for i in range(count)), light=light)
    found = found_shadows(drawn)
    assert found.tables is None
    assert found.panes is not None
    assert found.panes.layers == count
    share, _ = shares(drawn)
    np.testing.assert_allclose(share, (1 - ALPHAS[2]) ** count, atol=1e-3)


def test_tables_hold_what_is_no_pane():
    sun, stack = LIGHTS["sun"], [pane((0, 0, 2 + 0.1 * i), 2) for i in range(panes.MOST_LAYERS + 1)]
    graph = MaterialGraph(alpha=color_nodes.Component(texture_nodes.ImageTexture(input_nodes.UV(), build.picture()), 0))
    varies = table(graphs=(None, None, graph, None))
    for drawn in (
        case(*stack, light=sun),
        case(stack[0], light=sun, materials=varies),
        case(stack[0], light=replace(sun, radius=0.1)),
    ):
        found = found_shadows(drawn)
        assert found.panes is None
        assert found.tables is not None
    assert found_shadows(case(stack[0], light=sun)).panes is not None
