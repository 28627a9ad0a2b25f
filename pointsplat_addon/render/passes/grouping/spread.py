"""Applies the pixel filter: each pixel takes what its own sub-samples and those of its neighbours show, by the filter's
weights."""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ..shading.averages import averaged_defines, averaged_outputs
from ..shading.shade import FOCUS_OUTPUT
from ..uniforms import RECTANGLE_FIELDS, block

# Where in the sums the tile's own pixels lie, from 0 to 1, and where in them the tile begins, in pixels.
SPREAD_BLOCK = block("Spread", RECTANGLE_FIELDS, (("ivec2", "corner"),))


def spread_program(
    lattice: Lattice,
    passes: frozenset[str],
    combined: bool,
    reach: int,
    weights: np.ndarray | None,
    behind: bool,
    places: bool,
    focus: bool = False,
    moved: float = 0.0,
) -> Interface:
    """Returns the program that adds the shaded groups to the sums.

    `combined`: the picture, not only passes beside it. `reach`: of the filter, in pixels. weights: of `filter_weights`,
    or None where a texture holds them. `behind`: open sub-samples show something. `places`: the list is not in the
    order of the pixels. `focus`: groups tell how much of them is in focus, and at which depth.
    `moved`: the share of a neighbour's weight that is left to a pixel where each is of one group.
    """
    outputs = (*averaged_outputs(passes, combined), *((FOCUS_OUTPUT,) if focus else ()))
    shaded = tuple(("FLOAT_2D", name.replace("out_", "ps_")) for _, name in outputs)
    flags = {"PS_BEHIND": behind, "PS_PLACES": places, "PS_AUXILIARY_ONLY": not combined, "PS_FOCUS": focus}
    names = (*averaged_defines(passes), *(name for name, on in flags.items() if on))
    read = {"ps_starts": True, "ps_weights": weights is None, "ps_behind": behind and combined, "ps_places": places}
    constants = ()
    if weights is not None:
        constants = (("PS_WEIGHTS", _array(weights.reshape(-1))), ("PS_WEIGHT_SUMS", _array(weights.sum(axis=1))))
    return Interface(
        "spread", vertex="common/rectangle.vert", fragment="grouping/spread.frag", block=SPREAD_BLOCK, outputs=outputs,
        samplers=(("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"),
                  *(("FLOAT_2D", name) for name, on in read.items() if on), *shaded),
        defines=(("PS_SUB_SAMPLES", str(lattice.count)), ("PS_REACH", str(reach)),
                 *((name, "1") for name in names), *constants,
                 *((("PS_MOVED", f"{moved:.6g}"),) if moved > 0 else ())),
    )  # fmt: skip


def _array(values: np.ndarray) -> str:
    return f"float[{len(values)}]({', '.join(f'{v:.9g}' if v % 1 else f'{v:.1f}' for v in values.tolist())})"


def weight_texels(weights: np.ndarray) -> np.ndarray:
    """Returns weights (N, S) and their sums by row as texels, (N, S + 1, 1) float32."""
    return np.column_stack([weights, weights.sum(axis=1)])[..., None].astype(np.float32)
