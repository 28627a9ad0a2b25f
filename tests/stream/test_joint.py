"""Pages whose arrays are parts of what was joined of them: memory is held once, and given back."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.scene.scene import PointSize
from pointsplat_addon.stream.cut import CutSplats, cut_pages, parts_of, splats_of_cut
from pointsplat_addon.stream.page import Page, make_page
from pointsplat_addon.stream.pool import PagePool, wishes_of
from pointsplat_addon.stream.scan import PagedScan
from tests.support.octrees import MemoryPages, PlainLook, scan_in_memory, until

LOOK = PlainLook()
NAME = "a scan"


def arrays_of(splats: CutSplats) -> dict[str, np.ndarray]:
    """The arrays of points."""
    assert splats.points is not None
    return splats.points.arrays()


class Drawn:
    """A pool with some pages of a scan, and what is drawn of them."""

    def __init__(self, path: Path, budget: int = 10_000_000) -> None:
        random = np.random.default_rng(2)
        self.source = MemoryPages(random.uniform(0, 1, (3000, 3)), 50, 0.1)
        self.source.columns["color"] = random.uniform(0, 1, (3000, 3)).astype(np.float32)
        self.scan: PagedScan = scan_in_memory(self.source, path / "scan")
        assert self.scan.refresh()
        self.pool = PagePool(budget=budget, threads=2)

    def there(self, pages: list[int], view: str = "viewport") -> dict[int, Page]:
        """Pages that a view asked for, once they are there."""
        self.pool.want(view, wishes_of(self.scan, LOOK, np.array(pages), np.linspace(9, 1, len(pages))))
        until(lambda: not self.pool.is_busy(view))
        return self.pool.pages(self.scan, LOOK, pages)

    def drawn_of(self, there: dict[int, Page]) -> CutSplats:
        """What is drawn of pages."""
        assert self.scan.tree is not None
        return splats_of_cut(self.scan.tree, cut_pages(self.scan.tree, there), there, PointSize(0.01))

    def join(self, there: dict[int, Page]) -> CutSplats:
        """What is drawn of pages, of which they become parts."""
        splats = self.drawn_of(there)
        self.pool.share(self.scan, LOOK, NAME, splats, parts_of(splats, there))
        return splats

    def shared(self, splats: CutSplats, pages: list[int]) -> list[int]:
        """Those of the pages whose arrays are all parts of what was joined."""
        joint = arrays_of(splats)
        return [
            number
            for number, page in self.pool.pages(self.scan, LOOK, pages).items()
            if page.cloud is not None
            and all(np.shares_memory(array, joint[name]) for name, array in page.cloud.arrays().items())
        ]

    def is_right(self, pages: list[int]) -> bool:
        """Whether pages hold what a page hold that is read anew."""
        assert self.scan.tree is not None
        for number, page in self.pool.pages(self.scan, LOOK, pages).items():
            anew = make_page(self.scan.tree, number, self.source.read(number), LOOK)
            assert page.cloud is not None
            assert anew.cloud is not None
            assert page.cloud.arrays().keys() == anew.cloud.arrays().keys()
            for name, array in page.cloud.arrays().items():
                np.testing.assert_array_equal(array, getattr(anew.cloud, name))
            assert (page.nbytes, page.joined_nbytes, page.device_nbytes) == (
                anew.nbytes,
                anew.joined_nbytes,
                anew.device_nbytes,
            )
        return True


def test_pages_that_are_drawn_are_parts_of_what_was_joined(tmp_path: Path) -> None:
    drawn, pages = Drawn(tmp_path), list(range(12))
    before = drawn.there(pages)
    kept = drawn.pool.nbytes
    splats = drawn.join(before)
    assert drawn.pool.is_shared(NAME, splats)
    assert drawn.shared(splats, pages) == pages
    assert drawn.is_right(pages)
    assert drawn.pool.nbytes == kept
    again = drawn.drawn_of(drawn.pool.pages(drawn.scan, LOOK, pages))
    for name, array in arrays_of(again).items():
        np.testing.assert_array_equal(array, arrays_of(splats)[name])


def test_pages_that_another_picture_does_not_draw_get_arrays_of_their_own(tmp_path: Path) -> None:
    drawn, pages, fewer = Drawn(tmp_path), list(range(12)), list(range(5))
    first = drawn.join(drawn.there(pages))
    second = drawn.join(drawn.pool.pages(drawn.scan, LOOK, fewer))
    assert not drawn.pool.is_shared(NAME, first)
    assert drawn.shared(second, pages) == fewer
    left = [page.cloud for page in drawn.pool.pages(drawn.scan, LOOK, pages).values() if page.cloud is not None]
    assert len(left) == len(pages)
    for cloud in left:
        assert not any(np.shares_memory(array, arrays_of(first)[name]) for name, array in cloud.arrays().items())
    assert drawn.is_right(pages)


def test_pages_go_together_with_what_was_joined_of_them(tmp_path: Path) -> None:
    drawn, pages, others = Drawn(tmp_path, budget=60_000), list(range(12)), [0, 1, *range(12, 50)]
    splats = drawn.join(drawn.there(pages))
    needed = set(drawn.there(others))  # leaves no room for all of the ones before
    left = drawn.pool.pages(drawn.scan, LOOK, pages)
    assert {0, 1} <= set(left) <= needed  # no page is left that is not needed
    assert drawn.shared(splats, pages) == []
    assert not drawn.pool.is_shared(NAME, splats)
    assert drawn.is_right([*pages, *others])
    assert drawn.pool.nbytes == sum(page.nbytes for page in drawn.pool.pages(drawn.scan, LOOK, range(60)).values())


def test_a_pool_that_is_emptied_holds_nothing_that_was_joined(tmp_path: Path) -> None:
    drawn = Drawn(tmp_path)
    splats = drawn.join(drawn.there([0, 1]))
    drawn.pool.clear()
    assert not drawn.pool.is_shared(NAME, splats)
    drawn.pool.share(drawn.scan, LOOK, NAME, splats, parts_of(splats, drawn.there([0, 1])))
    assert drawn.pool.is_shared(NAME, splats)
    drawn.pool.clear()
    drawn.pool.share(drawn.scan, LOOK, NAME, splats, {})  # of pages that are gone, nothing is held
    assert not drawn.pool.is_shared(NAME, splats)


@pytest.mark.parametrize("color", [False, True])
def test_what_is_joined_takes_what_its_pages_say(tmp_path: Path, color: bool) -> None:
    drawn, pages = Drawn(tmp_path), list(range(12))
    if not color:
        del drawn.source.columns["color"]
    there = drawn.there(pages)
    splats = drawn.join(there)
    assert sum(page.joined_nbytes for page in there.values()) == splats.nbytes
