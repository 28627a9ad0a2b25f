"""Lists the segments of strands of a view, geometry by geometry, and finds where in the picture they are."""

from __future__ import annotations

import numpy as np

from ...passes.strands.strand_ids import StrandKind
from ...passes.strands.strand_page import StrandDraw
from ...passes.uniforms import SampleView
from ..uploads.uploads import Uploads
from .polygon_draws import rectangles_in_picture


def strand_draws(uploads: Uploads, view: SampleView, first_id: int) -> list[StrandKind]:
    """Returns what a view draws of each geometry and in which way. `first_id`: the number of the first segment."""
    found = []
    for draw in uploads.strands.draws:
        rectangle = _rectangle(draw, uploads.prepared.view_from_object, view)
        for kind, (_, count) in draw.lists().items():
            found.append(StrandKind(draw, kind, first_id, rectangle))
            first_id += count
    return found


def _rectangle(draw: StrandDraw, view_from_object: np.ndarray, view: SampleView) -> np.ndarray:
    """(4,) float64: low and high corner, from 0 to 1 over the picture, of what holds all instances of a geometry."""
    bounds, matrices = draw.page.strands.bounds, view_from_object[np.unique(draw.segments.instance)]
    middle = matrices[:, :3, :3] @ bounds.center + matrices[:, :3, 3]
    reach = bounds.radius * np.linalg.norm(matrices[:, :3, :3], 2, axis=(1, 2))[:, None]
    box = np.array([(middle - reach).min(axis=0), (middle + reach).max(axis=0)])
    return rectangles_in_picture(box, np.eye(4)[None], view)[0]
