"""What sampling adds to what moves: flicker from frame to frame, and jumps of means, beside independent samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.frame.sample_positions import offsets
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes.cameras import Vector, camera

BLOCK = 8  # pixels along a side of what is looked at for jumps
COMBINED = frozenset({"combined"})


@dataclass(frozen=True)
class Steadiness:
    """Of a row of frames; pictures are premultiplied and scene-linear, with alpha as a fourth channel.

    d = x - t is how far a frame x is from the same frame t of many sub-samples; what it changes from frame to frame is
    what sampling adds to the motion.
    """

    flicker: float  # root mean square, over pixels that are not empty, of the change of d
    own: float  # and of t: what the motion itself changes
    independent: float  # and of frames whose pixels have as many samples, at random and independent of each other
    mean: float  # largest change of the mean of d over the picture
    block: float  # and over any block of BLOCK x BLOCK pixels
    random_block: float  # four and a half standard deviations of that, of independent samples, in the worst block

    def share(self) -> float:
        """Of the flicker in that of independent samples."""
        return self.flicker / self.independent


def dolly(direction: Vector, distance: float, pixels: float, count: int, size: int, **lens) -> list[Camera]:
    """Cameras that near the origin: what lies at the picture's rim moves by so many pixels a frame."""
    unit = np.array(direction) / np.linalg.norm(direction)
    share = 1 - pixels / (size / 2)
    return [camera(unit * distance * share**i, resolution=(size, size), **lens) for i in range(count)]


def orbit(direction: Vector, distance: float, pixels: float, count: int, size: int, **lens) -> list[Camera]:
    """Cameras that turn about the origin: what lies half the picture's width before it moves by so many pixels."""
    unit = np.array(direction) / np.linalg.norm(direction)
    found = []
    for i in range(count):
        turn = pixels / (size / 2) * i
        cosine, sine = np.cos(turn), np.sin(turn)
        eye = distance * np.array([cosine * unit[0] - sine * unit[1], sine * unit[0] + cosine * unit[1], unit[2]])
        found.append(camera(eye, resolution=(size, size), **lens))
    return found


def picture(renderer: Renderer, scene: Scene, seen: Camera, settings: Settings, samples: int) -> np.ndarray:
    """(H, W, 4) float64."""
    return renderer.render(scene, Request(seen, settings, COMBINED, samples)).pixels["combined"].astype(np.float64)


def shifted(seen: Camera, by: np.ndarray) -> Camera:
    """The camera whose pixels' centres lie by so many (2,) pixels beside those of `seen`."""
    move = np.eye(4)
    move[:2, 3] = -2 * by / seen.resolution
    return replace(seen, clip_from_view=move @ seen.clip_from_view)


def variance(renderer: Renderer, scene: Scene, seen: Camera, settings: Settings, count: int) -> np.ndarray:
    """(H, W, 4) of one sample at a place that is distributed by the pixel filter: from `count` of them."""
    one = replace(settings, filter_size=0.01)
    places = np.random.default_rng(1).permutation(offsets(count, settings.filter_size))
    return np.var([picture(renderer, scene, shifted(seen, p), one, 1) for p in places], axis=0, ddof=1)


def blocks(pictures: np.ndarray) -> np.ndarray:
    """(..., H / BLOCK, W / BLOCK, C): means over blocks of pictures (..., H, W, C), without what is left at the rim."""
    *rest, height, width, channels = pictures.shape
    rows, columns = height // BLOCK, width // BLOCK
    inner = pictures[..., : rows * BLOCK, : columns * BLOCK, :]
    return inner.reshape(*rest, rows, BLOCK, columns, BLOCK, channels).mean(axis=(-4, -2))


def steadiness(found: Sequence[np.ndarray], truth: Sequence[np.ndarray], one: np.ndarray, samples: int) -> Steadiness:
    """Of frames (H, W, 4) each, their truths, and the variance (H, W, 4) of `one` sample."""
    t, d = np.array(truth), np.array(found) - np.array(truth)
    there = (t[..., 3].max(axis=0) > 0) | (np.array(found)[..., 3].max(axis=0) > 0)
    change, motion = np.diff(d, axis=0), np.diff(t, axis=0)
    random = 2 * one / samples  # variance of the difference of two means
    return Steadiness(
        flicker=rms(change[:, there]),
        own=rms(motion[:, there]),
        independent=float(np.sqrt(random[there].mean())),
        mean=float(np.abs(change.mean(axis=(1, 2))).max()),
        block=float(np.abs(blocks(change)).max()),
        random_block=4.5 * float(np.sqrt(blocks(random).max())) / BLOCK,
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean()))


def frames(renderer: Renderer, scene: Scene, cameras: list[Camera], settings: Settings, samples: int) -> list:
    return [picture(renderer, scene, seen, settings, samples) for seen in cameras]
