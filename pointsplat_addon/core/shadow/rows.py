"""The rows of all grids of a shadow table in one array, and which level of the grids a splat belongs to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..numeric import segments
from ..numeric.record import value_record
from ..splat.kernel import SUPPORT
from .casters import CHUNK, KINDS, Casters, typical_radius
from .grid import FINER_OCTAVES, FINEST_STEP, Frame, Grid

WIDEST_DEVIATION = 10.0  # radians: standard deviation of a splat that surrounds the light
SPAN = 2.0  # ratio of distances that share a level
ROUNDING_MARGIN = 1.001  # rounding moves no sample of a surface, and no voxel, into wider cells
ONE_SPAN = 4.0  # ratio of all distances of a batch up to which they share one
ONE_SPAN_SURFACE = 64.0  # and of samples of a surface, which would let light through where levels meet
HALF_EXTENT = {
    "VOLUME": np.sqrt(SUPPORT) / 2,
    "SHELL": 1.0,
    "OPAQUE": 1.0,
}  # half extent in a cell, in half-axes: see _split
SMOKE_CELL = 1.005 * 2 * HALF_EXTENT["VOLUME"]  # cells of smoke per radius of its splats: just wide enough for them
# Half extent, in cells, of smoke that is drawn into finer ones (fine_smoke.py): they are as wide as voxels
FINE_EXTENT = 1.4
FINE_CELL = ROUNDING_MARGIN * HALF_EXTENT["VOLUME"] / FINE_EXTENT  # such cells per radius of its splats
FINE_ENTRIES = 8  # cells that such a splat touches
MOST_FINE_ENTRIES = 10 << 20  # of a table; where they were more, cells are as wide as splats
CAPTURED_RAMP = 0.1  # TableLevel.ramp of captured splats
WIDEST_FITTED = 1.25  # typical radii: a surface's cells are as wide as its widest sample, up to this one
MOST_ROWS = 8192  # of cells that are finer than the frame's


class GridRows:
    """The rows of the grids of all kinds of casters, one after another in flat arrays."""

    def __init__(self, frame: Frame, kinds: list[list[Grid]], fine: bool = False) -> None:
        """fine: smoke is drawn into cells finer than its splats (`draws_smoke_finely`)."""
        self.frame, self.levels, self.fine = frame, len(kinds[0]), fine
        self.grids = grids = [grid for kind in kinds for grid in kind]
        self.low = np.array([g.low for g in grids], np.float32)
        self.step = np.array([g.step for g in grids], np.float32)
        self.height = np.array([len(g.count) for g in grids])
        self.base = segments.starts(self.height).astype(np.int32)  # (G,) first row of each grid
        cells = np.array([g.cells for g in grids])
        self.cell_base = segments.starts(cells)  # (G,) first cell of each grid
        if cells.sum() >= 2**31:
            raise ValueError(f"a shadow table of {frame.rows} rows has too many cells for 32-bit links")
        self.first = np.concatenate([g.first + b for g, b in zip(grids, self.cell_base, strict=True)]).astype(np.int32)
        self.column0 = np.concatenate([g.column0 for g in grids]).astype(np.int32)
        self.count = np.concatenate([g.count for g in grids]).astype(np.int32)
        self.density = np.concatenate([g.density for g in grids])
        self.inverse_area = (1 / np.concatenate([g.area(frame.parallel) for g in grids])).astype(np.float32)
        self.latitude = np.concatenate([g.latitude for g in grids]).astype(np.float32)


def draws_smoke_finely(frame: Frame, batches: Sequence[Casters]) -> bool:
    """Whether smoke is drawn into cells about a third as wide as its splats: shadows are then as sharp as these.

    Not about a lamp within it, where splats are as wide as rows of latitude turn, nor where the frame's cells are too
    wide for it, or entries too many.
    """
    smoke = [batch for batch in batches if batch.kind == "VOLUME"]
    if not smoke or frame.full or FINE_ENTRIES * sum(map(len, smoke)) > MOST_FINE_ENTRIES:
        return False
    return all(
        FINE_CELL * np.median(batch.reach) / distance_spans(frame, batch).farthest >= frame.step for batch in smoke
    )


def coarsening(frame: Frame, kind: str, batches: Sequence[Casters], fine: bool = False) -> float:
    """The ratio of the finest cells of a kind of casters to the frame's cells, at most 2.

    A level of smoke's cells is then SMOKE radii of most of its splats wide, and one of surfaces as wide as nearly all
    samples: wider cells would blur them more. Where samples of a surface are smaller than the frame's cells, as leaves
    are, finer cells cost nothing but their masks. Shells would show their samples.
    """
    found = [batch for batch in batches if batch.kind == kind]
    if kind in ("SHELL", "CAPTURED") or not found:
        return 1.0
    widths = []
    for batch in found:
        spans, reach = distance_spans(frame, batch), batch.reach
        width = (
            (FINE_CELL if fine else SMOKE_CELL) * float(np.median(reach))
            if kind == "VOLUME"
            else ROUNDING_MARGIN * 2 * HALF_EXTENT[kind] * min(float(reach.max()), WIDEST_FITTED * spans.least)
        )
        widths.append(max(width / spans.farthest / frame.step, 1e-30))
    octaves = np.log2(widths)
    most = octaves[max(range(len(found)), key=lambda k: len(found[k]))]
    finer = np.clip(np.floor(octaves.min()), -_finer_octaves(frame), 0) if kind == "OPAQUE" else 0.0
    part = most % 1 if kind == "OPAQUE" or most > 0 else 0.0
    return float(2 ** (part + finer))


def _finer_octaves(frame: Frame) -> int:
    """Octaves by which cells may be finer than the frame's."""
    room = np.log2(MOST_ROWS / frame.rows)
    return int(np.clip(room if frame.parallel else min(room, np.log2(frame.step / FINEST_STEP)), 0, FINER_OCTAVES))


