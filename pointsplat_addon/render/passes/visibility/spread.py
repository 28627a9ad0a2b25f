"""Applies the pixel filter: spreads what the groups of sub-samples show over the pixels that their sub-samples reach."""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ..shading.averages import averaged_defines, averaged_outputs
from ..uniforms import block
from .buffer import sub_sample_defines

SPREAD_BLOCK = block("Spread", (("int", "layer"),))


def spread_program(lattice: Lattice, passes: frozenset[str], combined: bool) -> Interface:
    """Returns the program that adds one layer of shaded groups to the sums. `combined`: the picture, not only passes
    beside it."""
    outputs = averaged_outputs(passes, combined)
    shaded = tuple(("FLOAT_2D", name.replace("out_", "ps_")) for _, name in outputs)
    names = (*averaged_defines(passes), *(() if combined else ("PS_AUXILIARY_ONLY",)))
    return Interface(
        "spread", fragment="visibility/spread.frag", block=SPREAD_BLOCK, outputs=outputs,
        samplers=(("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"), ("FLOAT_2D", "ps_weights"), *shaded),
        defines=(*sub_sample_defines(lattice), *((name, "1") for name in names)),
    )  # fmt: skip


def blackman_harris(x: np.ndarray, width: float) -> np.ndarray:
    """Returns the filter's weight, not normalised, at distances of `x` pixels from its centre; 0 beyond half the
    width (Harris 1978)."""
    t = 2 * np.pi * (np.asarray(x, float) / width + 0.5)
    found = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    return np.where(np.abs(x) < width / 2, found, 0.0)


def filter_weights(lattice: Lattice, offset: tuple[float, float], width: float) -> np.ndarray:
    """Returns the weights by which a pixel takes from itself and its neighbours, (9, S + 1, 4) float32.

    Row 3 (y + 1) + x + 1 is the neighbour at (x, y); column s is its sub-sample s, the last one the sum of all; the
    weights are in the first channel and add up to 1. offset: pixels by which the sub-samples are moved.
    """
    y, x = (axis.reshape(-1) - 1 for axis in np.indices((3, 3)))
    at = lattice.positions[None] + np.stack([x, y], axis=1)[:, None] + np.asarray(offset)
    weights = blackman_harris(at[..., 0], width) * blackman_harris(at[..., 1], width)
    weights /= weights.sum()
    rows = np.zeros((9, lattice.count + 1, 4), np.float32)
    rows[:, :-1, 0] = weights
    rows[:, -1, 0] = weights.sum(axis=1)
    return rows
