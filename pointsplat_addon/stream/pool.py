"""Reads pages on threads, in the order of what they add, and keeps them within a budget of bytes.

What views need is asked for whole each time, so that nothing waits in a queue that no view needs any more. Pages that
are needed stay; of the others those go first that were needed the longest ago. Bytes are set aside before a page is
read, so that what is kept never exceeds the budget; and for what is drawn of the pages, which is joined and sent to the
device.
"""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..core.scene.scene import PageLook
from .page import Page
from .scan import PagedScan

BUDGET = 2000 << 20  # bytes, until settings say
# Bytes of an element in memory, joined with others for a picture, and on the device, until a page of the look was read:
# those of nodes.
FIRST_GUESS = (60.0, 60.0, 56.0)
NEW = 0.77  # of a page's elements, beyond those of its parent that it stands in for
LOOK_AGAIN = 2.0  # seconds after which a file is asked again whether it is still the same
MOST_THREADS = 4
VIEWPORT, PICTURE = "viewport", "picture"  # the kinds of views that ask for pages


class PageKey(NamedTuple):
    """A page of a file as it was opened, in a look."""

    number: int
    look: str
    page: int


class Wish(NamedTuple):
    """A page that a view needs."""

    gain: float  # what it adds: those of most are read first
    scan: PagedScan
    look: PageLook
    page: int
    key: PageKey


class Joint(NamedTuple):
    """What was joined of pages for a picture."""

    name: str  # content key of the geometry that it shows
    splats: object


@dataclass(eq=False)
class _Kept:
    page: Page
    sizes: tuple[int, int, int]  # bytes of it, and what all of it takes joined with others, and on the device
    needed: int  # number of the last view that needed it
    part: Joint | None = None  # of which its arrays are a part


@dataclass(eq=False)
class _View:
    """What one kind of view needs."""

    asked: list[Wish] = field(default_factory=list)
    spare: list[Wish] = field(default_factory=list)  # what it may need next
    moving: bool = False
    fitting: int = 0  # of what is asked for, that fit the budget together
    wishes: list[Wish] = field(default_factory=list)  # that are read: these, and what fits of the spare ones
    keys: frozenset[PageKey] = frozenset()
    drawn: int = 0  # bytes that what is drawn of them takes beside the pages
    looked: int = 0  # pages of the pool when it was found out what fits


