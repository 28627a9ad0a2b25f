"""Nodes over balls: their moments, their levels, and the cut through them."""

from __future__ import annotations

import numpy as np
import pytest

from pointsplat_addon.core.lod.balls.cut import EDGE, cut_balls
from pointsplat_addon.core.lod.balls.tree import (
    BALLS,
    MOST_SATURATION,
    SPREAD,
    BallTree,
    build_ball_tree,
    saturation,
)
from pointsplat_addon.core.numeric.morton import morton_codes, sorted_by_code
from pointsplat_addon.core.scene.cloud import PointCloud
from scripts.scenes import build, cameras


def cloud(count: int = 5000, seed: int = 0, **more) -> PointCloud:
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(count, 3)).astype(np.float32)
    radii = rng.uniform(0.001, 0.02, (count, 1)).astype(np.float32)
    return PointCloud(position, radii=radii, color=rng.random((count, 3), np.float32), **more)


@pytest.fixture(scope="module")
def tree() -> BallTree:
    return build_ball_tree(cloud(origin=np.array([1e6, 0, -3.0]), material=np.arange(5000).astype(np.uint16)))


def test_balls_lie_in_the_order_of_their_cells():
    position = cloud().position
    code, side = morton_codes(position)
    order, found = sorted_by_code(code)
    np.testing.assert_array_equal(found, np.sort(code))
    np.testing.assert_array_equal(code[order], found)
    assert side >= np.ptp(position, axis=0).max()


def test_each_level_holds_all_balls_once_and_refines_the_one_above(tree):
    assert len(tree.first[-1]) - 1 <= len(tree.cloud) / BALLS
    for level, first in enumerate(tree.first):
        assert first[0] == 0
        assert first[-1] == len(tree.cloud)
        assert (np.diff(first) > 0).all()
        if level:
            assert np.isin(tree.first[level - 1], first).all()
    assert len(tree) == tree.start[-1]


