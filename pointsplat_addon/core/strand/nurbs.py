"""Knots and basis functions of Blender's NURBS curves (Piegl and Tiller 1997)."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import offsets, owners, ranks, starts
from .curves import NURBS, Curves


class NurbsSpans:
    """Knots and evaluated spans of the NURBS curves among C curves, in flat arrays."""

    def __init__(self, curves: Curves) -> None:
        none = np.zeros(len(curves.count), np.int64)
        self.curves, count = curves, curves.count
        self.order = order = none + 4 if curves.order is None else np.asarray(curves.order, np.int64)
        mode = none if curves.knots is None else np.asarray(curves.knots, np.int64)
        bezier, ends = (mode == 2) | (mode == 3), (mode == 1) | (mode == 3)
        fits = (curves.kind == NURBS) & (count >= order) & (order > 1)
        fits &= ~((mode == 2) & (count <= order))
        fits &= ~(bezier & curves.cyclic & (count % np.maximum(order - 1, 1) != 0))
        self.fits, self.total = fits, none
        self.row = row = np.flatnonzero(fits)
        if len(row) == 0:
            return

        # Blender's knots: `head` equal ones, then each `inner` times, then a tail that repeats the head's steps
        order, count, cyclic, ends, bezier = order[row], count[row], curves.cyclic[row], ends[row], bezier[row]
        self.last = count + np.where(
            cyclic, order - 1, 0
        )  # control points, including those that a cyclic curve repeats
        size = self.last + order
        inner = np.where(bezier, order - 1, 1)
        head = np.where(ends, order - cyclic, np.where(bezier, np.minimum(2, inner), 1))
        tail = np.where(cyclic, 2 * order - 1, np.where(ends, order, 0))
        offset = (ends & cyclic).astype(np.int64)
        self.first = offsets(size)
        owner, at = owners(size), ranks(size)

        def body(i: np.ndarray) -> np.ndarray:
            j = i - offset[owner]
            grown = np.where(j < head[owner], 0, 1 + (j - head[owner]) // inner[owner])
            return np.where(j < 0, 0, offset[owner] + grown)

        length = size - tail
        passed = length - offset
        turn = (offset + np.where(passed < head, 0, 1 + (passed - head) // inner))[owner]
        beyond = at - length[owner]
        again = beyond - length[owner]
        repeated = np.where(again >= 0, turn + body(again), body(beyond))
        self.knots = np.where(beyond < 0, body(at), turn + repeated).astype(np.float64)

        # Spans that are not empty, between the degree-th knot and the one after the last control point
        following = np.minimum(np.arange(len(at)) + 1, len(at) - 1)
        used = (at >= (order - 1)[owner]) & (at < self.last[owner]) & (self.knots[following] > self.knots)
        self.span, self.owner = np.flatnonzero(used), owner[used]
        number = np.bincount(self.owner, minlength=len(row))
        self.number = number
        self.resolution = np.maximum(curves.resolution[row], 1)
        self.total = none.copy()
        self.total[row] = number * self.resolution + ~cyclic

    def parts(self, opened: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Rows, control points and weights of the evaluated points, for each order in use. opened (C + 1,):
        EvaluatedCurves.open."""
        if len(self.row) == 0:
            return []
        total, first_span = self.total[self.row], starts(self.number)
        owner, along = owners(total), ranks(total)
        number = np.minimum(along // self.resolution[owner], self.number[owner] - 1)
        span = self.span[first_span[owner] + number]
        share = (along - number * self.resolution[owner]) / self.resolution[owner]
        u = self.knots[span] + share * (self.knots[span + 1] - self.knots[span])
        rows = opened[self.row[owner]] + along
        found = []
        for order in np.unique(self.order[self.row]):
            part = np.flatnonzero(self.order[self.row[owner]] == order)
            found.append((rows[part], *self._basis(int(order) - 1, owner[part], span[part], u[part])))
        return found

    def _basis(self, degree: int, owner: np.ndarray, span: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Control points and the values of the basis functions that do not vanish in a span (Piegl and Tiller 1997,
        A2.2)."""
        basis = np.zeros((len(u), degree + 1))
        basis[:, 0] = 1
        left = [u - self.knots[span + 1 - j] for j in range(1, degree + 1)]
        right = [self.knots[span + j] - u for j in range(1, degree + 1)]
        for j in range(1, degree + 1):
            saved = np.zeros(len(u))
            for r in range(j):
                share = basis[:, r] / (right[r] + left[j - r - 1])
                basis[:, r] = saved + right[r] * share
                saved = left[j - r - 1] * share
            basis[:, j] = saved
        curve = self.row[owner]
        inside = (span - self.first[owner])[:, None] + np.arange(-degree, 1)
        index = self.curves.start[curve][:, None] + inside % self.curves.count[curve][:, None]
        if self.curves.weight is not None:
            basis *= self.curves.weight[index]
            basis /= basis.sum(axis=1, keepdims=True)
        return index, basis
