"""The lit splats of one view, and the draws that blend them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ....core.splat.kernel import PROFILES, SUPPORT
from ....shading.interface import Interface
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ..uniforms import SampleView
from .blend import CHANNELS, COARSE_LOW_PASS, Bounds, draw_program
from .options import TranslucentOptions, lit_outputs

CHUNK = 1 << 17  # splats of one draw: Blender wants a vertex buffer, if an empty one, of six vertices for each
# Texels along the side of the largest point that is drawn; OpenGL may draw none larger than one, in theory. A software
# renderer draws splats of some texels as points in 0.4 to 0.7 of the time that two triangles for each take.
WIDEST_POINT = 64


class LitSplats:
    """The draw list of one view after lighting, and the draws that read it."""

    @releases_on_failure
    def __init__(
        self,
        device: Device,
        options: TranslucentOptions,
        program: Interface | None,
        count: int,
        samples: int = 1,
        captured: int = 0,
        radius: float = np.inf,
    ) -> None:
        """`program`: that lights splats; None: all are captured ones. `samples`: of the picture. `captured`: so many
        captured splats may follow after the others. `radius`: of none is larger, in pixels. DeviceError: more splats
        than a texture holds."""
        self.device, self.count, self.program, self.samples = device, count, program, samples
        self.captured = captured  # how many follow after the others
        self.listed: dict[
            str, Texture
        ] = {}  # "ps_listed": the order in which they are drawn, where it is not their own
        size = (PAGE_WIDTH, max(1, -(-(count + captured) // PAGE_WIDTH)))
        self.textures: dict[str, Texture] = {}
        for name in lit_outputs(options):
            self.textures[f"ps_{name}"] = device.texture(size, "RGBA16F" if name == "tint" else "RGBA32F")
        self.target: Target = device.target(list(self.textures.values()))
        self._profiles: dict[str, Texture] = {}
        if options.kernels:
            kernels, steps = PROFILES.shape
            self._profiles["ps_profiles"] = device.texture((steps, kernels), "R32F", PROFILES.reshape(-1))
        self._channels = () if options.defocus else CHANNELS if options.tint else ("",)
        self._options = options
        # At the rim of a wide picture, balls are ellipses twice as long.
        self._small = not options.captured and 4 * radius * SUPPORT**0.5 / 2 <= WIDEST_POINT

    def light(self, view: SampleView, light_count: int, textures: Mapping[str, Texture], **gathered: object) -> None:
        """Lights all splats, seen from the middle of the pixel. `gathered`: values of GATHERED_FIELDS."""
        assert self.program is not None
        record = view.record_of(
            self.program.block,
            count=self.count,
            low_pass_scale=1 / self.samples**2,
            light_count=light_count,
            **gathered,
        )
        self.device.draw(self.program, self.target, uniforms=record, textures=dict(textures))

    def draw(
        self,
        target: Target,
        view: SampleView,
        depth: Texture | None,
        pixels: int = 1,
        bounds: Bounds | None = None,
        tiles: np.ndarray | None = None,
    ) -> None:
        """Blends the splats over `target`, of which a pixel spans `pixels` of the picture.

        `depth`: of what is opaque, in pixels of the picture; None: nothing is looked up. `bounds`: in the picture, what
        lies outside of them is not wanted. tiles: (rows, columns) bool, in which it is; read where options.tiled.
        """
        rectangle = (0.0, 0.0, *target.colors[0].size) if bounds is None else tuple(side / pixels for side in bounds)
        where = {"turn": (1 / pixels, 0.0), "origin": (0.0, 0.0), "place": 1 / pixels, "bounds": rectangle}
        where["low_pass"] = COARSE_LOW_PASS if pixels > 1 else 0.0
        listed, counts = dict(self.listed), None
        if self._options.tiled:
            assert tiles is not None
            counts = tile_counts(self.device, tiles)
            listed["ps_tiles"] = counts
        try:
            self._draw(target, view, depth, where, self.count + self.captured, listed, self._small)
        finally:
            if counts is not None:
                counts.release()

    def draw_turned(
        self,
        target: Target,
        view: SampleView,
        depth: Texture,
        turn: tuple[float, float],
        origin: tuple[float, float],
        rows: np.ndarray,
        variance: float,
        bounds: Bounds | None = None,
        low_pass: float = 0.0,
        depths: bool = False,
    ) -> None:
        """Blends some splats over a target whose texels are turned against the picture's pixels.

        `depth`: of what is opaque, one texel for each of the target's. `turn`: first column of the matrix that takes
        pixels to texels; `origin`: where pixel coordinates (0, 0) lie. rows: (K,) int64 of the splats, rising.
        `variance`: in square pixels, the sum of both axes' of the largest of these splats. `bounds`: in the target,
        what lies outside of them is not wanted. `low_pass`: a variance in square texels by which
        they are widened, their masses kept. `depths`: the optical depths of each channel are added up instead.
        """
        size, data = paged(np.column_stack([rows & (PAGE_WIDTH - 1), rows // PAGE_WIDTH]), 2)
        listed = self.device.texture(size, "RG32F", data)
        bounds = (0.0, 0.0, *target.colors[0].size) if bounds is None else bounds
        where = {"turn": turn, "origin": origin, "place": 1.0, "bounds": bounds, "low_pass": low_pass}
        try:
            small = 2 * (SUPPORT * (np.hypot(*turn) ** 2 * variance + 2 * low_pass)) ** 0.5 <= WIDEST_POINT
            self._draw(target, view, depth, where, len(rows), {"ps_listed": listed}, bool(small), depths)
        finally:
            listed.release()

    def _draw(
        self,
        target: Target,
        view: SampleView,
        depth: Texture | None,
        where: Mapping[str, object],
        count: int,
        listed: Mapping[str, Texture],
        points: bool,
        depths: bool = False,
    ) -> None:
        textures = {**self.textures, **self._profiles, **({} if depth is None else {"ps_depth": depth}), **listed}
        options = replace(self._options, opaque=self._options.opaque and depth is not None)
        if not options.opaque:
            textures.pop("ps_front", None)
        for channel in ("",) if depths else self._channels:
            program = draw_program(options, channel, "ps_listed" in listed, points, depths)
            for first in range(0, count, CHUNK):
                record = view.record_of(program.block, size=target.colors[0].size, first=first, **where)
                vertices = (1 if points else 3 if self._options.alone else 6) * min(CHUNK, count - first)
                self.device.draw(
                    program, target, uniforms=record, textures=textures, vertices=vertices, over=not depths,
                    blend=depths, mask=channel or "RGBA", primitive="POINTS" if points else "TRIANGLES",
                )  # fmt: skip

    def release(self) -> None:
        self.target.release()
        for texture in (*self.textures.values(), *self._profiles.values()):
            texture.release()


def tile_counts(device: Device, tiles: np.ndarray) -> Texture:
    """How many tiles (rows, columns) bool lie left of and below each corner: sums over rectangles by four of them."""
    counts = np.zeros((tiles.shape[0] + 1, tiles.shape[1] + 1), np.float32)
    counts[1:, 1:] = tiles.cumsum(axis=0).cumsum(axis=1)
    return device.texture((counts.shape[1], counts.shape[0]), "R32F", counts.reshape(-1))
