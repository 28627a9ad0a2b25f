"""Which parts of a mesh are points, which are triangles, and at which spacing."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod.cost import MAX_SAMPLES_RATIO, OVERLAP, Costs, choose_primitives, mask_runs

COSTS = Costs(point=10.0, pixel=1.0, triangle=100.0, fragment=1.0, draw=1.0).again_and_again()
INF = np.inf


def chosen(needed, spacing, samples, triangles=None, costs=COSTS):
    needed = np.asarray(needed, float)
    triangles = np.full(len(needed), 10.0) if triangles is None else np.asarray(triangles, float)
    return choose_primitives(
        costs, needed, np.asarray(spacing), np.asarray(samples, float), triangles, np.zeros(len(needed))
    )


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
    assert chosen(needed, [1.0], samples, costs=replace(COSTS, draw=saved - 1)).points.any()
    assert not chosen(needed, [1.0], samples, costs=replace(COSTS, draw=saved)).points.any()


def test_what_is_prepared_once_counts():
    # Fifty points spare half of ten triangles: 500, of which preparing them takes away its share.
    assert chosen([1.0], [1.0], [[50]], costs=replace(COSTS, prepared=9.9)).points.all()
    assert not chosen([1.0], [1.0], [[50]], costs=replace(COSTS, prepared=10.0)).points.any()


def test_samples_are_prepared_of_what_is_out_of_view_too():
    costs = replace(COSTS, prepared=3.0)
    assert chosen([1.0, INF], [1.0], [[50, 50]], costs=costs).cost == 50 * 10 + 100 * 3
    assert not chosen([1.0, INF, INF, INF], [1.0], [[50, 50, 50, 50]], costs=costs).points.any()


def test_a_mesh_is_uploaded_as_a_whole_where_any_triangle_is_drawn():
    costs = replace(COSTS, uploaded=7.0)
    found = chosen([1.0, 1.0], [1.0], [[50, 150]], costs=costs)
    assert found.points.tolist() == [True, False]
    assert found.cost == 50 * 10 + 10 * 100 + 20 * 7
    assert found.triangles_cost == 20 * 100 + 20 * 7
    # Without any triangle it is spared. That weighs against the triangles of the whole, not part by part.
    assert chosen([1.0, 1.0], [1.0], [[50, 50]], costs=costs).cost == 100 * 10


def test_points_of_many_samples_have_to_be_cheaper_than_triangles_of_fewer():
    costs = Costs(point=10.0, triangle=100.0, draw=1.0, prepared=1e-9, uploaded=1e-9)
    for samples, factor in ((1, 1), (2, 2), (4, MAX_SAMPLES_RATIO), (64, MAX_SAMPLES_RATIO)):
        assert chosen([1.0], [1.0], [[99 / factor]], costs=costs.of_picture(samples)).points.all()
        assert not chosen([1.0], [1.0], [[101 / factor]], costs=costs.of_picture(samples)).points.any()
    assert chosen([1.0], [1.0], [[99]], costs=costs.again_and_again()).points.all()


def test_what_is_done_once_is_shared_by_samples_and_instances():
    costs = Costs(prepared=600.0, uploaded=800.0)
    one, many, instances = (
        costs.of_picture(MAX_SAMPLES_RATIO),
        costs.of_picture(16 * MAX_SAMPLES_RATIO),
        costs.of_picture(MAX_SAMPLES_RATIO, 16),
    )
    assert one.prepared == 600
    assert many.prepared == instances.prepared == 600 / 16
    assert many.uploaded == instances.uploaded == 800 / 16
    assert costs.of_picture(1) == costs


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
    first, count = mask_runs(np.array([1, 1, 0, 0, 1, 0, 1, 1, 1], bool))
    assert first.tolist() == [0, 4, 6]
    assert count.tolist() == [2, 1, 3]
    assert len(mask_runs(np.zeros(3, bool))[0]) == 0


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_costs_are_positive_numbers(bad):
    assert Costs().valid()
    assert not Costs(point=bad).valid()
