"""Estimates the error of a picture from how far the mean of its samples still moves (docs/notes/budgets.md)."""

from __future__ import annotations

import numpy as np

from ..frame.frame import Frame
from ..frame.sample_positions import is_checkpoint

MOST_OF_ALL = 0.6  # of all samples, of which the mean is compared with that of all
EVENLY = 0.7  # of the error of independent samples: these are spread evenly
MOST_UNSEEN, UNSEEN = 0.015, 0.28  # of a pixel, that an edge beside it covers where none of its samples met it


class Errors:
    """Estimates how far the mean of all samples lies from that of very many, by how far it moved since half of them.

    Where samples have the variance v, the means of all n and of the first m differ by v (1 / m - 1 / n), and the
    former lies v / n from the limit: that is m / (n - m) of the difference. Samples that are spread evenly do better
    (EVENLY), but on edges, which are what is left, not by much. What all pixels have in common is one number, and its
    difference may be nothing by chance: the largest of the last checkpoints' counts. So does what the pixels of each
    quarter of the picture have in common, where that is most of the difference.
    """

    def __init__(self) -> None:
        self._means: list[tuple[int, np.ndarray]] = []  # of the last three checkpoints
        self._squares: np.ndarray | None = None  # (H, W) float64: error of each pixel, squared
        self._counted: np.ndarray | int = 0
        self._unseen: np.ndarray = np.zeros((1, 1))

    def look(self, frame: Frame) -> bool:
        """Takes a picture after a sample; returns whether there is a new estimate."""
        n = frame.done
        if not is_checkpoint(n) and not frame.complete:
            return False
        mean = frame.mean()
        earlier = [(m, picture) for m, picture in self._means if m <= MOST_OF_ALL * n]
        if earlier:
            moved, common = [], []
            for m, before in earlier:
                difference = (mean - before)[..., :3].astype(np.float64) * np.sqrt(m / (n - m))
                common.append(_in_common(difference))
                moved.append(difference - common[-1])
            counts = frame.counts()
            fresh = np.broadcast_to(np.asarray(counts) > self._counted, (*mean.shape[:2], 1))[..., 0]
            squares = (moved[-1] ** 2).mean(axis=-1) + np.square(common).mean(axis=-1).max(axis=0)
            self._squares = squares if self._squares is None else np.where(fresh, squares, self._squares)
            self._counted, self._unseen = counts, missed_edge_error(mean, counts, frame.in_focus())
        if is_checkpoint(n):
            self._means = [*self._means[-2:], (n, mean)]
        return bool(earlier)

    @property
    def squares(self) -> np.ndarray:
        """Squared error of each pixel, (H, W) float64; infinite where nothing is known yet."""
        if self._squares is None:
            return np.full((1, 1), np.inf)
        return np.maximum(EVENLY**2 * np.nan_to_num(self._squares), self._unseen)

    @property
    def rmse(self) -> float:
        """Root mean square over pixels and colours, scene-linear; infinite where nothing is known yet."""
        return float(np.sqrt(self.squares.mean()))


def _in_common(values: np.ndarray) -> np.ndarray:
    """(H, W, C): what pixels of a picture (H, W, C) have in common: the means over its quarters, if these are most of
    it, or else the mean."""
    quarters = np.empty_like(values)
    top, left = (-(-side // 2) for side in values.shape[:2])
    for rows in (slice(top), slice(top, None)):
        for columns in (slice(left), slice(left, None)):
            quarter = values[rows, columns]
            quarters[rows, columns] = quarter.sum(axis=(0, 1)) / max(quarter[..., 0].size, 1)
    few = np.square(quarters).sum() > 0.5 * np.square(values).sum()
    return quarters if few else np.broadcast_to(values.mean(axis=(0, 1)), values.shape)


def missed_edge_error(mean: np.ndarray, samples: np.ndarray | int, in_focus: np.ndarray | None = None) -> np.ndarray:
    """Returns the squared error (H, W) of what no sample has met in pixels of a picture (H, W, 3 or more) that had so
    many each.

    An edge beside a pixel may reach into its filter where none of its samples lies. What it covers of it then was
    measured for edges in all directions: MOST_UNSEEN at first, later UNSEEN / n. `in_focus` (H, W, 1): the share of
    each pixel that samples decide at all, None: all; blurred edges are gathered, and none of them is missed.
    """
    # Steps, not slopes: what changes evenly has no second difference.
    steps = np.zeros(mean.shape[:2])
    for axis in (0, 1):
        bent = (np.diff(np.nan_to_num(mean[..., :3]).astype(np.float64), n=2, axis=axis) ** 2).mean(axis=-1)
        steps = np.maximum(steps, np.pad(bent, [(1, 1) if a == axis else (0, 0) for a in (0, 1)])[: len(steps)])
    n = np.broadcast_to(np.asarray(samples, np.float64), (*mean.shape[:2], 1))[..., 0]
    share = np.minimum(MOST_UNSEEN, UNSEEN / n)
    if in_focus is not None:
        sharp = np.pad(in_focus[..., 0], 1)
        for axis in (0, 1):  # an edge is of what lies on either side of it
            sharp = np.lib.stride_tricks.sliding_window_view(sharp, 3, axis).max(axis=-1)
        share = share * np.minimum(sharp, 1.0)
    return steps * share**2


def rms_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the root mean square difference of two pictures (H, W, 3 or more) over pixels and colours."""
    return float(np.sqrt(np.nan_to_num((a - b)[..., :3].astype(np.float64) ** 2).mean()))