def ramp_of(rows: GridRows, kind: str) -> float:
    """TableLevel.ramp of a kind of casters: smoke sets in over as much of the ray as its splats are wide."""
    return CAPTURED_RAMP if kind == "CAPTURED" else FINE_EXTENT if kind == "VOLUME" and rows.fine else 0.5


@value_record
class DistanceSpans:
    """How the splats of a batch are assigned to levels (`level_of_splats`)."""

    farthest: float  # where the farthest span of distances begins
    nearest: float  # and the nearest
    least: float  # radius: smaller splats count as this one


def distance_spans(frame: Frame, batch: Casters) -> DistanceSpans:
    surface = batch.kind != "VOLUME"
    least = typical_radius(batch.reach) if surface else 0.0
    if frame.parallel:
        return DistanceSpans(1.0, 1.0, least)
    near, far = np.inf, 0.0
    for start in range(0, len(batch), CHUNK):
        seen = batch.position[start : start + CHUNK] + (batch.origin - frame.origin).astype(np.float32)
        squared = np.einsum("nc,nc->n", seen, seen)
        near, far = min(near, float(squared.min())), max(far, float(squared.max()))
    near, far = max(np.sqrt(near), 1e-30), max(np.sqrt(far), 1e-30)
    if far <= (ONE_SPAN_SURFACE if surface else ONE_SPAN) * near:
        return DistanceSpans(near, near, least)
    return DistanceSpans(far / SPAN, far / SPAN ** np.ceil(np.log(far / near) / np.log(SPAN)), least)


def level_of_splats(rows: GridRows, batch: Casters, distance: np.ndarray, spans: DistanceSpans) -> np.ndarray:
    """(N,) int32: the finest grid of the batch's kind in which no splat is wider than a cell.

    Where levels meet, their different widths show. So splats of one size whose distances are in a ratio of up to SPAN
    share a level, that of the nearest (in a batch whose distances are all alike, all do), and the samples of surfaces
    share that of a wide one among them.
    """
    cells = 2 * FINE_EXTENT if rows.fine and batch.kind == "VOLUME" else 1.0
    angle = np.float32(2 * HALF_EXTENT[batch.kind] / cells) * np.maximum(batch.reach, np.float32(spans.least))
    if not rows.frame.parallel:
        base = np.full_like(distance, spans.nearest)
        if spans.farthest > spans.nearest:
            base *= SPAN ** np.floor(np.log(np.maximum(distance / base, 1)) / np.float32(np.log(SPAN)))
        angle = np.minimum(angle / base, 4 * WIDEST_DEVIATION)
    first = KINDS.index(batch.kind) * rows.levels
    level = np.ceil(np.log2(np.maximum(angle / rows.step[first], np.float32(1e-30))))
    return np.clip(level, 0, rows.levels - 1).astype(np.int32) + first
