"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FLAT_RATIO = 0.02  # a section whose variances across and along are in a smaller ratio is none of a tube
AREA_ERROR = 0.2  # by which a ribbon's area may differ from its triangles'
NUDGE = 1e-6  # of a section's distance from the next, so that no cut goes through a vertex


@dataclass(frozen=True, eq=False)
class FittedStrands:
    """Strands of a mesh: P points in S strands, tubes and ribbons one after another."""

    position: np.ndarray  # (P, 3) float64
    radius: np.ndarray  # (P,) float64
    normal: np.ndarray  # (P, 3) float64, of ribbons; 0 on tubes
    start: np.ndarray  # (S + 1,) int64
    ribbon: np.ndarray  # (S,) bool
    triangle: np.ndarray  # (S,) int64: one of the strand's triangles, for its material and place
    left: np.ndarray  # (T,) bool: triangles that stay
    parts: int  # of the mesh
    stay: int  # parts that remain polygons

    def __len__(self) -> int:
        return len(self.start) - 1


PartStrands = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # points, radii, normals, counts, parts


def no_strands() -> PartStrands:
    empty = np.zeros(0, np.int64)
    return np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), empty, empty
