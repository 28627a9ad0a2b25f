"""Captured Gaussian splats, as training left them (Kerbl et al. 2023)."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..numeric.record import record

COEFFICIENTS = (3, 8, 15, 24)  # of spherical harmonics of degree 1, of degrees 1 and 2, 1 to 3, 1 to 4


@record
class CapturedSplats:
    """Gaussians that emit light, in object units relative to `origin`.

    Coefficients are those of real spherical harmonics in the order and with the signs that Kerbl et al. use, of display
    values (sRGB) less a half, in the object's axes.
    """

    position: np.ndarray  # (N, 3) float32, relative to origin
    scale: np.ndarray  # (N, 3) float32, standard deviations along the splat's own axes; a third one of 0: a disk
    rotation: np.ndarray  # (N, 4) float32, unit quaternions w, x, y, z that turn those axes
    base: np.ndarray  # (N, 3) float32, coefficients of degree 0
    opacity: np.ndarray  # (N,) float32, 0 to 1, at the centre
    sh: np.ndarray | None = None  # (N, K, 3) float32, coefficients of higher degrees: K of COEFFICIENTS
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, object space
    antialiased: bool = False  # trained so that what the low-pass widens loses opacity (Yu et al. 2024)

    def __post_init__(self) -> None:
        """Raise ValueError where an attribute's shape or dtype does not fit."""
        count = len(self.position)
        shapes = {"position": (3,), "scale": (3,), "rotation": (4,), "base": (3,), "opacity": ()}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != (count, *shape) or array.dtype != np.float32:
                raise ValueError(f"CapturedSplats.{name} is {array.dtype} {array.shape} for {count} splats")
        if self.sh is not None and (
            self.sh.dtype != np.float32 or self.sh.shape not in [(count, k, 3) for k in COEFFICIENTS]
        ):
            raise ValueError(f"CapturedSplats.sh is {self.sh.dtype} {self.sh.shape} for {count} splats")

    def __len__(self) -> int:
        return len(self.position)

    @property
    def nbytes(self) -> int:
        arrays = (self.position, self.scale, self.rotation, self.base, self.opacity, self.sh)
        return sum(array.nbytes for array in arrays if array is not None)
