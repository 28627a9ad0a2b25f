"""Facts about the back-to-front order: exact to the slice, stable within, and good for as long as it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pointsplat_addon.core.lod import depth_order, hierarchy, node_splats
from pointsplat_addon.core.lod.cut import Cut, cut_of_all_points
from pointsplat_addon.core.scene.cloud import PointCloud


def expected(depth: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows back to front and their slices, by a comparison sort on (slice, row)."""
    rows = np.flatnonzero(np.isfinite(depth))
    d = depth[rows].astype(np.float64)
    number = np.floor((d.max(initial=-np.inf) - d) / thickness)
    found = np.lexsort((rows, number))
    return rows[found], number[found]


def check(depth: np.ndarray, smallest: float) -> depth_order.Slices:
    slices = depth_order.back_to_front(depth, smallest)
    index, number = expected(depth, slices.thickness)
    np.testing.assert_array_equal(slices.index, index)
    np.testing.assert_array_equal(slices.slice, number)
    assert slices.slice.dtype == np.uint32
    return slices


@settings(deadline=None, max_examples=300)
@given(
    depth=hnp.arrays(
        st.sampled_from([np.float32, np.float64]),
        st.integers(0, 200),
        elements=st.one_of(
            st.floats(width=32), st.integers(-5, 5).map(float), st.floats(-1, 1, width=32), st.just(np.nan)
        ),
    ),
    smallest=st.one_of(st.sampled_from([0.0, 1e-9, 1e-3, 1.0, 1e9, np.inf, np.nan, -1.0]), st.floats(1e-12, 1e12)),
)
def test_slices_equal_a_lexicographic_sort(depth: np.ndarray, smallest: float) -> None:
    check(depth, smallest)


@pytest.mark.parametrize("extent", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("slices", [1, 100, 65_535, 65_537, 1e6, 1e9])
def test_extents_and_slices_of_every_size(extent: float, slices: float) -> None:
    depth = np.random.default_rng(0).random(20_000) * extent
    found = check(depth, extent / slices)
    assert found.thickness == pytest.approx(extent / slices, rel=1e-12)


def test_the_tables_stay_below_their_size() -> None:
    depth = np.linspace(1e-3, 1e6, 50_000)
    found = check(depth, 1e-6)
    assert found.thickness == pytest.approx(1e6 / 2**32, rel=1e-6)
    assert int(found.slice[-1]) < 2**32


def test_a_range_of_a_billion_to_one_keeps_its_order() -> None:
    depth = np.geomspace(1e-3, 1e6, 3000)[np.random.default_rng(1).permutation(3000)]
    found = check(depth, 1e-3)
    steps = np.diff(depth[found.index])
    assert steps.max() <= found.thickness


def test_one_depth_keeps_the_given_order() -> None:
    for depth in (np.full(1000, 7.0), np.full(3, 1e30, np.float32), np.zeros(1)):
        found = check(depth, 0.1)
        np.testing.assert_array_equal(found.index, np.arange(len(depth)))
        assert not found.slice.any()


def test_what_has_no_depth_is_left_out() -> None:
    depth = np.array([1.0, np.nan, 3.0, np.inf, 2.0, -np.inf])
    np.testing.assert_array_equal(check(depth, 0.5).index, [2, 4, 0])
    for none in (np.array([np.nan, np.inf]), np.empty(0)):
        assert len(check(none, 0.5).index) == 0


def test_rows_beyond_float32_integers_stay_apart() -> None:
    """2^24 + 1 points: no index passes through a float32."""
    depth = np.zeros(2**24 + 1, np.float32)
    depth[-1] = 1.0
    found = depth_order.back_to_front(depth, 0.5)
    np.testing.assert_array_equal(found.index[:2], [2**24, 0])
    assert found.index[-1] == 2**24 - 1


# Orders of cuts


def looking(direction: tuple[float, float, float], position: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """view_from_world of a camera that looks along `direction`."""
    back = -np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0.2, 1.0, 0.1], back)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = [right, np.cross(back, right), back]
    view[:3, 3] = -view[:3, :3] @ position
    return view


def smoke(n: int, seed: int = 0) -> PointCloud:
    rng = np.random.default_rng(seed)
    radii = np.full((n, 1), 0.05, np.float32)
    return PointCloud(
        rng.random((n, 3), np.float32), origin=np.array([10.0, 0, -5]), radii=radii, extinction=np.ones(n, np.float32)
    )


def view_depth(cloud: PointCloud, world_from_object: np.ndarray, view: np.ndarray) -> np.ndarray:
    p = cloud.position + cloud.origin
    return -((p @ world_from_object[:3, :3].T + world_from_object[:3, 3]) @ view[2, :3] + view[2, 3])


