"""Which pages of a scan cast shadows into a view though they lie outside of it, and how fine they need be.

What a view shows is some boxes around pages, the receivers. The shadow of a page's box is that box, moved along the
rays of a sun, or scaled about a light that has a position: where it meets a receiver, as linear inequalities tell, the
page casts onto it. Pages are compared with the receivers that the pages above them meet.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.numeric.record import record
from ..core.numeric.segments import ranges
from ..core.scene.camera import Camera
from ..core.scene.lights import Light
from .need import Need, projected_spacing
from .tree import PageTree

FINEST = 8.0  # texels of a sun's map, times its resolution, across all that casts: render/shadow/map_views.py
TEXELS = 2.0  # between elements: those of one page have half their distance as radius


@record
class Receivers:
    """Boxes that a view shows, in the world."""

    middle: np.ndarray  # (R, 3) float64
    half: np.ndarray  # (R, 3) float64, of their edges
    spacing: np.ndarray  # (R,) float64: what the view tells apart there
    extent: float  # of all scans

    def take(self, rows: np.ndarray) -> Receivers:
        return Receivers(self.middle[rows], self.half[rows], self.spacing[rows], self.extent)


def receivers_of(
    scans: Sequence[tuple[PageTree, Need, np.ndarray]], camera: Camera, tolerance: float
) -> Receivers | None:
    """Returns what a view shows of scans, each with its need and its instances (I, 4, 4), world from object; None: it
    shows nothing of them."""
    middles, halves, spacings, extent = [], [], [], 0.0
    for tree, need, matrices in scans:
        pages = _shown(tree, need)
        for matrix in matrices if len(pages) else ():
            middle, half = boxes(tree, pages, matrix)
            with np.errstate(all="ignore"):
                seen = projected_spacing(tree.directory, camera.view_from_world @ matrix, camera)[pages]
            depth = -(middle @ camera.view_from_world[2, :3] + camera.view_from_world[2, 3])
            # Of boxes around the eye most of what is seen lies half an edge away and farther.
            depth = np.maximum(depth, np.abs(half @ np.abs(camera.view_from_world[2, :3])))
            focal = max(abs(f) for f in camera.pixel_from_view()[:2])
            apart = tolerance / focal * (depth if camera.perspective else np.ones(len(depth)))
            # Others are in view as boxes alone: what is below them is not.
            here = (seen > 0) & ((seen <= tolerance) | tree.is_leaf[pages]) & np.isfinite(middle).all(axis=1)
            middles.append(middle[here])
            halves.append(half[here])
            spacings.append(apart[here])
            extent = max(extent, 2 * float(boxes(tree, np.zeros(1, np.int64), matrix)[1].max()))
    if not sum(len(some) for some in middles):
        return None
    return Receivers(np.concatenate(middles), np.concatenate(halves), np.concatenate(spacings), extent)


def _shown(tree: PageTree, need: Need) -> np.ndarray:
    """(R,) the deepest pages that a view needs: together they hold all that it sees."""
    has = np.zeros(len(tree), bool)
    has[tree.directory.parent[need.pages[need.pages > 0]]] = True
    return need.pages[~has[need.pages]]


def boxes(tree: PageTree, pages: np.ndarray, world_from_object: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half edges, (n, 3) float64 each, of boxes in the world around pages (n,)."""
    low, high = np.moveaxis(tree.directory.bounds[pages], 1, 0)
    linear = world_from_object[:3, :3]
    with np.errstate(all="ignore"):
        return (low + high) / 2 @ linear.T + world_from_object[:3, 3], (high - low) / 2 @ np.abs(linear).T


