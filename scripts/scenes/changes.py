"""How much more a sequence of pictures changes from frame to frame than its reference does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import displayed

PERCENTILE = 99.0


@dataclass(frozen=True)
class Change:
    """Between two frames that follow each other, in steps of an 8-bit display."""

    frame: int
    excess: float  # 99th percentile, over the pixels of the body, of what changes more than in the reference
    worst: float  # 99.9th
    whole: float  # 99th over the whole picture
    own: float  # 99th percentile of the change itself
    reference: float  # and of the reference's
    drawn: str  # what the second frame draws


def levels(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 3) float64, what an 8-bit display shows of scene-linear pixels, not rounded."""
    return 255.0 * displayed(pixels.astype(np.float64))


def excess(before: np.ndarray, after: np.ndarray, other_before: np.ndarray, other_after: np.ndarray) -> np.ndarray:
    """(H, W): by how much more the first pair of pictures differs than the second, in its worst channel."""
    own, other = (np.abs(b - a).max(axis=2) for a, b in ((before, after), (other_before, other_after)))
    return own - other


def body(*shown: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that differ in one of the pictures from their corner, where the world alone is seen."""
    return np.any([np.abs(p - p[:1, :1]).max(axis=2) > 0.5 for p in shown], axis=0)


def pictures(
    renderer: Renderer, scene: Scene, cameras: list[Camera], settings: Settings, samples: int
) -> Iterator[tuple[np.ndarray, str]]:
    """Each camera's picture as a display shows it, and what was drawn for it."""
    for camera in cameras:
        result = renderer.render(scene, Request(camera, settings, frozenset({"combined"}), samples))
        report = result.report
        yield levels(result.pixels["combined"]), f"{report['points']['cut']} points, {report['triangles']} triangles"


def changes(
    renderer: Renderer,
    scene: Scene,
    cameras: list[Camera],
    settings: Settings,
    samples: int,
    reference_samples: int = 0,
    reference: tuple[Scene, Settings] | None = None,
) -> list[Change]:
    """What `scene` changes from camera to camera beyond `reference`, or the same geometries as polygons.
    `reference_samples`: another number of samples than `samples`."""
    plain = replace(scene, geometries=tuple(as_polygons(g) for g in scene.geometries)), settings
    shown = pictures(renderer, scene, cameras, settings, samples)
    other_scene, other_settings = reference or plain
    truth = pictures(renderer, other_scene, cameras, other_settings, reference_samples or samples)
    found: list[Change] = []
    before = None
    for frame, ((own, drawn), (other, _)) in enumerate(zip(shown, truth, strict=True)):
        if before is not None:
            beyond = excess(before[0], own, before[1], other)
            moved = [np.abs(b - a).max(axis=2) for a, b in zip(before, (own, other), strict=True)]
            drawn_there = body(before[0], before[1], own, other)
            at, far = np.percentile(beyond[drawn_there], (PERCENTILE, 99.9))
            own_change, truth_change = (float(np.percentile(m[drawn_there], PERCENTILE)) for m in moved)
            whole = float(np.percentile(beyond, PERCENTILE))
            found.append(Change(frame, float(at), float(far), whole, own_change, truth_change, drawn))
        before = own, other
    return found


def as_polygons(geometry: Geometry) -> Geometry:
    return geometry if geometry.mesh is None else replace(geometry, primitive="POLYGONS")
