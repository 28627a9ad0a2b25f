"""The image texture node: an image looked up at a UV map or other coordinates, filtered over splats."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...numeric.record import record
from ..color_models import linear_from_srgb
from ..expression import Expression, SampleInputs, compute_node
from ..image import Image
from ..textures import Pyramid, filter_image, look_up, sample_roughly
from .input_nodes import UV

_FROM_BYTES = linear_from_srgb(np.arange(256, dtype=np.uint8) / np.float32(255))


@record
class ImageTexture(Expression):
    """Colour and alpha (N, 4) of an image at `uv`; texel centres lie at (i + 1/2) / size.

    With `straight` the colour is divided by alpha; Cycles does so only where the node's Alpha is used.
    """

    uv: Expression
    image: Image
    interpolation: str = "Linear"  # Linear, Closest, Cubic (B-spline)
    extension: str = "REPEAT"  # REPEAT, EXTEND, CLIP (transparent black), MIRROR
    straight: bool = False

    def read(self, inputs: SampleInputs) -> tuple[Expression, ...]:
        """Returns `uv`, or nothing where the samples are the image's own texels, which need no coordinates."""
        at_texels = inputs.grid == self.image.size and isinstance(self.uv, UV) and self.interpolation != "Cubic"
        return () if at_texels else self.arguments

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        """Scene-linear RGBA (N, 4) float32, filtered over the splats where `inputs` has displaced samples.

        `values`: those of `uv` (N | 1, 3), or none (see `read`).
        """
        if not values:
            return self._texels(slice(inputs.first, inputs.first + len(inputs)))
        uv, footprint = values[0], self._footprint(inputs, values[0])
        if footprint is None:
            return self._decoded(look_up(self.image.texels, uv, self.interpolation, self.extension))
        if inputs.rough:
            return sample_roughly(self._level, self.image.size, uv[:, :2], footprint)
        return filter_image(self._level, self.image.size, uv[:, :2], footprint)

    def _footprint(self, inputs: SampleInputs, uv: np.ndarray) -> np.ndarray | None:
        """(N, 2, 2): change of `uv` along both half-diameters of each sample. Returns None if that is not known."""
        if inputs.displaced is None or not self.uv.varies:
            return None
        return np.stack([compute_node(self.uv, moved, {})[:, :2] - uv[:, :2] for moved in inputs.displaced], axis=1)

    def _level(self, level: int, uv: np.ndarray, interpolation: str = "Cubic") -> np.ndarray:
        """Colours (N, 4) of the image halved `level` times; `interpolation`: of smaller levels."""
        if level == 0:
            return self._decoded(look_up(self.image.texels, uv, self.interpolation, self.extension))
        smaller = self._pyramid.levels[min(level, len(self._pyramid.levels)) - 1]
        return look_up(smaller, uv, interpolation, self.extension)

    @cached_property
    def _pyramid(self) -> Pyramid:
        def rows(part: slice) -> np.ndarray:
            texels = self.image.texels[part]
            values = texels.reshape(-1, 4).astype(np.float32)
            if texels.dtype == np.uint8:
                values /= np.float32(255)
            return self._decoded(values).reshape(texels.shape)

        return Pyramid(rows, self.image.size)

    def _texels(self, part: slice) -> np.ndarray:
        """Colours (N, 4) of the image's own texels, row by row."""
        texels = self.image.texels.reshape(-1, 4)[part]
        if texels.dtype != np.uint8:
            return self._decoded(texels.copy())
        if not self.image.srgb or (self.straight and self.image.associated):
            return self._decoded(texels / np.float32(255))
        color = _FROM_BYTES.take(texels)
        color[:, 3] = texels[:, 3] / np.float32(255)
        return color

    def _decoded(self, color: np.ndarray) -> np.ndarray:
        """Scene-linear colours from stored ones (N, 4), changed in place."""
        if self.straight and self.image.associated:
            alpha = color[:, 3:]
            color[:, :3] /= np.where(alpha == 0, 1, alpha)
        if self.image.srgb:
            color[:, :3] = linear_from_srgb(color[:, :3])
        return color