class Casters:
    """What pages of a scan cast onto the receivers of a view, from its lights."""

    def __init__(
        self,
        tree: PageTree,
        world_from_object: np.ndarray,
        receivers: Receivers,
        lights: Sequence[Light],
        resolution: int,
    ) -> None:
        """`world_from_object`: (I, 4, 4). `lights`: that cast shadows. `resolution`: of shadow maps."""
        usable = np.isfinite(world_from_object).all(axis=(1, 2))
        self._tree, self._receivers, self._resolution = tree, receivers, resolution
        all_of_them = np.zeros(len(receivers.spacing), np.int64), np.arange(len(receivers.spacing))
        # By instance and light: pages and the receivers that they meet, sorted by pages; of the level above.
        self._met = [(matrix, light, all_of_them) for matrix in world_from_object[usable] for light in lights]

    def spacing(self, pages: np.ndarray) -> np.ndarray:
        """(n,) float64, object units: how far apart the elements of pages (n,) may lie, so that no shadow shows it;
        inf: they cast none into the view. `pages`: of one level, rising; those of the level above come before."""
        found = np.full(len(pages), np.inf)
        parent = self._tree.directory.parent[pages]
        for i, (matrix, light, (above, receivers)) in enumerate(self._met):
            first, end = np.searchsorted(above, parent, "left"), np.searchsorted(above, parent, "right")
            row = np.repeat(np.arange(len(pages)), end - first)
            other = receivers[ranges(first, end - first)]
            middle, half = boxes(self._tree, pages, matrix)
            world = _allowed(light, middle[row], half[row], self._receivers.take(other), self._resolution)
            meets = np.isfinite(world)
            self._met[i] = matrix, light, (pages[row[meets]], other[meets])
            scale = max(float(np.linalg.norm(matrix[:3, :3], 2)), 1e-30)
            np.minimum.at(found, row[meets], world[meets] / scale)
        return found


def _allowed(light: Light, middle: np.ndarray, half: np.ndarray, receivers: Receivers, resolution: int) -> np.ndarray:
    """(n,) world units: how far apart what lies in boxes, middles and half edges (n, 3), may lie for what it casts onto
    one receiver each (n); inf: it casts nothing onto it."""
    away = receivers.middle - middle
    if light.kind == "SUN":
        along = np.maximum(away @ np.asarray(light.direction, float), 0.0)
        blur = along * np.tan(light.radius)  # how wide the rim of a shadow is
        texel, scale = TEXELS * receivers.extent / (FINEST * resolution), 1.0
    else:
        size = light.radius
        if light.kind == "AREA":
            size = sum(float(np.linalg.norm(axis)) for axis in (light.axis_u, light.axis_v) if axis is not None)
        apart = np.linalg.norm(middle - light.position, axis=1)
        scale = np.clip(apart / np.maximum(np.linalg.norm(receivers.middle - light.position, axis=1), 1e-30), 0.0, 1.0)
        blur = size * (1 - scale)
        texel = TEXELS * apart / resolution
    # Where the shadow is that lies at `move` along its rays: between these two all inequalities hold.
    first = np.full(len(away), 0.0 if light.kind == "SUN" else 1.0)
    last = np.full(len(away), np.inf)
    for axis in range(3):
        wide = receivers.half[:, axis] + blur
        if light.kind == "SUN":
            low = high = np.full(len(away), float(light.direction[axis]))
            below, above = (away[:, axis] + sign * (half[:, axis] + wide) for sign in (-1, 1))
        else:
            at = middle[:, axis] - light.position[axis]
            low, high = at - half[:, axis], at + half[:, axis]
            below, above = (receivers.middle[:, axis] - light.position[axis] + sign * wide for sign in (-1, 1))
        _narrow(first, last, low, above)
        _narrow(first, last, -high, -below)
    spacing = np.maximum(np.maximum(receivers.spacing * scale, blur), texel)
    return np.where(first <= last, spacing, np.inf)


def _narrow(first: np.ndarray, last: np.ndarray, factor: np.ndarray, most: np.ndarray) -> None:
    """Narrows ranges from `first` to `last` (n,), in place, to where `factor` (n,) times a number is at most `most`
    (n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        end = most / factor
    np.minimum(last, end, out=last, where=factor > 0)
    np.maximum(first, end, out=first, where=factor < 0)
    last[(factor == 0) & (most < 0)] = -np.inf
