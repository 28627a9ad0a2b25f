"""The pages of a scan as a tree: which page below one a place lies in, and which drawn page stands for it."""

from __future__ import annotations

import numpy as np

from ..formats.hierarchies.source import Directory

OCTANTS = 8


class PageTree:
    """Links between the pages of a directory."""

    def __init__(self, directory: Directory) -> None:
        self.directory = directory
        self.levels = [np.flatnonzero(directory.level == level) for level in range(int(directory.level.max()) + 1)]
        self.is_leaf = np.ones(len(directory), bool)
        self.is_leaf[directory.parent[1:]] = False
        self._low, self._high = (np.ascontiguousarray(b, np.float32) for b in np.moveaxis(directory.bounds, 1, 0))
        self._children = self._by_octant() if self._is_octree() else self._in_any_order()

    def __len__(self) -> int:
        return len(self.directory)

    def _is_octree(self) -> bool:
        """Whether each page but the root lies in an octant of its parent."""
        given, parent = self.directory, self.directory.parent[1:]
        return given.cube is not None and bool((given.level[1:] == given.level[parent] + 1).all())

    def _by_octant(self) -> np.ndarray:
        """(P, 8) int32: children by octant, x counting one, y two and z four; -1: there is none."""
        found = np.full((len(self), OCTANTS), -1, np.int32)
        cube, parent = self.directory.cube, self.directory.parent[1:]
        assert cube is not None
        middle = cube[:, :3] + 0.5 * cube[:, 3:]
        beyond = middle[1:] > middle[parent]
        found[parent, beyond @ np.array([1, 2, 4])] = np.arange(1, len(self))
        self._middle = middle.astype(np.float32)
        return found

    def _in_any_order(self) -> np.ndarray:
        """(P, C) int32: children of each page; -1 behind the last."""
        parent = self.directory.parent[1:].astype(np.int64)
        order = np.argsort(parent, kind="stable")
        count = np.bincount(parent, minlength=len(self))
        rank = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
        found = np.full((len(self), max(int(count.max(initial=0)), 1)), -1, np.int32)
        found[parent[order], rank] = order + 1
        self._middle = None
        return found

    def deepest(self, page: int, position: np.ndarray) -> np.ndarray:
        """(N,) int32: the deepest page, at or below `page`, in which each place (N, 3) float32 lies.

        Of octrees by their cubes; else by the bounds of the pages: the first that holds the place. Where pages stand in
        for those below them, none below the next is asked for.
        """
        found = np.full(len(position), page, np.int32)
        if self.is_leaf[page]:
            return found
        rows = np.arange(len(position))
        if not self.directory.additive:
            below = self._below(found, position)
            return np.where(below >= 0, below, found)
        while len(rows):
            below = self._below(found[rows], position[rows])
            going = below >= 0
            rows = rows[going]
            found[rows] = below[going]
        return found

    def _below(self, page: np.ndarray, position: np.ndarray) -> np.ndarray:
        """(n,) the child of each page (n,) in which a place (n, 3) lies; -1: in none."""
        if self._middle is not None:
            octant = (position >= self._middle[page]) @ np.array([1, 2, 4])
            return self._children[page, octant]
        found = np.full(len(page), -1, np.int32)
        for column in self._children.T:
            child = column[page]
            low, high = self._low[child], self._high[child]
            inside = ((position >= low) & (position <= high)).all(axis=1) & (child >= 0) & (found < 0)
            found[inside] = child[inside]
        return found

    def standing_for(self, drawn: np.ndarray) -> np.ndarray:
        """(P,) int32: of each page the deepest at or above it that is `drawn` (P,) bool, together with all above it;
        -1 where the root is not."""
        found = np.where(drawn, np.arange(len(self)), -1).astype(np.int32)
        for rows in self.levels[1:]:
            above = self.directory.parent[rows]
            # What is drawn without its parent stands for nothing.
            linked = drawn[rows] & (found[above] == above)
            found[rows] = np.where(linked, rows, found[above])
        return found