def test_nodes_have_the_moments_the_area_and_the_mean_colour_of_their_balls(tree):
    """Float64 sums over each node's balls, one by one."""
    position, radius = tree.cloud.position.astype(np.float64), tree.cloud.radii[:, 0].astype(np.float64)
    rng = np.random.default_rng(1)
    for level, first in enumerate(tree.first):
        for cell in rng.integers(0, len(first) - 1, 5):
            balls, node = slice(first[cell], first[cell + 1]), tree.start[level] + cell
            weight = radius[balls] ** 2
            mean = np.average(position[balls], axis=0, weights=weight)
            away = position[balls] - mean
            shape = SPREAD * (weight[:, None] * away).T @ away / weight.sum() + np.average(
                weight, weights=weight
            ) * np.eye(3)
            np.testing.assert_allclose(tree.nodes.position[node], mean, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(tree.shape[node, :6], shape[np.triu_indices(3)], rtol=1e-5, atol=1e-7)
            np.testing.assert_allclose(tree.shape[node, 6], np.pi * weight.sum(), rtol=1e-6)
            color = np.average(tree.cloud.color[balls], axis=0, weights=weight)
            np.testing.assert_allclose(tree.nodes.color[node], color, rtol=1e-5)
            assert tree.nodes.material[node] in tree.cloud.material[balls]


def test_a_cell_is_no_wider_than_its_edge(tree):
    for level, first in enumerate(tree.first):
        low = np.minimum.reduceat(tree.cloud.position, first[:-1])
        high = np.maximum.reduceat(tree.cloud.position, first[:-1])
        assert (high - low).max() <= tree.edge[level] * (1 + 1e-5)


@pytest.mark.parametrize("count", [1, 3, 100])
def test_few_balls_and_balls_at_one_place_have_nodes_too(count):
    one = PointCloud(np.full((count, 3), 2.0, np.float32), radii=np.full((count, 1), 0.5, np.float32))
    tree = build_ball_tree(one)
    ball = np.tile([0.25, 0, 0, 0.25, 0, 0.25], (len(tree), 1))
    np.testing.assert_allclose(tree.shape[:, :6], ball, atol=1e-12)
    np.testing.assert_allclose(tree.shape[:, 6], count * np.pi / 4, rtol=1e-6)


def test_saturation_tells_regular_balls_from_random_ones():
    rng = np.random.default_rng(2)
    grid = np.stack(np.meshgrid(np.arange(200.0), np.arange(200.0)), axis=-1).reshape(-1, 2)

    def of(plane: np.ndarray) -> float:
        tree = build_ball_tree(PointCloud(np.column_stack([plane, 0 * plane[:, 0]]).astype(np.float32),
                                          radii=np.ones((len(plane), 1), np.float32)))  # fmt: skip
        return saturation(tree.cloud.position)

    random, jittered = of(rng.uniform(0, 200, grid.shape)), of(grid + rng.uniform(-0.5, 0.5, grid.shape))
    assert random < 0.1  # measured 0.06
    assert 0.5 < jittered < 0.85, jittered
    assert of(grid + rng.uniform(-0.1, 0.1, grid.shape)) == MOST_SATURATION


def covered_balls(tree: BallTree, cut, instance: int) -> np.ndarray:
    """How often each ball is drawn by an instance, itself or as part of a node."""
    drawn = np.zeros(len(tree.cloud), int)
    for at, first, count in zip(cut.balls.instance, cut.balls.first, cut.balls.count, strict=True):
        if at == instance:
            drawn[first : first + count] += 1
    for at, first, count in zip(cut.nodes.instance, cut.nodes.first, cut.nodes.count, strict=True):
        if at == instance:
            for node in range(first, first + count):
                level = int(np.searchsorted(tree.start, node, side="right")) - 1
                cell = node - tree.start[level]
                drawn[tree.first[level][cell] : tree.first[level][cell + 1]] += 1
    return drawn


@pytest.mark.parametrize("distance", [8.0, 40.0, 400.0])
def test_a_cut_draws_each_ball_once(distance):
    tree = build_ball_tree(cloud())
    camera = cameras.camera((0, -distance, 0), far=1e4)
    found = cut_balls(tree, camera.view_from_world[None], camera, 1.0)
    np.testing.assert_array_equal(covered_balls(tree, found, 0), 1)
    assert found.nodes.splats + found.balls.splats == found.nodes.nodes + found.balls.points
    assert (found.balls.splats == 0) == (distance > 10)


def test_cells_of_nodes_are_no_wider_on_the_screen_than_the_tolerance():
    tree = build_ball_tree(cloud())
    camera = cameras.camera((0, -30, 0), resolution=(400, 400))
    found = cut_balls(tree, camera.view_from_world[None], camera, 16.0)
    node = np.concatenate([np.arange(a, a + n) for a, n in zip(found.nodes.first, found.nodes.count, strict=True)])
    level = np.searchsorted(tree.start, node, side="right") - 1
    depth = tree.nodes.position[node, 1] + 30.0
    width = tree.edge[level] * camera.pixel_from_view()[0] / depth
    assert width.max() <= 16.0 * EDGE
    assert width.max() > 8.0 * EDGE


def test_what_is_out_of_view_is_left_out_and_all_that_is_in_view_stays():
    tree = build_ball_tree(cloud(300_000))
    camera = cameras.camera((0.5, -1.5, 0), resolution=(200, 200), field_of_view=30)
    found = cut_balls(tree, camera.view_from_world[None], camera, 1.0)
    drawn = covered_balls(tree, found, 0)
    view = tree.cloud.position @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
    slope = np.abs(view[:, :2]).max(axis=1) / np.maximum(-view[:, 2], 1e-9)
    seen = (view[:, 2] < -camera.near) & (slope < np.tan(np.radians(15)))
    assert (drawn[seen] == 1).all()
    assert drawn.max() == 1
    assert drawn.sum() < 3 * seen.sum() < len(drawn)


def test_instances_take_their_own_levels_and_those_without_a_transform_draw_nothing():
    tree = build_ball_tree(cloud())
    camera = cameras.camera((0, -10, 0), far=1e4)
    world = [build.moved((0, y, 0)) for y in (0.0, 60.0, 600.0)]
    world += [np.full((4, 4), np.nan), np.zeros((4, 4))]
    found = cut_balls(tree, camera.view_from_world @ np.array(world), camera, 1.0)
    drawn = [int(found.nodes.count[found.nodes.instance == i].sum()) for i in range(5)]
    assert drawn[1] > drawn[2] > 0
    assert drawn[3:] == [0, 0]
    assert not np.isin(found.balls.instance, [3, 4]).any()
    for i in range(3):
        np.testing.assert_array_equal(covered_balls(tree, found, i), 1)
