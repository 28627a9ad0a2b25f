"""Translucent shadow tables: how much of a light's radiance reaches any point (Gunjee et al. 2007, section 4.1).

A table holds, for each cell of directions around the light (rows of latitude, columns of longitude; for suns a plane
grid), a list of (distance, cumulated optical depth) in order of distance. Cells have about equal area and are as wide
as high: every row has as many columns as its circumference asks for, and the poles are cells of their own. A splat
gives its optical mass to the cells that its projection touches, each its share, over the cell's area at the splat's
distance: a cell then holds the mean optical depth over its directions. Levels of cells that double in size let each
splat touch four cells at most; a look-up sums the levels and interpolates between four cells of each. Captured
splats and, where it is not too much, smoke are drawn into finer cells (captured/entries.py, fine_smoke.py).

Four kinds of casters are kept in cells of their own. VOLUME, SHELL and CAPTURED sum optical depth, T = exp(-sum tau)
(Beer's law). OPAQUE sums the fraction f of the cell that is covered while entries follow one another closely: the
samples of one surface tile it, and shadows have smooth edges. Separate surfaces hide each other by chance, T = product
of max(0, 1 - sum f), as leaves do; the table keeps -ln T. SHELL and OPAQUE entries lie where the splat's *plane* meets
the middle of the cell, and a look-up with a normal compares them with its own plane there, so that a surface does not
shade itself, however it is inclined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.lights import Light
from .accumulation import accumulate_levels
from .casters import KINDS, Casters, casters
from .entries import entry_blocks
from .grid import (
    Frame,
    cell_grids,
    fit_frame,
    lit_casters,
)
from .rows import GridRows, coarsening, draws_smoke_finely
from .table import Emitter, ShadowTable, emitter_of

__all__ = ["Casters", "ShadowTable", "build_table", "casters"]


def build_table(
    light: Light, batches: Sequence[Casters], resolution: int, around: Sequence[Casters] = ()
) -> ShadowTable:
    """The shadow table of a light, `resolution` cells high: over half a turn, or over the casters where they fill less.

    `around`: splats that the cells cover too, but that cast no shadow.
    Raises ValueError for a light whose position or direction is not finite, or for more cells than 32-bit links
    address."""
    if not (np.isfinite(light.position).all() and np.isfinite(light.direction).all()):
        raise ValueError(f"light {light.name!r}: position or direction is not finite")
    batches = [b for b in (lit_casters(light, b) for b in batches) if len(b)]
    colored = any(b.colored for b in batches)
    if not batches:
        nothing = Frame(True, np.eye(3), np.zeros(3), False, -np.ones(2), np.ones(2), 1)
        return ShadowTable(nothing, Emitter("POINT", np.zeros((2, 3))), (), colored)
    frame = fit_frame(light, [*batches, *around], resolution)
    fine = draws_smoke_finely(frame, batches)
    rows = GridRows(frame, [cell_grids(frame, coarsening(frame, kind, batches, fine)) for kind in KINDS], fine)
    blocks = [*entry_blocks(rows, batches, colored)]
    emitter = emitter_of(light, frame)
    return ShadowTable(frame, emitter, tuple(accumulate_levels(rows, blocks, emitter.shape != "POINT")), colored)
