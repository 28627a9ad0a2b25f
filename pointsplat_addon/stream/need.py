"""Which pages of a scan a view needs, and how much each of them adds to the picture.

A page is needed where it may be seen and its parent's elements lie farther apart on the screen than the tolerance
(Gobbetti and Marton 2004; Schütz 2016). What a page adds is how far apart they lie: pages of a view come in an order
in which each pixel gets coarse things before any gets fine ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..core.lod.criteria import criteria_of
from ..core.numeric.record import record
from ..core.scene.camera import Camera
from ..formats.hierarchies.source import Directory
from .tree import PageTree

MARGIN = 4.0  # pixels around the picture: elements there may reach into it


@record
class Need:
    """What a view needs of a scan."""

    pages: np.ndarray  # (K,) int64, in the order of what they add: parents come before their children
    gain: np.ndarray  # (K,) float64 pixels, falling: how far apart the elements of their parents lie


def needed_pages(
    tree: PageTree,
    view_from_object: np.ndarray,
    camera: Camera,
    tolerance: float,
    cast: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Need:
    """Returns the pages that a view of instances (I, 4, 4) needs. `tolerance`: pixels between neighbours. `cast`: how
    far apart the elements of pages (n,) may lie for their shadows' sake, level by level; None: what is out of view is
    not needed."""
    directory, parent = tree.directory, tree.directory.parent
    spacing, gain = np.zeros(len(tree)), np.zeros(len(tree))

    def look_at(rows: np.ndarray) -> None:
        for matrix in view_from_object:
            spacing[rows] = np.maximum(spacing[rows], projected_spacing(directory, matrix, camera, tolerance, rows))

    look_at(tree.levels[0])
    gain[0] = np.inf if spacing[0] > 0 else 0.0
    for level in tree.levels[1:]:
        rows = level[gain[parent[level]] > 0]
        look_at(rows)
        above = parent[rows]
        wanted = (spacing[rows] > 0) & (spacing[above] > tolerance)
        gain[rows] = np.where(wanted, np.minimum(spacing[above], gain[above]), 0.0)
        if cast is not None:
            coarse = tolerance * directory.spacing[above] / cast(rows)
            hidden = (spacing[rows] == 0) & (coarse > tolerance)
            gain[rows[hidden]] = np.minimum(coarse, gain[above])[hidden]
    pages = np.flatnonzero(gain > 0)
    pages = pages[np.argsort(-gain[pages], kind="stable")]
    return Need(pages, gain[pages])


def projected_spacing(
    directory: Directory,
    matrix: np.ndarray,
    camera: Camera,
    tolerance: float = 1.0,
    pages: np.ndarray | slice = slice(None),
) -> np.ndarray:
    """(n,) float64 pixels: how far apart the elements of `pages` (n,) lie at most, at the nearest depth of their
    bounds; 0: they are out of view. `matrix`: (4, 4) view from object."""
    bounds, spacing = directory.bounds[pages], directory.spacing[pages]
    if not np.isfinite(matrix).all():
        return np.zeros(len(bounds))
    criteria = criteria_of(camera, tolerance, MARGIN)
    middle = bounds.mean(axis=1)
    half = 0.5 * (bounds[:, 1] - bounds[:, 0])
    beyond = spacing * float(np.linalg.svd(matrix[:3, :3], compute_uv=False).max())
    seen = np.ones(len(bounds), bool)
    for plane in criteria.planes:
        along = plane[:3] @ matrix[:3, :3]
        with np.errstate(invalid="ignore"):
            most = middle @ along + half @ np.abs(along) + plane[:3] @ matrix[:3, 3] + plane[3] + beyond
        seen &= ~(most < 0)
    depth = 1.0
    if criteria.perspective:
        row = matrix[2, :3]
        depth = np.maximum(-(middle @ row + matrix[2, 3]) - half @ np.abs(row), max(criteria.near, 1e-9))
    focal = criteria.tolerance / (2 * criteria.limit)
    return np.where(seen, np.maximum(beyond * focal / depth, 1e-12), 0.0)
