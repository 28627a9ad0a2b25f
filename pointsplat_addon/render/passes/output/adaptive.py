"""Adaptive sampling: tiles of the picture whose samples agree get no more of them.

After 5, 9, 17 ... samples each tile is asked how far the mean of its samples lies from the mean of their first half, in
its worst pixel; where that is below the threshold the tile is done. The measure is Cycles' (difference of two estimates
over the square root of the brightness), but both are means of a fixed sequence of sample positions: the picture is the
same every time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....core.scene.settings import Settings
from ....shading.interface import Interface
from ...device.protocol import Device, Texture, releases_on_failure
from ..tiles import EVERYWHERE, TILE, TILE_DEFINE, Region
from ..uniforms import block

FIRST_CHECK = 5  # samples, one and pairs that face each other; fewer say too little about edges between them
LEAST_SAMPLES = 8  # of a picture: with fewer there is little to save
KEEP = Interface(
    "keep",
    fragment="output/keep.frag",
    samplers=(("FLOAT_2D", "ps_combined"),),
    outputs=(("vec4", "out_color"),),
)
CONVERGE_BLOCK = block("Converge", (
    ("int", "samples"),  # of the picture so far
    ("float", "threshold"),  # of the difference at which a tile is done
))  # fmt: skip
CONVERGE = Interface(
    "converge", fragment="output/converge.frag", block=CONVERGE_BLOCK, outputs=(("float", "out_count"),),
    samplers=(("FLOAT_2D", "ps_combined"), ("FLOAT_2D", "ps_half"), ("FLOAT_2D", "ps_counts")), defines=(TILE_DEFINE,),
)  # fmt: skip


def why_everywhere(
    settings: Settings, samples: int, translucent: bool, identities: bool, thin: bool, lens: bool = False
) -> str:
    """Returns why every pixel gets all samples; empty where adaptive sampling may leave some out."""
    if not settings.use_adaptive_sampling:
        return "adaptive sampling is switched off"
    if samples < LEAST_SAMPLES:
        return f"fewer than {LEAST_SAMPLES} samples"
    if translucent:
        return "translucent splats cover the picture in each sample"
    if thin:
        return "strands thinner than a pixel are drawn in a share of all samples"
    if lens:
        return "samples through other points on the lens show what the first ones do not"
    return "Cryptomatte counts all samples" if identities else ""


class Adaptive:
    """Which tiles of one picture still take samples, and how many samples each tile has."""

    @releases_on_failure
    def __init__(
        self, device: Device, sums: Texture, threshold: float, gather: int, centre: Texture | None = None
    ) -> None:
        """`gather`: radius in pixels from which a pixel takes what it shows. `centre`: texture of the G-buffer, where
        it is read between samples."""
        self.device, self.threshold = device, threshold
        self._sums, self._centre = sums, centre
        self._gather_tiles = -(-gather // TILE)
        self._size = -(-sums.size[0] // TILE), -(-sums.size[1] // TILE)
        self.counts = np.zeros(self._size[::-1], np.float32)  # 0: still active
        self._held = np.zeros(self.counts.shape, bool)
        self._half = device.texture(sums.size, "RGBA32F")
        self._half_target = device.target([self._half])
        self._count = device.texture(self._size, "R32F")
        self._count_target = device.target([self._count])
        self._masks: list[Texture] = []
        self._saved_centre: list[Any] = []
        self.known = device.texture(self._size, "R32F", self.counts.reshape(-1))  # counts, for presenting
        self.shown = self.gathered = EVERYWHERE  # where passes shade, and where they gather for that

    @property
    def finished(self) -> bool:
        """Whether every tile has enough samples."""
        return bool(self.counts.all())

    def check(self, done: int) -> bool:
        """Compares the means after `done` samples; returns whether that finished any tile."""
        if done <= FIRST_CHECK // 2 or (done - 1) & (done - 2):
            return False
        finished = done >= FIRST_CHECK and self._converge(done)
        self.device.draw(KEEP, self._half_target, textures={"ps_combined": self._sums})
        return finished

    def _converge(self, done: int) -> bool:
        uniforms = CONVERGE_BLOCK.record(samples=done, threshold=self.threshold)
        textures = {"ps_combined": self._sums, "ps_half": self._half, "ps_counts": self.known}
        self.device.draw(CONVERGE, self._count_target, uniforms=uniforms, textures=textures)
        counts = self.device.read(self._count)[..., 0]
        counts = np.where(self._held & (self.counts == 0), np.float32(0), counts)
        if np.array_equal(counts, self.counts):
            return False
        if self._centre is not None and not self._saved_centre:
            kept = self.device.texture(self._centre.size, "RGBA32F")
            self._saved_centre = [self.device.target([kept]), kept]
            self.device.draw(KEEP, self._saved_centre[0], textures={"ps_combined": self._centre})
        self.counts = counts
        active = counts == 0
        self._release_masks()
        self.known = self.device.texture(self._size, "R32F", counts.reshape(-1))
        self.shown, self.gathered = self._region(active), self._region(dilated(active, self._gather_tiles))
        return True

    def hold(self, squares: np.ndarray, limit: float) -> None:
        """Keeps tiles active whose mean of these squared errors, (H, W) of the whole picture, exceeds limit^2."""
        rows, columns = self.counts.shape
        whole = np.pad(squares, [(0, rows * TILE - squares.shape[0]), (0, columns * TILE - squares.shape[1])])
        self._held = whole.reshape(rows, TILE, columns, TILE).mean(axis=(1, 3)) > limit**2

    @property
    def centre(self) -> Texture | None:
        """The G-buffer's texture `centre` from when all tiles were drawn; None where nobody reads it."""
        return self._saved_centre[1] if self._saved_centre else self._centre

    def _region(self, active: np.ndarray) -> Region:
        if active.all():
            return EVERYWHERE
        self._masks.append(self.device.texture(self._size, "R32F", active.astype(np.float32).reshape(-1)))
        return Region(self._masks[-1])

    def samples(self, done: int) -> np.ndarray:
        """Returns the number of samples of each pixel, (H, W, 1) float32."""
        counts = np.where(self.counts == 0, np.float32(done), self.counts)
        width, height = self._sums.size
        return np.repeat(np.repeat(counts, TILE, axis=0)[:height], TILE, axis=1)[:, :width, None]

    def _release_masks(self) -> None:
        for mask in (*self._masks, self.known):
            mask.release()
        self._masks.clear()

    def release(self) -> None:
        self._release_masks()
        for item in (self._half_target, self._half, self._count_target, self._count, *self._saved_centre):
            item.release()


def dilated(mask: np.ndarray, by: int) -> np.ndarray:
    """Returns a mask (H, W) bool extended by `by` tiles to all sides."""
    for axis in (0, 1):
        padded = np.pad(mask, [(by, by) if a == axis else (0, 0) for a in (0, 1)])
        mask = np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * by + 1, axis=axis).any(axis=-1))
    return mask
