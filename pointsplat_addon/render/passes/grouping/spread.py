"""Applies the pixel filter: each pixel takes what its own sub-samples and those of its neighbours show, by the filter's
weights."""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ..shading.averages import averaged_defines, averaged_outputs
from ..uniforms import RECTANGLE_FIELDS, block

# Where in the sums the tile's own pixels lie, from 0 to 1, and where in them the tile begins, in pixels.
SPREAD_BLOCK = block("Spread", RECTANGLE_FIELDS, (("ivec2", "corner"),))


def spread_program(
    lattice: Lattice, passes: frozenset[str], combined: bool, weights: np.ndarray | None, behind: bool, places: bool
) -> Interface:
    """Returns the program that adds the shaded groups to the sums.

    `combined`: the picture, not only passes beside it. weights: (9, S) of `filter_weights`, or None where a texture
    holds them. `behind`: open sub-samples show something. `places`: the list is not in the order of the pixels.
    """
    outputs = averaged_outputs(passes, combined)
    shaded = tuple(("FLOAT_2D", name.replace("out_", "ps_")) for _, name in outputs)
    flags = {"PS_BEHIND": behind, "PS_PLACES": places, "PS_AUXILIARY_ONLY": not combined}
    names = (*averaged_defines(passes), *(name for name, on in flags.items() if on))
    read = {"ps_starts": True, "ps_weights": weights is None, "ps_behind": behind and combined, "ps_places": places}
    constants = ()
    if weights is not None:
        constants = (("PS_WEIGHTS", _array(weights.reshape(-1))), ("PS_WEIGHT_SUMS", _array(weights.sum(axis=1))))
    return Interface(
        "spread", vertex="common/rectangle.vert", fragment="grouping/spread.frag", block=SPREAD_BLOCK, outputs=outputs,
        samplers=(("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"),
                  *(("FLOAT_2D", name) for name, on in read.items() if on), *shaded),
        defines=(("PS_SUB_SAMPLES", str(lattice.count)), *((name, "1") for name in names), *constants),
    )  # fmt: skip


def _array(values: np.ndarray) -> str:
    return f"float[{len(values)}]({', '.join(f'{v:.9g}' if v % 1 else f'{v:.1f}' for v in values.tolist())})"


def blackman_harris(x: np.ndarray, width: float) -> np.ndarray:
    """Returns the filter's weight, not normalised, at distances of `x` pixels from its centre; 0 beyond half the
    width (Harris 1978)."""
    t = 2 * np.pi * (np.asarray(x, float) / width + 0.5)
    found = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    return np.where(np.abs(x) < width / 2, found, 0.0)


def filter_weights(lattice: Lattice, offset: tuple[float, float], width: float) -> np.ndarray:
    """Returns the weights by which a pixel takes from itself and its neighbours, (9, S) float64, which add up to 1.

    Row 3 (y + 1) + x + 1 is the neighbour at (x, y); column s is its sub-sample s. offset: pixels by which the
    sub-samples are moved.
    """
    y, x = (axis.reshape(-1) - 1 for axis in np.indices((3, 3)))
    at = lattice.positions[None] + np.stack([x, y], axis=1)[:, None] + np.asarray(offset)
    weights = blackman_harris(at[..., 0], width) * blackman_harris(at[..., 1], width)
    return weights / weights.sum()


def weight_texels(weights: np.ndarray) -> np.ndarray:
    """Returns weights (9, S) and their sums by row as texels, (9, S + 1, 1) float32."""
    return np.column_stack([weights, weights.sum(axis=1)])[..., None].astype(np.float32)
