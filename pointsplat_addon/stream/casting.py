"""Which pages of a scan cast shadows into a view though they lie outside of it, and how fine they need be.

What a view shows is some balls around pages, the receivers. A page casts onto one where its own ball meets the beam
from the receiver to a light, widened toward the ends by their radii.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.numeric.record import record
from ..core.scene.camera import Camera
from ..core.scene.lights import Light
from .need import Need, projected_spacing
from .tree import PageTree

MOST_RECEIVERS = 128  # of a scan
FINEST = 8.0  # texels of a sun's map, times its resolution, across all that casts: render/shadow/map_views.py
BATCH = 1 << 12  # pages that are compared with all receivers at once


@record
class Receivers:
    """Balls that a view shows, in the world."""

    centre: np.ndarray  # (R, 3) float64
    radius: np.ndarray  # (R,) float64
    spacing: np.ndarray  # (R,) float64: what the view tells apart there
    extent: float  # of all scans


def receivers_of(
    scans: Sequence[tuple[PageTree, Need, np.ndarray]], camera: Camera, tolerance: float
) -> Receivers | None:
    """Returns what a view shows of scans, each with its need and its instances (I, 4, 4), world from object; None: it
    shows nothing of them."""
    centres, radii, spacings, extent = [], [], [], 0.0
    for tree, need, matrices in scans:
        pages = _shown(tree, need)
        for matrix in matrices if len(pages) else ():
            centre, radius = balls(tree, pages, matrix)
            with np.errstate(all="ignore"):
                seen = projected_spacing(tree.directory, camera.view_from_world @ matrix, camera)[pages]
            depth = -(centre @ camera.view_from_world[2, :3] + camera.view_from_world[2, 3])
            focal = max(abs(f) for f in camera.pixel_from_view()[:2])
            apart = tolerance * (np.maximum(depth, camera.near) if camera.perspective else np.ones(len(depth))) / focal
            here = (seen > 0) & np.isfinite(centre).all(axis=1)
            centres.append(centre[here])
            radii.append(radius[here])
            spacings.append(apart[here])
            extent = max(extent, 2 * float(balls(tree, np.zeros(1, np.int64), matrix)[1][0]))
    if not centres or not sum(len(c) for c in centres):
        return None
    return Receivers(np.concatenate(centres), np.concatenate(radii), np.concatenate(spacings), extent)


def _shown(tree: PageTree, need: Need) -> np.ndarray:
    """(R,) some pages that together hold all that a view needs: of those that add the most the deepest ones."""
    first = need.pages[:MOST_RECEIVERS]
    parent = tree.directory.parent
    wanted, taken = np.zeros(len(tree), bool), np.zeros(len(tree), bool)
    wanted[need.pages], taken[first] = True, True
    below = need.pages[need.pages > 0]
    missing = np.zeros(len(tree), bool)  # some needed page below is not among the first
    missing[parent[below[~taken[below]]]] = True
    has = np.zeros(len(tree), bool)
    has[parent[below]] = True
    return first[missing[first] | ~has[first]]


def balls(tree: PageTree, pages: np.ndarray, world_from_object: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 3) and radii (n,), float64, of balls in the world around pages (n,)."""
    low, high = np.moveaxis(tree.directory.bounds[pages], 1, 0)
    linear = world_from_object[:3, :3]
    with np.errstate(all="ignore"):
        scale = float(np.linalg.norm(linear, 2)) if np.isfinite(linear).all() else 0.0
        centre = (low + high) / 2 @ linear.T + world_from_object[:3, 3]
    return centre, np.linalg.norm(high - low, axis=1) / 2 * scale


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
        self._tree, self._matrices, self._lights = tree, world_from_object, lights
        self._receivers, self._resolution = receivers, resolution

    def spacing(self, pages: np.ndarray) -> np.ndarray:
        """(n,) float64, object units: how far apart the elements of pages (n,) may lie, so that no shadow shows it;
        inf: they cast none into the view."""
        found = np.full(len(pages), np.inf)
        for matrix in self._matrices:
            scale = float(np.linalg.norm(matrix[:3, :3], 2)) if np.isfinite(matrix).all() else 0.0
            if scale <= 0:
                continue
            for start in range(0, len(pages), BATCH):
                some = slice(start, start + BATCH)
                centre, radius = balls(self._tree, pages[some], matrix)
                for light in self._lights:
                    world = _allowed(light, centre, radius, self._receivers, self._resolution)
                    np.minimum(found[some], world / scale, out=found[some])
        return found


def _allowed(light: Light, centre: np.ndarray, radius: np.ndarray, receivers: Receivers, resolution: int) -> np.ndarray:
    """(n,) world units: how far apart what lies in balls, centres (n, 3) and radii (n,), may lie."""
    away = centre[:, None] - receivers.centre[None]
    if light.kind == "SUN":
        toward = -np.asarray(light.direction, float)
        wide = np.tan(light.radius)
        along = np.maximum(away @ toward, 0.0)
        aside = np.linalg.norm(away - along[..., None] * toward, axis=2)
        blur = along * wide  # how wide the rim of a shadow is
        meets = aside <= radius[:, None] + receivers.radius + blur
        texel, scale = receivers.extent / (FINEST * resolution), 1.0
    else:
        size = light.radius
        if light.kind == "AREA":
            size = sum(float(np.linalg.norm(axis)) for axis in (light.axis_u, light.axis_v) if axis is not None)
        beam = light.position - receivers.centre
        length = np.maximum(np.linalg.norm(beam, axis=1), 1e-30)
        share = np.clip((away * beam).sum(axis=2) / length**2, 0.0, 1.0)  # 0 at the receiver, 1 at the light
        aside = np.linalg.norm(away - share[..., None] * beam, axis=2)
        blur = size * share
        meets = aside <= radius[:, None] + receivers.radius * (1 - share) + blur
        scale = 1 - share  # of what casts, in its shadow
        texel = np.linalg.norm(centre - light.position, axis=1)[:, None] / resolution
    spacing = np.maximum(np.maximum(receivers.spacing * scale, blur), texel)
    return np.where(meets, spacing, np.inf).min(axis=1)
