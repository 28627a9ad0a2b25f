"""Which parts of a mesh are points, which are triangles, and at which spacing."""

import numpy as np
import pytest

from pointsplat_addon.core.cost import OVERLAP, Costs, choose, runs

COSTS = Costs(point=10.0, pixel=1.0, triangle=100.0, fragment=1.0, draw=1.0)
INF = np.inf


def chosen(needed, spacing, samples, triangles=None, costs=COSTS):
    needed = np.asarray(needed, float)
    triangles = np.full(len(needed), 10.0) if triangles is None else np.asarray(triangles, float)
    return choose(costs, needed, np.asarray(spacing), np.asarray(samples, float), triangles, np.zeros(len(needed)))


def test_a_part_is_what_costs_less():
    # Ten triangles cost as much as a hundred points.
    found = chosen([1.0, 1.0], [1.0], [[50, 150]])
    assert found.points.tolist() == [True, False]
    assert found.polygons.tolist() == [False, True]
    assert found.cost == 50 * 10 + 10 * 100
    assert found.triangles_cost == 20 * 100


def test_parts_that_need_finer_samples_than_there_are_stay_triangles():
    found = chosen([0.5, 1.0, 2.0], [1.0], [[20, 20, 20]])
    assert found.points.tolist() == [False, True, True]
    assert found.polygons.tolist() == [True, False, False]


def test_where_points_and_triangles_meet_parts_are_both():
    found = chosen([1 - 0.9 * OVERLAP, 1 - 1.1 * OVERLAP, 1.0], [1.0], [[20, 20, 20]])
    assert found.points.tolist() == [True, False, True]
    assert found.polygons.tolist() == [True, True, False]


def test_what_is_out_of_view_is_neither():
    found = chosen([INF, 1.0], [1.0], [[20, 20]])
    assert not found.points[0]
    assert not found.polygons[0]
    assert found.cost == 200


def test_the_octave_is_that_at_which_all_parts_together_cost_least():
    needed, samples = [1.0, 2.0, 2.0, 2.0], [[80, 80, 80, 80], [20, 20, 20, 20]]
    # One part of triangles is cheaper than four times the points everywhere.
    assert chosen(needed, [1.0, 2.0], samples).octave == 1
    # With ten times as many triangles it is not.
    assert chosen(needed, [1.0, 2.0], samples, [100, 10, 10, 10]).octave == 0


def test_an_object_that_saves_less_than_its_second_draw_costs_is_not_split():
    needed, samples = [0.5, 1.0], [[20, 20]]
    saved = 10 * 100 - 20 * 10
    assert chosen(needed, [1.0], samples, costs=Costs(10, 1, 100, 1, saved - 1)).points.any()
    assert not chosen(needed, [1.0], samples, costs=Costs(10, 1, 100, 1, saved)).points.any()


@pytest.mark.parametrize("octaves", [1, 3])
def test_the_choice_is_never_dearer_than_triangles_alone(octaves):
    rng = np.random.default_rng(octaves)
    spacing = 2.0 ** np.arange(octaves)
    for _ in range(100):
        needed = np.where(rng.random(40) < 0.2, INF, 4 * rng.random(40) + 0.1)
        samples = 400 * rng.random(40) / spacing[:, None] ** 2
        found = chosen(needed, spacing, samples, rng.integers(1, 30, 40))
        assert found.cost <= found.triangles_cost
        assert (found.points | found.polygons).tolist() == np.isfinite(needed).tolist()


def test_runs_of_a_mask():
    first, count = runs(np.array([1, 1, 0, 0, 1, 0, 1, 1, 1], bool))
    assert first.tolist() == [0, 4, 6]
    assert count.tolist() == [2, 1, 3]
    assert len(runs(np.zeros(3, bool))[0]) == 0


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_costs_are_positive_numbers(bad):
    assert Costs().valid()
    assert not Costs(point=bad).valid()
