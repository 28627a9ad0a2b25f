"""Arrays in blocks of memory: what they hold, and that a block goes with its last array."""

import gc
import mmap

import numpy as np
import pytest

from pointsplat_addon.core.numeric import blocks
from pointsplat_addon.core.numeric.blocks import ALIGNED, SMALLEST, concatenated, copied_block, empty_block

LIVE: set[int] = set()


class CountedMap(mmap.mmap):
    """A mapping that is counted while it is there."""

    def __new__(cls, *given, **named):
        made = super().__new__(cls, *given, **named)
        LIVE.add(id(made))
        return made

    def __del__(self) -> None:
        LIVE.discard(id(self))


@pytest.fixture
def counted(monkeypatch):
    monkeypatch.setattr(blocks.mmap, "mmap", CountedMap)
    LIVE.clear()
    return LIVE


def arrays(count: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(count)
    return {
        "position": random.normal(size=(count, 3)).astype(np.float32),
        "row": random.integers(0, 9, count).astype(np.uint16),
        "flag": random.integers(0, 2, count).astype(bool),
        "facets": random.integers(-9, 9, (count, 4, 3)).astype(np.int8),
        "empty": np.empty((0, 3), np.float32),
    }


@pytest.mark.parametrize("count", [0, 1, 1000, 9999])
def test_copies_are_equal_and_lie_apart(count: int) -> None:
    given = arrays(count)
    found = copied_block(given)
    assert found.keys() == given.keys()
    for name, array in given.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        np.testing.assert_array_equal(found[name], array)
        assert not np.shares_memory(found[name], array)
    for name, array in found.items():
        array[...] = 1  # they may be written
        for other in found.keys() - {name}:
            assert not np.shares_memory(array, found[other])


def test_one_block_is_mapped_for_all_and_goes_with_the_last_array(counted: set[int]) -> None:
    found = copied_block(arrays(9999))
    assert len(counted) == 1
    assert all(array.ctypes.data % ALIGNED == 0 for array in found.values() if array.size)
    last = found.pop("row")[5:9]
    found.clear()
    gc.collect()
    assert len(counted) == 1
    del last
    gc.collect()
    assert len(counted) == 0


def test_little_is_not_worth_a_block(counted: set[int]) -> None:
    empty_block({"a": ((SMALLEST - ALIGNED,), np.dtype(np.uint8))})
    kept = empty_block({"a": ((SMALLEST - 2 * ALIGNED,), np.dtype(np.uint8))})
    assert len(counted) == 0
    kept = empty_block({"a": ((SMALLEST,), np.dtype(np.uint8))})
    assert len(counted) == 1
    assert not kept["a"].any()


def test_arrays_are_had_where_nothing_can_be_mapped(monkeypatch) -> None:
    def refused(*_given, **_named):
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(blocks.mmap, "mmap", refused)
    given = arrays(9999)
    for name, array in copied_block(given).items():
        np.testing.assert_array_equal(array, given[name])


def test_arrays_one_after_the_other_are_those_of_numpy() -> None:
    parts = [arrays(count)["facets"] for count in (5000, 0, 1, 7000)]
    np.testing.assert_array_equal(concatenated(parts), np.concatenate(parts))
    assert concatenated(parts).dtype == np.int8
