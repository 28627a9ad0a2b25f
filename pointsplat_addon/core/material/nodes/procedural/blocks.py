"""Evaluates textures in blocks of samples as columns, in several threads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....numeric.vectors import each_block

BLOCK = 1 << 13  # samples: words of all corners of a lattice's cell stay in the processor's cache


def by_columns(
    work: Callable[..., tuple[np.ndarray, ...] | np.ndarray], components: int, *values: np.ndarray
) -> np.ndarray:
    """(N, components) float32 by a function of columns.

    values: (N | 1, C) each. work: takes them as contiguous (C, n | 1) float32 of some samples, and returns as many
    rows (n,) or (1,) as there are components. What is not finite becomes 0.
    """
    count = max(len(v) for v in values)
    out = np.empty((count, components), np.float32)

    def fill(part: slice) -> None:
        taken = (v.T if len(v) == 1 else v[part].T for v in values)
        with np.errstate(all="ignore"):  # of this thread
            found = work(*(np.ascontiguousarray(v, np.float32) for v in taken))
        rows = out[part].T
        for row, value in zip(rows, found, strict=True):
            row[:] = value
        if not np.isfinite(rows).all():
            rows[~np.isfinite(rows)] = 0

    each_block(count, fill, BLOCK)
    return out
