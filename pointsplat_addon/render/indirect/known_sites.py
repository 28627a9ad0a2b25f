"""What was gathered at sites, kept from picture to picture; and how gathering is divided in time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from ..device.clock import Cancelled

MOST_KNOWN = 1 << 21  # sites that are kept, of 40 bytes each
FIRST_SLICE = 256  # receivers
SLICE_SECONDS = 0.05  # that a slice takes at least, while more than FIRST_SLICE receivers are left


class Slices:
    """Divides receivers into slices, after each of which gathering may be put off without losing what was gathered.

    A software rasteriser takes some hundred microseconds for each receiver, a GPU a thousandth of it: slices grow until
    they take as long as is worth a question.
    """

    def __init__(self, seconds: float = math.inf) -> None:
        """`seconds`: of gathering, after which it is put off; infinite: all receivers are one slice."""
        self.seconds = seconds
        self.spent = 0.0  # seconds
        self._size = FIRST_SLICE

    @property
    def endless(self) -> bool:
        return self.seconds == math.inf

    def gathered(
        self, rows: np.ndarray, gather: Callable[[np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the next slice of rows (N,), what `gather` returns for it, and the rows that are left."""
        size, began = len(rows) if self.endless else self._size, time.perf_counter()
        found = gather(rows[:size])
        took = time.perf_counter() - began
        self.spent += took
        if took < SLICE_SECONDS and not self.endless:
            self._size *= 2
        return rows[:size], found, rows[size:]

    def check(self) -> None:
        """Raises Cancelled where gathering is put off."""
        if self.spent > self.seconds:
            raise Cancelled


class KnownSites:
    """What was gathered at sites (core/indirect/sites.py), by their keys: it depends on nothing else."""

    def __init__(self, columns: int) -> None:
        """`columns`: numbers that are kept for each."""
        self._keys, self._found = np.zeros(0, np.uint64), np.zeros((0, columns), np.float32)

    def lookup(
        self,
        keys: np.ndarray,
        order: np.ndarray,
        gather: Callable[[np.ndarray], np.ndarray],
        slices: Slices,
    ) -> np.ndarray:
        """Returns (N, columns) for keys (N,). `gather` returns it for rows (n,) of those that are not known.

        `order` (N,): those that are alike follow each other, so that they are in one slice. Cancelled: `slices` put
        the rest off; what was gathered until then is kept.
        """
        unique, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        at = np.searchsorted(self._keys, unique)
        known = np.zeros(len(unique), bool)
        within = at < len(self._keys)
        known[within] = self._keys[at[within]] == unique[within]
        found = np.empty((len(unique), self._found.shape[1]), np.float32)
        found[known] = self._found[at[known]]
        missing = np.flatnonzero(~known)
        missing = missing[np.argsort(order[first[missing]], kind="stable")]
        while len(missing):
            some, light, missing = slices.gathered(missing, lambda some: gather(first[some]))
            found[some] = light
            self._add(np.sort(some), unique, found)
            slices.check()
        return found[inverse]

    def _add(self, rows: np.ndarray, keys: np.ndarray, found: np.ndarray) -> None:
        """Keeps what was found, (N, columns) at keys (N,), of rising rows (n,) of rising keys."""
        if len(self._keys) > MOST_KNOWN:
            self._keys, self._found = keys[rows], found[rows]
            return
        at = np.searchsorted(self._keys, keys[rows])
        self._keys = np.insert(self._keys, at, keys[rows])
        self._found = np.insert(self._found, at, found[rows], axis=0)
