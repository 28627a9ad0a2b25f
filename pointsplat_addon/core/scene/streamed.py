"""What stands in a scene for a scan that is too large for memory, of which each view reads what it needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..numeric.record import record, value_record
from .cloud import PointCloud


class PageSplats(NamedTuple):
    """The splats of a page."""

    cloud: PointCloud  # points have no radii: these depend on what else is drawn; of nodes, balls of their volume
    shape: np.ndarray | None = None  # (N, 8) float32, core.lod.balls.tree.BallTree.shape: the splats are nodes


class PageLook(Protocol):
    """How the elements of a page become splats."""

    key: str  # content key of all that decides it

    def splats(self, elements: Mapping[str, np.ndarray]) -> PageSplats | None:
        """Returns the splats of a page's elements, see formats/hierarchies/source.py; None: none of them is drawn.

        Several threads may call it.
        """
        ...


@value_record
class PointSize:
    """What radius the points of a scan have, in object units."""

    radius: float = 0.0  # 0: half the distance between neighbours
    of_spacing: bool = False  # it counts in the distances between neighbours

    def of(self, spacing: np.ndarray) -> np.ndarray:
        """Returns the radii (N,) of points that lie `spacing` (N,) apart."""
        if self.radius <= 0:
            return 0.5 * spacing
        return self.radius * spacing if self.of_spacing else np.full_like(spacing, self.radius)


@record
class StreamedScan:
    """A scan in a file, without its points. Pages are in object units, relative to the directory's origin, which is the
    object's own."""

    scan: Any  # stream.scan.PagedScan
    look: PageLook
    size: PointSize = field(default_factory=PointSize)
    box_from_object: np.ndarray | None = None  # (B, 4, 4): clip boxes, cubes from -1 to 1; None: nothing is clipped
    inside: bool = True  # whether what lies in one of the boxes is drawn; else what lies in none
    stand_in: PointCloud | None = None  # what is drawn until the file is open, or where it cannot be read
