"""Surfels: small flat pieces of all surfaces of a scene, of which the light tree is built."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..numeric.record import record

OF_SOME = {"captured": bool, "raised": np.float32, "returned": np.float32, "fine": bool}  # arrays that may be None
ARRAYS = "position", "normal", "area", "closed", "scattered", "albedo", "emission", "edge", "half"


@record
class Surfels:
    """N pieces of surface in world space, relative to `origin`."""

    origin: np.ndarray  # (3,) float64
    position: np.ndarray  # (N, 3) float32
    normal: np.ndarray  # (N, 3) float32, unit; (0, 0, 0): turned to every side, as a ball is
    area: np.ndarray  # (N,) float32: of one side; of a ball its whole surface
    closed: np.ndarray  # (N,) bool: of a closed surface, whose inside nobody sees
    scattered: np.ndarray  # (N,) bool: leaves and hairs, which do not tile a surface
    albedo: np.ndarray  # (N, 3) float32: share of the light that falls on it which it scatters
    emission: np.ndarray  # (N, 3) float32: radiance
    # (N, 3) float32: one side of the rectangle that it is, or of the triangle, from whose right angle the other one
    # lies on the left, seen from before; (0, 0, 0): any shape of about equal width. Of hairs the way they run
    edge: np.ndarray
    half: np.ndarray  # (N,) bool: it is a triangle, half of a rectangle
    # (N,) bool: it stands for captured splats (core/indirect/captured.py), on which light falls only where they scatter
    # some; None: none does
    captured: np.ndarray | None = None
    # (N,) float32: how far above it, on both sides, light falls on what it stands for; None: on itself
    raised: np.ndarray | None = None
    # (N,) float32: share of the light that it sends on which falls on what it stands for again, in hollows between
    # balls; None: of none
    returned: np.ndarray | None = None
    fine: np.ndarray | None = None  # (N,) bool: it stands for triangles smaller than it, near it; None: none does

    def __len__(self) -> int:
        return len(self.area)

    def take(self, rows: np.ndarray) -> Surfels:
        """Returns the surfels `rows`, in their order."""
        held = {name: getattr(self, name) for name in OF_SOME}
        some = {name: None if of is None else of[rows] for name, of in held.items()}
        return Surfels(self.origin, *(getattr(self, name)[rows] for name in ARRAYS), **some)

    @property
    def hairs(self) -> np.ndarray:
        """(N,) bool: pieces of hairs."""
        return self.scattered & ~self.normal.any(axis=1)

    @property
    def receiving(self) -> np.ndarray:
        """(n,) int64: those that light falls on."""
        if self.captured is None:
            return np.arange(len(self))
        return np.flatnonzero(~self.captured | self.albedo.any(axis=1))


def joined(parts: Sequence[Surfels]) -> Surfels:
    """Returns all surfels of at least one part; they have one origin."""
    arrays = (np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS)
    return Surfels(parts[0].origin, *arrays, **{name: _joined(parts, name, of) for name, of in OF_SOME.items()})


def _joined(parts: Sequence[Surfels], name: str, dtype: type) -> np.ndarray | None:
    """An array of all parts, zero for those that have none; None: no part has."""
    if all(getattr(part, name) is None for part in parts):
        return None
    return np.concatenate(
        [np.zeros(len(part), dtype) if getattr(part, name) is None else getattr(part, name) for part in parts]
    )
