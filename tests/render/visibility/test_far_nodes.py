"""Nodes in place of the triangles of far instances, beside all of these triangles with many sub-samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.prepare.meshes import far
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render

SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
EYE = cameras.camera((0, -40, 12), (0, 0, 0), resolution=(96, 72), far=200, parallel=12.0)
MANY = 272  # sub-samples of a pixel


@pytest.fixture
def draws(monkeypatch):
    """Whether far instances are drawn as nodes, however few their triangles are: set by a call."""

    def set_to(nodes: bool) -> None:
        monkeypatch.setattr(far, "FEWEST_TRIANGLES", 0 if nodes else 1 << 60)
        opengl().store.clear()

    return set_to


RINGS = 52, 56, 64  # of balls of 10,608 to 16,128 triangles, which fall into cells in different ways


def crowd(rings: int = 64, cells: int = 6, distance: float = 2.0) -> Scene:
    """Balls, red above and blue below, in a square lattice."""
    ball = meshes.sphere_mesh(f"crowd of {rings}", rings)
    high = ball.position[ball.triangles].mean(axis=1)[:, 2] > 0
    ball = build.mesh(replace(ball, material=high.astype(np.uint16), materials=(0, 1)))
    at = distance * (np.arange(cells) - 0.5 * (cells - 1))
    things = [(ball, build.moved((x, y, 0), 0.8)) for x in at for y in at]
    table = build.materials(2, base_color=[[0.1, 0.2, 0.8], [0.8, 0.1, 0.1]])
    return build.scene(*things, table=table, transparent=True)


def foliage() -> Scene:
    """Crowns of 20,000 small leaves, turned every way."""
    rng = np.random.default_rng(0)
    middle = rng.normal(size=(20_000, 1, 3))
    middle /= np.linalg.norm(middle, axis=2, keepdims=True) / rng.random((20_000, 1, 1)) ** (1 / 3)
    position = (middle + 0.02 * rng.normal(size=(20_000, 3, 3))).reshape(-1, 3).astype(np.float32)
    crown = build.mesh(meshes.flat_mesh("crown", position, np.arange(60_000).reshape(-1, 3)))
    at = 2.5 * (np.arange(5) - 2)
    things = [(crown, build.moved((x, y, 0))) for x in at for y in at]
    return build.scene(*things, world=World(np.full(3, 0.5)), transparent=True)


def picture(draws, nodes: bool, scene: Scene, camera: Camera = EYE, samples: int = 17, **settings) -> np.ndarray:
    draws(nodes)
    result = render(Case(scene, camera, replace(SETTINGS, **settings)), frozenset({"combined"}), samples)
    points, triangles = result.report["points"]["drawn"], result.report["triangles"]
    assert (points > 0, triangles == 0) == (nodes, nodes)
    return result.pixels["combined"].astype(np.float64)


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2)))


@pytest.mark.parametrize("rings", RINGS)
def test_nodes_are_as_near_to_all_triangles_as_few_sub_samples_allow(rings, draws):
    """Beside 272 sub-samples of all triangles. RMSE of colour 0.0042 to 0.0055 (17 sub-samples of the triangles
    0.0021), of alpha at most 0.0073 (0.0073); the sum of alpha is off by at most 0.0018 of itself, that of blue, of
    which a rim is seen, by 0.024."""
    scene = crowd(rings)
    truth, found = picture(draws, False, scene, samples=MANY), picture(draws, True, scene)
    assert rmse(found[..., :3], truth[..., :3]) < 0.0065
    assert rmse(found[..., 3], truth[..., 3]) < 0.0085
    np.testing.assert_allclose(found.sum(axis=(0, 1)), truth.sum(axis=(0, 1)), rtol=0.03)
    np.testing.assert_allclose(found[..., 3].sum(), truth[..., 3].sum(), rtol=0.0025)


@pytest.mark.parametrize("rings", RINGS)
def test_closed_bodies_have_no_holes(rings, draws):
    """Within the silhouette less a pixel: 0.95 of a pixel at least, 0.9993 in the mean."""
    scene = crowd(rings)
    truth, found = picture(draws, False, scene, samples=MANY)[..., 3], picture(draws, True, scene)[..., 3]
    inside = np.ones_like(truth, bool)
    for y in (-1, 0, 1):
        for x in (-1, 0, 1):
            inside &= np.roll(truth, (y, x), (0, 1)) > 0.999
    assert inside.sum() > 1000
    assert found[inside].min() > 0.94
    assert found[inside].mean() > 0.999


def test_leaves_stay_triangles(draws):
    """Means of their normals would be brighter than they are."""
    draws(True)
    report = render(Case(foliage(), EYE, SETTINGS), frozenset({"combined"}), 17).report
    assert report["points"]["drawn"] == 0


def test_nodes_show_the_instances_and_materials_of_their_triangles(draws):
    """Where pixels are one instance's all over, and one material's: all but the 1 in 100 that the border of two colours
    crosses."""
    passes = frozenset({"combined", "object_index", "material_index"})
    found = []
    for nodes in (False, True):
        draws(nodes)
        found.append(render(Case(crowd(), EYE, SETTINGS), passes, 17).pixels)
    inside = found[0]["combined"][..., 3] > 0.999
    for name in ("object_index", "material_index"):
        assert (found[0][name][inside] == found[1][name][inside]).mean() > 0.9, name


def test_only_far_instances_are_nodes(draws):
    draws(True)
    near = cameras.camera((0, -9, 2), (0, 0, 0), resolution=(96, 72), far=200)
    report = render(Case(crowd(cells=12), near, SETTINGS), frozenset({"combined"}), 17).report
    assert report["points"]["drawn"] > 0
    assert report["triangles"] > 0
