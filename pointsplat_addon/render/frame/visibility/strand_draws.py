"""Lists the segments of strands of a view, geometry by geometry."""

from __future__ import annotations

from ...passes.strands.strand_ids import StrandKind
from ..uploads.uploads import Uploads


def strand_draws(uploads: Uploads, first_id: int) -> list[StrandKind]:
    """Returns what a view draws of each geometry and in which way. `first_id`: the number of the first segment."""
    found = []
    for draw in uploads.strands.draws:
        for kind, (_, count) in draw.lists().items():
            found.append(StrandKind(draw, kind, first_id))
            first_id += count
    return found
