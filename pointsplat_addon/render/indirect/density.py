"""How far apart surfels are: some pixels, as seen from the middle of the cell of space in which the camera is.

Small moves of the camera leave all surfels where they are, and with them the light tree. Which surfels there are
depends on the camera of a picture alone, not on those before it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...core.scene.camera import Camera
from ..cache.keys import digest

PIXELS = 6.0  # between surfels, on average
NEAR = 1.5  # radii from the middle of an instance, within which it is large: the camera sees parts of it from near
LEAST = 0.7  # radii of an instance: nothing of it counts as nearer
MEAN = 0.5  # radii before the middle of an instance that is not large: all of it counts as that far away
SHOWS = 0.1  # radius over distance of what the size of cells depends on
GROWTH = 0.1  # of the distance from smaller things, by which surfels around them are farther apart
MOST_SMALL = 64  # of these that are looked at
# Of places (3, n): how far apart surfels are to be there, and how far away what that depends on is, (n,) each.
Spacing = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class Density:
    """The spacing of surfels on the instances of a scene."""

    def __init__(self, camera: Camera, middle: np.ndarray, half: np.ndarray, holds_eye: np.ndarray) -> None:
        """middle, half: (I, 3) float64, of boxes around the instances in world space. holds_eye: (I,) bool, whether
        what is seen begins within a closed mesh."""
        self.holds_eye = holds_eye
        eye, scale = camera_place(camera), PIXELS / camera.pixel_from_view()[0]
        self._middle, self._half, self._perspective = middle, half, camera.perspective
        self._scale = float(np.exp2(np.rint(2 * np.log2(scale)) / 2))  # a lens that zooms changes it in steps
        self._radius = np.maximum(np.linalg.norm(half, axis=1), 1e-30)
        if not camera.perspective:
            self._large, self._anchor, self._least = np.zeros(len(middle), bool), np.zeros(3), self._radius
            self.apart = np.full(len(middle), self._scale)
        else:
            away = np.maximum(np.linalg.norm(middle - eye, axis=1) - self._radius, LEAST * self._radius)
            shown = self._radius > SHOWS * away
            nearest = float(away[shown if shown.any() else slice(None)].min(initial=np.inf))
            step = 2.0 ** np.floor(np.log2(nearest if nearest < np.inf else 1.0))
            self._anchor = (np.floor(eye / step) + 0.5) * step
            away = np.linalg.norm(middle - self._anchor, axis=1)
            self._large = away < NEAR * self._radius
            self._least = np.maximum(LEAST * self._radius, step)
            # (I,): evenly, where an instance is not large.
            self.apart = self._scale * np.maximum(away - MEAN * self._radius, self._least)
        by_size = np.flatnonzero(~self._large)
        self._small = by_size[np.argsort(-self._radius[by_size], kind="stable")]

    @property
    def key(self) -> bytes:
        """Equal ones mean equal surfels of equal instances."""
        places = self._anchor.tobytes(), self._least.tobytes(), self.holds_eye.tobytes()
        return digest((*places, self._scale))

    def seen_at(self, position: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """(N,): how wide as many pixels are at positions (N, 3) in the world from `origin` as surfels are apart."""
        if not self._perspective:
            return np.full(len(position), self._scale)
        return self._scale * np.linalg.norm(position - (self._anchor - origin), axis=1)

    def spacing(self, row: int, origin: np.ndarray) -> Spacing:
        """Returns the spacing on an instance, in the world from `origin`."""
        if not self._large[row]:
            even = self.apart[row]
            return lambda place: (np.full(place.shape[1], even), np.full(place.shape[1], np.inf))
        small = self._small[self._radius[self._small] < 0.5 * self._radius[row]][:MOST_SMALL].tolist()
        anchor, least = (self._anchor - origin)[:, None], self._least[row]

        def spacing(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            away = np.maximum(np.sqrt(((place - anchor) ** 2).sum(axis=0)), least)
            apart = self._scale * away
            for other in small:
                outside = np.abs(place - (self._middle[other] - origin)[:, None]) - self._half[other][:, None]
                beside = np.sqrt((np.maximum(outside, 0) ** 2).sum(axis=0)) + self.apart[other] / GROWTH
                apart, away = np.minimum(apart, GROWTH * beside), np.minimum(away, beside)
            return apart, away

        return spacing


def view_begins(camera: Camera) -> np.ndarray:
    """(9, 3) float64: where, in world space, the rays of a camera begin that meet the middle, corners and edges of the
    full frame: what lies before its clip start is not seen."""
    x, y = (axis.ravel() for axis in np.meshgrid((-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)))
    world_from_clip = np.linalg.inv(camera.clip_from_view @ camera.view_from_world)
    found = np.column_stack([x, y, np.full(9, -1.0), np.ones(9)]) @ world_from_clip.T
    return found[:, :3] / found[:, 3:]


def camera_place(camera: Camera) -> np.ndarray:
    """(3,) float64: where the eye is, in world space."""
    return np.linalg.inv(camera.view_from_world)[:3, 3]
