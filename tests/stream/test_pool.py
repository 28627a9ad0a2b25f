"""Reading pages on threads: in order, each once, never beyond the budget; what cannot be read stops nothing."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.stream.pool import PagePool, wishes_of
from pointsplat_addon.stream.scan import PagedScan
from tests.support.octrees import MemoryPages, PlainLook, scan_in_memory, until

PATIENCE = 20.0
LOOK = PlainLook()


def opened(path: Path, count: int = 3000, most: int = 50) -> tuple[MemoryPages, PagedScan]:
    source = MemoryPages(np.random.default_rng(2).uniform(0, 1, (count, 3)), most, 0.1)
    scan = scan_in_memory(source, path / "scan")
    assert scan.refresh()
    return source, scan


def wishes(scan: PagedScan, pages: list[int]) -> list:
    return wishes_of(scan, LOOK, np.array(pages), np.linspace(9, 1, len(pages)))


def test_what_a_view_wants_is_read_once_in_the_order_of_what_it_adds(tmp_path: Path) -> None:
    source, scan = opened(tmp_path)
    pool = PagePool(threads=1)
    pages = [0, 5, 3, 8, 1]
    assert pool.missing("viewport") == 0
    assert pool.want("viewport", wishes(scan, pages)) == 5
    assert pool.missing("viewport") <= 5
    until(lambda: not pool.is_busy("viewport"))
    assert pool.missing("viewport") == 0
    assert source.read_pages == pages
    assert sorted(pool.pages(scan, LOOK, range(20))) == sorted(pages)
    pool.want("viewport", wishes(scan, pages))
    time.sleep(0.05)
    assert source.read_pages == pages
    assert (scan.read_pages, scan.read_bytes) == (5, int(source.directory.nbytes[pages].sum()))


def test_what_no_view_wants_any_more_is_not_read(tmp_path: Path) -> None:
    source, scan = opened(tmp_path)
    source.seconds = 0.02
    pool = PagePool(threads=1)
    pool.want("viewport", wishes(scan, list(range(40))))
    until(lambda: len(source.read_pages) >= 2)
    pool.want("viewport", wishes(scan, [0]))
    until(lambda: not pool.is_busy("viewport"))
    assert len(source.read_pages) <= 4  # one was being read


def test_bytes_never_exceed_the_budget_and_the_longest_unneeded_go_first(tmp_path: Path) -> None:
    source, scan = opened(tmp_path)
    pages = len(source.directory)
    pool = PagePool(budget=12_000, threads=4)
    random = np.random.default_rng(5)
    for _ in range(60):
        some = [0, *random.choice(np.arange(1, pages), 12, replace=False).tolist()]
        fitting = pool.want("viewport", wishes(scan, some))
        until(lambda: not pool.is_busy("viewport"))
        there = pool.pages(scan, LOOK, some)
        assert set(some[:fitting]) <= set(there)
        drawn = sum(max(there[page].joined_nbytes, there[page].device_nbytes) for page in some[:fitting])
        assert pool.nbytes == sum(kept.page.nbytes for kept in pool._kept.values()) <= pool.budget - drawn + len(some)
    assert pool.most_bytes <= pool.budget
    last = pool.pages(scan, LOOK, range(pages))
    assert set(some[:fitting]) <= set(last)


def test_a_budget_that_holds_less_than_a_view_wants_keeps_what_adds_most(tmp_path: Path) -> None:
    _, scan = opened(tmp_path)
    pool = PagePool(budget=10_000, threads=2)
    order = list(range(30))
    pool.want("picture", wishes(scan, order))
    until(lambda: not pool.is_busy("picture"))
    fitting = pool.want("picture", wishes(scan, order))
    until(lambda: not pool.is_busy("picture"))
    assert 2 <= fitting < 30
    assert set(order[:fitting]) <= set(pool.pages(scan, LOOK, order))
    assert pool.most_bytes <= pool.budget


def test_what_fits_is_found_out_before_a_view_is_told_that_nothing_is_to_come(tmp_path: Path) -> None:
    _, scan = opened(tmp_path)
    order = list(range(30))
    for budget in (10_000, 20_000, 30_000):
        pool = PagePool(budget=budget, threads=2)
        guessed = pool.want("viewport", wishes(scan, order))
        until(lambda pool=pool: not pool.is_busy("viewport"))
        fitting = pool.fitting("viewport")
        assert guessed < fitting < 30  # pages are smaller than they are first taken to be
        for _ in range(2):  # asked for anew, it is the same, and all of it is there
            assert pool.want("viewport", wishes(scan, order)) == fitting
            assert not pool.is_busy("viewport")
        assert set(order[:fitting]) <= set(pool.pages(scan, LOOK, order))
        assert pool.most_bytes <= budget


def test_a_damaged_page_is_tried_once_and_told_once(tmp_path: Path) -> None:
    source, scan = opened(tmp_path)
    source.damaged = {3, 4}
    pool = PagePool(threads=2)
    for _ in range(3):
        pool.want("viewport", wishes(scan, [0, 3, 4, 5]))
        until(lambda: not pool.is_busy("viewport"))
    assert sorted(source.read_pages) == [0, 3, 4, 5]
    assert sorted(pool.pages(scan, LOOK, [0, 3, 4, 5])) == [0, 5]
    [warning] = scan.warnings
    assert "2 of its pages cannot be read" in warning


def test_a_file_that_changes_is_opened_anew_and_one_that_vanishes_says_so(tmp_path: Path) -> None:
    _, scan = opened(tmp_path)
    before = scan.number
    assert not scan.refresh()
    scan.path.write_bytes(b"longer")
    assert scan.refresh()
    assert scan.number != before
    scan.path.unlink()
    assert scan.refresh()
    assert scan.warnings == ("scan: is missing",)
    scan.path.write_bytes(b"back again")
    assert scan.refresh()
    assert scan.warnings == ()


def test_a_file_that_cannot_be_opened_says_why(tmp_path: Path) -> None:
    def opened(path: Path):
        raise PointFileError(path, "is damaged")

    (tmp_path / "scan").write_bytes(b"x")
    scan = PagedScan(tmp_path / "scan", opened)
    scan.refresh()
    assert scan.warnings == ("scan: is damaged",)
    assert scan.tree is None


def test_a_disk_that_stalls_holds_up_nobody_who_asks(tmp_path: Path) -> None:
    source, scan = opened(tmp_path)
    stalled = threading.Event()
    read = source.read

    def wait(page: int):
        stalled.wait(PATIENCE)
        return read(page)

    source.read = wait  # type: ignore[method-assign]
    pool = PagePool(threads=2)
    began = time.process_time()
    for _ in range(50):
        pool.want("viewport", wishes(scan, [0, 1, 2]))
        assert pool.pages(scan, LOOK, [0, 1, 2]) == {}
        assert pool.is_busy("viewport")
    assert time.process_time() - began < PATIENCE / 2  # it has not waited for the disk
    stalled.set()
    until(lambda: not pool.is_busy("viewport"))
    assert sorted(pool.pages(scan, LOOK, [0, 1, 2])) == [0, 1, 2]


@pytest.mark.parametrize("threads", [1, 3])
def test_two_views_share_pages(tmp_path: Path, threads: int) -> None:
    source, scan = opened(tmp_path)
    pool = PagePool(threads=threads)
    pool.want("viewport", wishes(scan, [0, 1, 2]))
    pool.want("picture", wishes(scan, [0, 2, 7]))
    until(lambda: not pool.is_busy("viewport") and not pool.is_busy("picture"))
    assert sorted(source.read_pages) == [0, 1, 2, 7]


def test_half_of_the_threads_read_while_a_view_moves(tmp_path: Path) -> None:
    source, scan = opened(tmp_path)
    source.seconds = 0.01
    pool, most = PagePool(threads=4), []
    for moving in (True, False):
        pages = list(range(20 * moving, 20 + 20 * moving))
        pool.want("viewport", wishes(scan, pages), moving=moving)
        at_once = 0
        while pool.is_busy("viewport"):
            at_once = max(at_once, len(pool._reading))
            time.sleep(0.001)
        most.append(at_once)
        assert sorted(pool.pages(scan, LOOK, pages)) == pages
    assert most == [2, 4]


def test_a_scan_is_new_once(tmp_path: Path) -> None:
    _, scan = opened(tmp_path)
    pool = PagePool(threads=1)
    assert [pool.first_time([scan]) for _ in range(3)] == [True, False, False]
    pool.clear()
    assert pool.first_time([scan])