class PagePool:
    """Pages of all scans of a session."""

    def __init__(self, budget: int = BUDGET, threads: int = 0) -> None:
        """`budget`: bytes. `threads`: 0 takes as many as there are processors, at most MOST_THREADS."""
        self.budget = budget
        self.arrivals = 0  # rises with each page, and with each file that was opened or has changed
        self.view_before: np.ndarray | None = None  # (4, 4) view_from_world that a viewport showed last
        self.most_bytes = 0  # that were kept and set aside at any time
        self._threads = threads or min(max(os.cpu_count() or 1, 2), MOST_THREADS)
        self._at_once = self._threads  # pages that are read
        self._waited: weakref.WeakSet[PagedScan] = weakref.WeakSet()
        self._kept: dict[PageKey, _Kept] = {}
        self._bytes = self._aside = 0
        self._of_element: dict[str, tuple[float, float, float]] = {}  # at most, by look, as FIRST_GUESS
        self._views: dict[str, _View] = {}
        self._number = 0  # of views
        self._pages_read = 0  # rises with each page whose size is known
        self._reading: set[PageKey] = set()
        self._refreshing: set[PagedScan] = set()
        self._asked: list[PagedScan] = []
        self._looked: dict[PagedScan, float] = {}
        self._change = threading.Condition()
        self._started: list[threading.Thread] = []
        self._joints: dict[str, Joint] = {}  # of which pages are parts, by the content key of what they show

    # What views ask

    def refresh(self, scan: PagedScan) -> None:
        """Has a file opened, or compared with what it was, on a thread; at most every LOOK_AGAIN seconds."""
        now = time.monotonic()
        with self._change:
            if now - self._looked.get(scan, -1e9) < LOOK_AGAIN or scan in self._refreshing or scan in self._asked:
                return
            self._looked[scan] = now
            self._asked.append(scan)
            self._start()
            self._change.notify_all()

    def want(self, view: str, wishes: Sequence[Wish], spare: Sequence[Wish] = (), moving: bool = False) -> int:
        """Asks for all that a view needs, in the order of what it adds, instead of what it asked for before; returns
        how many of these pages fit the budget together. `view`: which of them. `spare`: what it may need next, which is
        read when all else is there. `moving`: half of the threads read, so that the others' processors draw."""
        with self._change:
            self._at_once = max(self._threads // 2, 1) if moving else self._threads
            self._number += 1
            found = self._views[view] = _View(list(wishes), list(spare), moving)
            self._fit(found)
            self._trim(0)
            self._start()
            self._change.notify_all()
            return found.fitting

    def fitting(self, view: str) -> int:
        """Returns how many of the pages that a view asked for last fit the budget together. What pages take in memory
        is guessed until they are there; it is known once the view is not busy."""
        with self._change:
            wanted = self._views.get(view)
            return 0 if wanted is None else wanted.fitting

    def pages(self, scan: PagedScan, look: PageLook, wanted: Sequence[int]) -> dict[int, Page]:
        """Returns those of the wanted pages that are there."""
        number, key = scan.number, look.key
        with self._change:
            found = {page: self._kept.get(PageKey(number, key, page)) for page in wanted}
        return {page: kept.page for page, kept in found.items() if kept is not None}

    def is_shared(self, name: str, splats: object) -> bool:
        """Whether pages are parts of these splats, which show a geometry of this content key."""
        with self._change:
            known = self._joints.get(name)
            return known is not None and known.splats is splats

    def share(self, scan: PagedScan, look: PageLook, name: str, splats: object, parts: Mapping[int, Page]) -> None:
        """Has pages be parts of splats that were joined of them, so that both are in memory once. Pages that are parts
        of what was joined before for the same geometry, `name`, get arrays of their own, so that it can go."""
        joint = Joint(name, splats)
        with self._change:
            found = {page: self._kept.get(PageKey(scan.number, look.key, page)) for page in parts}
            for page, kept in found.items():
                if kept is not None:
                    kept.page, kept.part = parts[page], joint
            self._part(self._joints.pop(name, None))
            if any(kept is not None for kept in found.values()):
                self._joints[name] = joint

    def _part(self, joint: Joint | None) -> None:
        """Gives pages that are still parts of what was joined arrays of their own."""
        for kept in self._kept.values() if joint is not None else ():
            if kept.part is joint:
                kept.page, kept.part = kept.page.copied(), None

    def wait(self, seconds: float, seen: int) -> None:
        """Waits until `arrivals` is no longer `seen`, at most so long."""
        with self._change:
            self._change.wait_for(lambda: self.arrivals != seen, seconds)

    def first_time(self, scans: Sequence[PagedScan]) -> bool:
        """Whether nobody has asked this of one of the scans before."""
        with self._change:
            new = any(scan not in self._waited for scan in scans)
            self._waited.update(scans)
        return new

    def is_busy(self, view: str) -> bool:
        """Whether something that a view asked for is still to come."""
        with self._change:
            if self._asked or self._refreshing:
                return True
            wanted = self._views.get(view)
            return wanted is not None and (not wanted.keys.isdisjoint(self._reading) or self._next() is not None)

    def missing(self, view: str) -> int:
        """Returns how many of the pages that a view asked for, and that fit the budget, are still to come."""
        with self._change:
            wanted = self._views.get(view)
            return 0 if wanted is None else sum(map(self._is_missing, wanted.asked[: wanted.fitting]))

    @property
    def nbytes(self) -> int:
        """Bytes of all pages that are kept."""
        return self._bytes

    def clear(self) -> None:
        """Drops all pages and forgets what was asked for."""
        with self._change:
            self._kept.clear()
            self._joints.clear()
            self._views.clear()
            self._asked.clear()
            self._looked.clear()
            self._waited.clear()
            self._bytes = 0
            self.view_before = None

    def _fit(self, view: _View) -> bool:
        """Finds out what fits the budget of what a view asked for; returns whether that is other pages than before."""
        room, drawn, some = self.budget, 0, []
        for wish in view.asked:
            beside = self._size_drawn(wish, view.moving)
            room -= self._size(wish) + beside
            if room < 0:
                break
            some.append(wish)
            drawn += beside
        before, view.fitting, view.drawn, view.looked = view.keys, len(some), drawn, self._pages_read
        for wish in view.spare:
            room -= self._size(wish)
            if room < 0:
                break
            some.append(wish._replace(gain=0.0))
        view.wishes, view.keys = some, frozenset(wish.key for wish in some)
        for wish in some:
            if (kept := self._kept.get(wish.key)) is not None:
                kept.needed = self._number
        return view.keys != before

    # What threads do

    def _start(self) -> None:
        """Starts the threads, which do not keep the program from ending: a disk may let them wait for ever."""
        while len(self._started) < self._threads:
            name = f"PointSplat pages {len(self._started)}"
            thread = threading.Thread(target=self._work, name=name, daemon=True)
            self._started.append(thread)
            thread.start()

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(
                    lambda: bool(self._asked) or (len(self._reading) < self._at_once and self._next() is not None)
                )
                if self._asked:
                    scan = self._asked.pop(0)
                    self._refreshing.add(scan)
                    wish = None
                else:
                    wish = self._next()
                    if wish is None or len(self._reading) >= self._at_once:
                        continue
                    key, size = wish.key, self._size(wish)
                    self._reading.add(key)
                    self._aside += size
                    self.most_bytes = max(self.most_bytes, self._bytes + self._aside)
                    scan = wish.scan
            if wish is None:
                self._refresh(scan)
            else:
                self._read(wish, key, size)
            del scan, wish

    def _refresh(self, scan: PagedScan) -> None:
        changed = True
        try:
            changed = scan.refresh()
        finally:
            with self._change:
                self._refreshing.discard(scan)
                self.arrivals += changed
                self._change.notify_all()

    def _read(self, wish: Wish, key: PageKey, size: int) -> None:
        page = None
        try:
            page = wish.scan.read(wish.page, wish.look)
        finally:
            with self._change:
                self._reading.discard(key)
                self._aside -= size
                if page is not None and wish.scan.number == key.number:
                    self._keep(wish, key, page)
                self.arrivals += 1
                self._change.notify_all()

    def _keep(self, wish: Wish, key: PageKey, page: Page) -> None:
        count, sizes = self._count(wish), (page.nbytes, page.joined_nbytes, page.device_nbytes)
        if count:
            known = self._of_element.get(wish.look.key, (0.0, 0.0, 0.0))
            most = [max(before, size / count) for before, size in zip(known, sizes, strict=True)]
            self._of_element[wish.look.key] = most[0], most[1], most[2]
        self._pages_read += 1
        self._trim(page.nbytes)
        if self._bytes + self._aside + page.nbytes > self._room:
            return
        self._kept[key] = _Kept(page, sizes, self._number)
        self._bytes += page.nbytes
        self.most_bytes = max(self.most_bytes, self._bytes + self._aside)

    def _sizes(self, wish: Wish) -> Sequence[float]:
        """Bytes that a page takes in memory, joined with others, and on the device, as far as is known."""
        kept = self._kept.get(wish.key)
        if kept is not None:
            return kept.sizes
        count = self._count(wish)
        return [count * size for size in self._of_element.get(wish.look.key, FIRST_GUESS)]

    def _size(self, wish: Wish) -> int:
        return int(self._sizes(wish)[0])

    def _size_drawn(self, wish: Wish, moving: bool) -> int:
        """Bytes that what is drawn of a page takes beside it. When it was joined it is a part of that, and not before
        it is on the device, unless the view moves."""
        source = wish.scan.source
        new = 1.0 if source is None or source.directory.additive else NEW
        _, joined, on_device = self._sizes(wish)
        return int(new * (joined + on_device if moving else max(joined, on_device)))

    def _count(self, wish: Wish) -> int:
        source = wish.scan.source
        return 0 if source is None else int(source.directory.count[wish.page])

    def _is_missing(self, wish: Wish) -> bool:
        return wish.key not in self._kept and wish.page not in wish.scan.damaged

    def _next(self) -> Wish | None:
        """The page that adds the most of those that are missing and for which there is room. Pages may be larger or
        smaller than was thought: once none is left, what fits is found out anew."""
        while True:
            best = self._missing()
            if best is not None:
                size = self._size(best)
                self._trim(size)
                if self._bytes + self._aside + size <= self._room:
                    return best
            late = [view for view in self._views.values() if view.looked != self._pages_read]
            if self._reading or not any(self._fit(view) for view in late):
                return None

    def _missing(self) -> Wish | None:
        """The page that adds the most of those that are missing."""
        best: Wish | None = None
        for view in self._views.values():
            for wish in view.wishes:
                if best is not None and wish.gain <= best.gain:
                    break
                if self._is_missing(wish) and wish.key not in self._reading:
                    best = wish
                    break
        return best

    def _trim(self, more: int) -> None:
        """Drops pages that no view needs, those first that were needed the longest ago, until so many more bytes
        fit."""
        if self._bytes + self._aside + more <= self._room:
            return
        needed = frozenset().union(*(view.keys for view in self._views.values()))
        loose = sorted((kept.needed, key) for key, kept in self._kept.items() if key not in needed)
        for _, key in loose:
            if key not in self._kept:
                continue
            joint = self._kept[key].part
            self._drop(key)
            if joint is not None:  # its memory is given back once no page is a part of it
                for other in [k for k, kept in self._kept.items() if kept.part is joint and k not in needed]:
                    self._drop(other)
                self._part(joint)
                self._joints = {name: known for name, known in self._joints.items() if known is not joint}
            if self._bytes + self._aside + more <= self._room:
                return

    def _drop(self, key: PageKey) -> None:
        self._bytes -= self._kept.pop(key).sizes[0]

    @property
    def _room(self) -> int:
        """Bytes that pages may take."""
        return self.budget - max((view.drawn for view in self._views.values()), default=0)


POOL = PagePool()


def wishes_of(scan: PagedScan, look: PageLook, pages: np.ndarray, gain: np.ndarray) -> list[Wish]:
    """Returns wishes of pages (K,) by what they add (K,), falling."""
    number, name = scan.number, look.key
    return [
        Wish(g, scan, look, p, PageKey(number, name, p)) for p, g in zip(pages.tolist(), gain.tolist(), strict=True)
    ]
