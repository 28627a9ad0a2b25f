"""Images that materials and worlds read: texels and how they are encoded."""

from __future__ import annotations

import hashlib
from functools import cached_property

import numpy as np

from ..numeric.record import record


@record
class Image:
    """An image: texels with row 0 at the bottom, and their encoding. uint8 texels stand for value / 255.

    Raises ValueError when the texels have another shape or type.
    """

    texels: np.ndarray  # (H, W, 4) uint8 or float32
    srgb: bool = False  # encoded with the sRGB curve; decoded after interpolation, as Cycles does
    associated: bool = False  # colour is multiplied by alpha
    key: str = ""  # content key; empty: computed from the texels
    name: str = ""

    def __post_init__(self) -> None:
        shape, dtype = self.texels.shape, self.texels.dtype
        if len(shape) != 3 or shape[2] != 4 or 0 in shape or dtype not in (np.uint8, np.float32):
            raise ValueError(f"Image {self.name!r} has texels {shape} of {dtype}, expected (H, W, 4) uint8 or float32")

    @cached_property
    def digest(self) -> str:
        content = self.key or hashlib.blake2b(np.ascontiguousarray(self.texels).data, digest_size=16).hexdigest()
        return f"{content} {self.texels.shape} {self.texels.dtype} {self.srgb} {self.associated}"

    @property
    def nbytes(self) -> int:
        return self.texels.nbytes

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.texels.shape[1], self.texels.shape[0]
