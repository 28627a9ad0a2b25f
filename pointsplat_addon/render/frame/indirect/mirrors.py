"""What sharp mirrors show: a ray for each group of sub-samples, and the light that leaves what it meets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...indirect.light import coherent_rows
from ...indirect.traced import BLURRED, SHARP, Hits, SceneTriangles
from ...passes.indirect.trace import TracedTriangles
from ...passes.uniforms import SampleView
from .hits import HitShading, Lit
from .receivers import Groups

LIFT = 1e-4  # of the distance from the eye: rays begin so far above what mirrors
ALIKE = 0.8  # cosine between normals of pixels that may show one surface


class TracedScene:
    """A scene's triangles, and on the device the tree of them."""

    def __init__(self, triangles: SceneTriangles | None, tree: TracedTriangles | None) -> None:
        """None: there are none, or too many."""
        self.triangles, self.tree = triangles, tree

    def release(self) -> None:
        if self.tree is not None:
            self.tree.release()


class Mirrors:
    """Shows sharp mirrors what is around them."""

    def __init__(self, traced: Callable[[], TracedScene], shading: HitShading) -> None:
        """`traced`: makes the tree when first something is mirrored, or returns it."""
        self._traced, self._shading = traced, shading

    def shown(
        self, view: SampleView, groups: Groups, roughness: np.ndarray, ray: np.ndarray, lit: Lit
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Returns which groups show what rays meet, (n,) int64; what they mirror, (n, 4) float32: radiance of surfaces
        and 1 where there are none; and the share of this in what they show. None: no group does.

        roughness (N,): < 0: nothing is mirrored. ray: (N, 4), mirrored views in the world, and how far what groups
        stand for bulges above their planes.
        """
        share = is_traced(roughness)
        rows = np.flatnonzero((share > 0) & (groups.depth != 0))
        if not len(rows):
            return None
        traced = self._traced()
        if traced.triangles is None or traced.tree is None:
            return None
        pixel = 1 / view.camera.pixel_from_view()[0]
        depth, direction = groups.depth[rows].astype(np.float64), ray[rows, :3]
        above = ray[rows, 3] + LIFT * depth
        origin = groups.position[rows] + above[:, None] * groups.normal[rows]
        triangle, distance, weights = traced.tree.trace(origin, direction, coherent_rows(origin, direction))
        light = np.zeros((len(rows), 4), np.float32)
        light[triangle < 0, 3] = 1
        met = np.flatnonzero(triangle >= 0)
        if len(met):
            away = distance[met].astype(np.float64)
            across = pixel * (depth[met] if view.camera.perspective else 1.0)
            turns = 2 * turning(view, groups)[rows[met]] + (pixel if view.camera.perspective else 0.0)
            width = across + turns * away
            hits = Hits(triangle[met], weights[met], direction[met], width)
            place = origin[met] + away[:, None] * direction[met] - groups.eye
            seen = Groups(groups.eye, place, groups.normal[rows[met]], (width / pixel).astype(np.float32),
                          groups.pixel[rows[met]])  # fmt: skip
            light[met, :3] = self._shading.shade(view, traced.triangles, hits, place, seen, lit)
        return rows, light, share[rows]


def is_traced(roughness: np.ndarray) -> np.ndarray:
    """(N,) float32: the share of what surfaces mirror that rays show; 0 where roughness < 0: nothing is mirrored."""
    share = np.clip((BLURRED - roughness) / (BLURRED - SHARP), 0, 1)
    return np.where(roughness < 0, 0, share).astype(np.float32)


def turning(view: SampleView, groups: Groups) -> np.ndarray:
    """(N,) radians: by how much normals of groups turn from a pixel to the next; of those whose neighbours show other
    surfaces 0."""
    width, height = view.size
    normals = np.zeros((height + 2, width + 2, 3), np.float32)
    there = np.flatnonzero(groups.depth != 0)
    row, column = np.divmod(groups.pixel[there], width)
    normals[row + 1, column + 1] = groups.normal[there]
    found = np.zeros(len(groups.depth), np.float32)
    for axis in ((0, 1), (1, 0)):
        least = np.full(len(there), np.inf, np.float32)
        for sign in (-1, 1):
            other = normals[row + 1 + sign * axis[0], column + 1 + sign * axis[1]]
            alike = (other * groups.normal[there]).sum(axis=1) > ALIKE
            turn = np.linalg.norm(other - groups.normal[there], axis=1)
            least = np.where(alike, np.minimum(least, turn), least)
        found[there] = np.maximum(found[there], np.where(np.isfinite(least), least, 0))
    return found
