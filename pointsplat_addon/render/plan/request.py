"""The records that the renderer takes and returns."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.numeric.record import value_record
from ...core.scene.camera import Camera
from ...core.scene.settings import Settings
from ...core.splat.blur import NODE_SIZE
from ..passes.shading.terms import Term


@value_record
class Request:
    """One picture that the renderer is asked for."""

    camera: Camera
    settings: Settings
    passes: frozenset[str]  # keys of outputs.PASSES and LIGHT_PASSES; combined is always there
    samples: int
    crypto_levels: int = 6
    interactive: bool = False  # drawn repeatedly and at once: see render/prepare/prepare.py
    moving: bool = False  # and its view changes: it is drawn finely once nothing moves
    # Of a view that stands still: another picture follows, which is `following`. Where that draws more sub-samples at
    # once, this one has a single sample, or a single lattice of few.
    first: bool = False
    following: bool = False
    coarse: bool = False  # one sample at the tolerance that was asked for exceeds the budget of time
    # Bound of the nodes of what is out of focus, over the radii of their circles of confusion: core/lens/kernel.py.
    node: float = NODE_SIZE
    # (k, n): of the picture's tiles the k-th of n parts is drawn, from 0; all n together are the picture, to the bit.
    part: tuple[int, int] = (0, 1)
    # (k, n): of a picture of n samples, each at a moment of its own, the k-th alone is drawn, from 0; `samples` is n.
    moment: tuple[int, int] = (0, 1)
    # Of a picture of moments: indirect light is estimated from what the latest moment without this has gathered.
    known_light: bool = False
    pages_of: Camera | None = None  # pages of scans are those of its picture, where this is a coarse one of the same
    term: Term | None = None  # Combined is this term of the light alone; None: all of it

    @property
    def few(self) -> bool:
        """Whether few sub-samples are drawn at once, so that the first are soon there; see lattice_for."""
        return self.interactive and not self.following


@value_record
class Result:
    """Pictures (H, W, C) float32 by pass, bottom row first, and the report.

    Of a picture in parts only pixels of the rectangles `drawn` mean something: (N, 4) x, y, end of x, end of y. There
    are no pictures where there is no rectangle."""

    pixels: dict[str, np.ndarray]
    report: dict[str, Any]
    cancelled: bool = False
    drawn: tuple[tuple[int, int, int, int], ...] | None = None  # None: all
