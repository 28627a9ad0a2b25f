"""Maxima over rectangles of a grid, each looked up at four places."""

from __future__ import annotations

import numpy as np


class RectangleMaxima:
    """Answers how large the values of a grid are in rectangles of it (sparse tables, Bender and Farach-Colton 2000).

    A rectangle is covered by four that are powers of two wide and high, of which tables hold the maxima.
    """

    def __init__(self, grid: np.ndarray) -> None:
        """grid: (H, W), not empty."""
        self._tables: dict[tuple[int, int], np.ndarray] = {(0, 0): grid}

    def __call__(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Returns the greatest value, (N,), in rectangles of cells `low` up to but not including `high`, (N, 2) int
        column and row; none of them is empty."""
        if len(low) == 0:
            return np.empty(0, self._tables[0, 0].dtype)
        exponent = np.frexp(high - low)[1] - 1  # of the greatest power of two that is no wider
        last = high - (1 << exponent)
        found = np.empty(len(low), self._tables[0, 0].dtype)
        code = exponent @ [64, 1]
        for one in np.unique(code).tolist():
            here = code == one
            table = self._table(*divmod(one, 64))
            (x0, y0), (x1, y1) = low[here].T, last[here].T
            left, right = np.maximum(table[y0, x0], table[y1, x0]), np.maximum(table[y0, x1], table[y1, x1])
            found[here] = np.maximum(left, right)
        return found

    def _table(self, columns: int, rows: int) -> np.ndarray:
        """Returns the maxima of rectangles of 2^columns by 2^rows cells, by their lowest cell."""
        if (columns, rows) not in self._tables:
            if columns:
                half, step = self._table(columns - 1, rows), 1 << (columns - 1)
                made = np.maximum(half[:, :-step], half[:, step:])
            else:
                half, step = self._table(0, rows - 1), 1 << (rows - 1)
                made = np.maximum(half[:-step], half[step:])
            self._tables[columns, rows] = made
        return self._tables[columns, rows]