# Sheets of opaque splats a quarter of a splat apart, and panes that lie as close as a hundredth.
@pytest.mark.parametrize(("apart", "opacity"), [(0.25, None), (0.01, 0.5)])
def test_surfaces_have_thinner_slices(apart: float, opacity: float | None) -> None:
    """Two sheets less than a splat apart are told from each other."""
    rng = np.random.default_rng(5)
    position = rng.random((400, 3), np.float32)
    position[:, 1] = apart * 0.05 * (np.arange(400) % 2)
    given = None if opacity is None else np.full(400, opacity, np.float32)
    cloud = PointCloud(position, radii=np.full((400, 1), 0.05, np.float32), opacity=given)
    cut = cut_of_all_points(np.array([400]), np.zeros(1, int))
    found = depth_order.sort_cut(cut, {0: cloud}, np.zeros(1, int), np.eye(4)[None], looking((0, 1, 0)))
    share = depth_order.OPAQUE_SLICES if opacity is None else depth_order.SHELL_SLICES
    assert found.thickness == pytest.approx(0.05 * share, rel=1e-6)
    assert (np.diff(view_depth(cloud, np.eye(4), looking((0, 1, 0)))[found.index]) <= 1e-6).all()


def test_instances_of_several_clouds_share_one_order() -> None:
    clouds = {0: smoke(300), 2: smoke(200, 1)}
    world = np.stack([np.eye(4)] * 4)
    world[1, :3, :3] *= 2
    world[1, :3, 3] = [-10, 1, 5]
    world[2, :3, 3] = [0.3, 0.1, 0.2]
    geometry = np.array([0, 0, 2, 1])
    cut = cut_of_all_points(np.array([300, 50, 200]), geometry)
    view = looking((1, 2, -0.5))
    found = depth_order.sort_cut(cut, clouds, geometry, world, view)
    depth = np.concatenate(
        [*(view_depth(clouds[g], world[i], view) for i, g in enumerate((0, 0, 2))), np.full(50, np.nan)]
    )
    assert found.thickness == pytest.approx(0.05, rel=1e-6)
    number = np.floor((np.nanmax(depth) - depth[found.index]) / found.thickness)
    assert len(found.index) == 800
    # Depths of slices' rims are rounded differently.
    assert np.count_nonzero(number != found.slice) <= 1  # measured 0
    assert (np.diff(depth[found.index]) < found.thickness * (1 + 1e-6)).all()


def test_nodes_and_ranges_of_a_cut_are_sorted_by_their_own_depth() -> None:
    built = hierarchy.build(smoke(500))
    splats = node_splats.points_and_nodes(built)
    cut = Cut(np.zeros(3, np.int32), np.array([3, 100, 510]), np.array([40, 60, 9]))
    rows = np.concatenate([np.arange(3, 43), np.arange(100, 160), np.arange(510, 519)])
    view = looking((0, 0, -1))
    found = depth_order.sort_cut(cut, {0: built}, np.zeros(1, int), np.eye(4)[None], view)
    depth = view_depth(splats.take(rows), np.eye(4), view)
    np.testing.assert_array_equal(np.sort(found.index), np.arange(109))
    assert np.diff(depth[found.index]).max() < found.thickness


def test_transforms_that_are_not_finite_have_no_order() -> None:
    world = np.stack([np.eye(4)] * 3)
    world[0, 0, 0], world[1, :3, :3] = np.nan, 0.0
    cut = cut_of_all_points(np.array([10]), np.zeros(3, int))
    found = depth_order.sort_cut(cut, {0: smoke(10)}, np.zeros(3, int), world, np.eye(4))
    np.testing.assert_array_equal(np.sort(found.index), np.arange(10, 30))
    empty = depth_order.sort_cut(
        cut_of_all_points(np.zeros(1, int), np.zeros(1, int)),
        {0: smoke(0)},
        np.zeros(1, int),
        np.eye(4)[None],
        np.eye(4),
    )
    assert len(empty.index) == 0


def test_an_order_is_stale_only_where_a_splat_may_change_its_slice() -> None:
    cloud, geometry, world = smoke(2000), np.zeros(1, int), np.eye(4)[None]
    cut = cut_of_all_points(np.array([2000]), geometry)
    found = depth_order.sort_cut(cut, {0: cloud}, geometry, world, looking((0, 0, -1)))
    assert not found.stale(looking((0, 0, -1), (5, -3, 100)), replace(cut, culled=7))
    rolled = np.diag([-1.0, -1, 1, 1]) @ looking((0, 0, -1))
    assert not found.stale(rolled, cut)
    assert found.stale(looking((0, 0, -1)), cut_of_all_points(np.array([1999]), geometry))
    assert found.stale(looking((0, 0, 1)), cut)
    # The largest turn that it lets pass moves no splat by more than a slice against the centre.
    angle = 0.999 * found.thickness / found.radius
    turned = looking((np.sin(angle), 0, -np.cos(angle)))
    assert not found.stale(turned, cut)
    assert found.stale(looking((np.sin(1.01 * angle), 0, -np.cos(1.01 * angle))), cut)
    relative = [view_depth(cloud, np.eye(4), view) for view in (looking((0, 0, -1)), turned)]
    centre = PointCloud(np.full((1, 3), 0.5, np.float32), origin=cloud.origin)
    moved = [d - view_depth(centre, np.eye(4), v) for d, v in zip(relative, (looking((0, 0, -1)), turned), strict=True)]
    assert np.abs(moved[1] - moved[0]).max() <= found.thickness
