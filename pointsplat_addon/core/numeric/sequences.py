"""Sample positions in a pixel and on a lens: pairs about the centre, so that their mean is the centre."""

from __future__ import annotations

import numpy as np

R2 = np.array([0.7548776662466927, 0.5698402909980532])  # 1 / p and 1 / p^2 of the plastic number (Roberts 2018)


def centred_pairs(position: np.ndarray, opposite: np.ndarray, count: int) -> np.ndarray:
    """(count, 2) float64 samples: the centre, then pairs that lie opposite to each other, so that their mean is 0.

    position: (N, 2), N > count // 2, relative to the centre; the first is the centre itself. opposite: (N, 2), each
    position's counterpart across the centre. With a mean of 0, functions that change linearly are integrated exactly.
    The last of an even number belongs to no pair: all but the centre are shifted by 1 / (count - 1) of its offset.
    (Of two samples that would leave no offset, so they stay.) Edges of four samples are then a quarter nearer to the
    filter's integral, those of sixteen 8 %.
    """
    result = np.stack([opposite, position], axis=1).reshape(-1, 2)[1 : count + 1]
    if count % 2 == 0 and count > 2:
        result[1:] -= result.sum(axis=0) / (count - 1)
    return result
