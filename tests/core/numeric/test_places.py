"""Sorted places, rows that are moved there, columns that are taken or summed, and their ranges."""

import numpy as np
import pytest

from pointsplat_addon.core.numeric import segments
from pointsplat_addon.core.numeric.segments import segment_sums, sorted_places
from pointsplat_addon.core.numeric.vectors import BLOCK, column_ranges, moved_rows, take_columns


@pytest.mark.parametrize("count", [0, 1, 1000, 5000])
def test_sorted_places_are_those_of_a_stable_sort(count, monkeypatch):
    monkeypatch.setattr(segments, "PIECE", 1500)
    code = np.random.default_rng(count).integers(0, 40, count).astype(np.uint16)
    order = np.argsort(code, kind="stable")
    np.testing.assert_array_equal(np.argsort(sorted_places(code), kind="stable"), order)


@pytest.mark.parametrize(("shape", "dtype"), [((), np.float32), ((1,), np.float32), ((3,), np.float32),
                                              ((), np.bool_), ((4, 3), np.int8), ((2,), np.uint16)])  # fmt: skip
def test_rows_go_whole_to_their_places(shape, dtype):
    rng = np.random.default_rng(1)
    rows = rng.integers(0, 100, (2 * BLOCK + 7, *shape)).astype(dtype)
    places = rng.permutation(len(rows)).astype(np.int32)
    moved = moved_rows(rows, places)
    assert moved.dtype == rows.dtype
    np.testing.assert_array_equal(moved[places], rows)
    # What is read need not be contiguous.
    np.testing.assert_array_equal(moved_rows(rows[::-1], places)[places], rows[::-1])


@pytest.mark.parametrize("count", [0, 1, 100, 2 * BLOCK + 7])
def test_columns_are_taken_as_by_indexing(count):
    rng = np.random.default_rng(count)
    rows = rng.normal(size=(7, 1000)).astype(np.float32)
    for places in (rng.integers(0, 1000, count), rng.integers(0, 1000, count).astype(np.int32)):
        for given in (rows, rows[::-1], np.asfortranarray(rows)):
            found = take_columns(given, places)
            assert found.dtype == np.float32
            np.testing.assert_array_equal(found, given[:, places])


@pytest.mark.parametrize("count", [1, 100, 2 * BLOCK + 7])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sums_of_segments_are_those_of_one_thread(count, dtype):
    rng = np.random.default_rng(count)
    rows = rng.normal(size=(7, count)).astype(dtype)
    first = np.flatnonzero(np.append(True, rng.random(count - 1) < 0.2))
    found = segment_sums(rows, first)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.add.reduceat(rows, first, axis=1))


@pytest.mark.parametrize("count", [1, 63, 64, 1000, 2 * BLOCK + 7])
def test_ranges_of_columns_are_those_of_all_rows(count):
    rows = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    for given in (rows, rows[::-1], np.asfortranarray(rows)):
        low, high = column_ranges(given)
        np.testing.assert_array_equal(low, rows.min(axis=0))
        np.testing.assert_array_equal(high, rows.max(axis=0))
    rows[count // 2, 1] = np.nan
    for end in column_ranges(rows):
        np.testing.assert_array_equal(np.isnan(end), [False, True, False])
