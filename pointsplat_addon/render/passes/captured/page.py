"""Pages of captured splats on the device, one for each geometry. Texture by texture, one texel a splat:
  position   xyz relative to the geometry's origin; opacity
  rotation   quaternion w, x, y, z
  scale      standard deviations along the splat's own axes
  means      of nodes alone: core.lod.captured.tree
  normal     of those that light changes alone: core.surface.neighbourhoods.captured
and `harmonics`, several texels a splat: its coefficients, channel by channel, degree 0 first.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.captured import CapturedSplats
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Device, DeviceError, Texture, releases_on_failure

WIDE_SHIFT = 14  # log2 of the width of textures that hold the coefficients, where the device has such


class CapturedPage:
    """The splats of one geometry on the device; `textures` by sampler name."""

    @releases_on_failure
    def __init__(
        self,
        device: Device,
        splats: CapturedSplats,
        means: np.ndarray | None = None,
        normals: np.ndarray | None = None,
    ) -> None:
        """means: (N, 4) float32, of nodes (core.lod.captured.tree). normals: (N, 3) float32, or None where light does
        not change them. DeviceError: textures do not hold all splats."""
        self.count = len(splats)
        self.sh_texels = sh_texels(splats)
        self.sh_shift = sh_shift(device)
        self.textures: dict[str, Texture] = {}
        self._device = device
        self._upload("position", splats.position, splats.opacity[:, None])
        self._upload("rotation", splats.rotation)
        self._upload("scale", splats.scale)
        if means is not None:
            self._upload("means", means)
        if normals is not None:
            self._upload("normal", normals)
        higher = () if splats.sh is None else (splats.sh.reshape(self.count, -1),)
        self._upload("harmonics", splats.base, *higher, texels=self.sh_texels, shift=self.sh_shift)

    def _upload(self, name: str, *parts: np.ndarray, texels: int = 1, shift: int = PAGE_WIDTH.bit_length() - 1) -> None:
        """Uploads rows (N, C): all `parts` side by side, in so many texels of a texture 2^shift wide."""
        width, count, channels = 1 << shift, self.count, 4 * texels
        height = max(1, -(-count * texels // width))
        if height > self._device.limits.texture_size:
            raise DeviceError(f"{count} captured splats are more than this GPU's textures hold")

        def write(out: np.ndarray, block: slice) -> None:
            # A block of texels begins and ends within splats: whole ones are written, and what is asked for is taken.
            first, last = block.start // texels, min(-(-block.stop // texels), count)
            out[max(count * texels - block.start, 0) :] = 0
            if last <= first:
                return
            rows = np.zeros((last - first, channels), np.float32)
            column = 0
            for part in parts:
                rows[:, column : column + part.shape[1]] = part[first:last]
                column += part.shape[1]
            found = rows.reshape(-1, 4)[block.start - first * texels :][: len(out)]
            out[: len(found)] = found

        def write_blocks(out: np.ndarray, block: slice) -> None:
            each_block(
                len(out), lambda part: write(out[part], slice(block.start + part.start, block.start + part.stop))
            )

        self.textures[f"ps_{name}"] = self._device.texture((width, height), "RGBA32F", write_blocks)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def sh_texels(splats: CapturedSplats) -> int:
    """Returns the number of texels that hold the coefficients of one splat."""
    higher = 0 if splats.sh is None else splats.sh.shape[1]
    return -(-3 * (1 + higher) // 4)


def sh_shift(device: Device) -> int:
    """Returns log2 of the width of the textures that hold coefficients."""
    return WIDE_SHIFT if device.limits.texture_size >= 1 << WIDE_SHIFT else PAGE_WIDTH.bit_length() - 1
