"""Selecting and ordering the points of a cloud."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.scene.cloud import SCATTERED, PointCloud, coherent
from pointsplat_addon.core.scene.valid.geometry import valid_points


def scattered(count: int) -> PointCloud:
    rng = np.random.default_rng(3)
    position = rng.random((count, 3), np.float32)
    return PointCloud(position, normal=position[:, ::-1].copy(), radii=position[:, :1].copy())


def test_taking_by_mask_by_rows_and_by_slice_agree():
    cloud = scattered(50)
    mask = cloud.position[:, 0] > 0.5
    by_rows = cloud.take(np.flatnonzero(mask))
    for name, array in cloud.take(mask).arrays().items():
        np.testing.assert_array_equal(array, by_rows.arrays()[name])
        np.testing.assert_array_equal(array, getattr(cloud, name)[mask])
    np.testing.assert_array_equal(cloud.take(slice(3, 9)).position, cloud.position[3:9])


def test_points_with_a_value_that_is_not_finite_are_dropped_whole():
    cloud = scattered(20)
    cloud.position[4, 1] = np.nan
    cloud.arrays()["normal"][7, 2] = np.inf
    found, dropped = valid_points(cloud)
    assert dropped == 2
    np.testing.assert_array_equal(found.arrays()["radii"], np.delete(cloud.arrays()["radii"], [4, 7], axis=0))


def test_coherent_order_keeps_points_whole_and_neighbours_close():
    cloud = scattered(SCATTERED)
    ordered = coherent(cloud)
    np.testing.assert_array_equal(ordered.arrays()["normal"], ordered.position[:, ::-1])
    np.testing.assert_array_equal(np.sort(ordered.arrays()["radii"], axis=0), np.sort(cloud.arrays()["radii"], axis=0))
    step = np.abs(np.diff(ordered.position, axis=0)).mean()
    # Two points lie in each cell, so that every other step goes to another cell, which is most often the next one.
    assert step < 1 / 32  # measured 0.017; 0.33 before
    assert coherent(ordered) is ordered


def test_small_clouds_and_clouds_without_extent_keep_their_order():
    small = scattered(SCATTERED - 1)
    assert coherent(small) is small
    flat = PointCloud(np.zeros((SCATTERED, 3), np.float32))
    assert coherent(flat) is flat
