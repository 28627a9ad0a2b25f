"""Strands: hair, curves, ribbons and tubes, as polylines with radii (Marroquim et al. 2008, section 4)."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..numeric.record import record


@record
class Strands:
    """Strands of one object, in object space: P points in S strands, one after another.

    A strand without normals is a tube, which is round; one with normals is a ribbon, flat and two-sided, as wide as the
    tube would be. What varies along strands is linear between their points.
    """

    key: str  # content key: equal keys mean equal arrays
    name: str  # the object's name, for messages
    position: np.ndarray  # (P, 3) float32, relative to origin
    start: (
        np.ndarray
    )  # (S + 1,) int64: the points of strand s are start[s] .. start[s + 1] - 1; a closed one ends as it began
    radius: np.ndarray  # (P,) float32, half the width
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64
    normal: np.ndarray | None = None  # (P, 3) float32, unit: ribbons; None: tubes
    color: np.ndarray | None = None  # (P, 3) float32, scene-linear base colour; None: the material's
    surface: np.ndarray | None = None  # (P, 2) float32: roughness, metallic; None: the material's
    emission: np.ndarray | None = None  # (P, 3) float32 radiance; None: the material's
    uv: np.ndarray | None = None  # (S, 2) float32: where each strand grows on its surface
    material: np.ndarray | None = None  # (S,) uint16, rows of Scene.materials; None: all `materials[0]`
    materials: tuple[int, ...] = (0,)  # the rows in use

    def __len__(self) -> int:
        """How many strands."""
        return len(self.start) - 1

    @property
    def nbytes(self) -> int:
        arrays = (self.position, self.start, self.radius, self.normal, self.color, self.surface, self.emission, self.uv,
                  self.material)  # fmt: skip
        return sum(a.nbytes for a in arrays if a is not None)
