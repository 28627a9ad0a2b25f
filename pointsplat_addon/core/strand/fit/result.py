"""Strands fitted to a mesh, and the tolerances that several kinds of fits share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from ...numeric.record import record

FLAT_RATIO = 0.02  # least ratio of the two variances of a section of a tube
AREA_ERROR = 0.2  # by which a ribbon's area may differ from that of its triangles, relative
NUDGE = 1e-6  # of a section's distance from the next, so that no cut goes through a vertex


@record
class FittedStrands:
    """Strands fitted to a mesh: P points in S strands, tubes and ribbons, one after another."""

    position: np.ndarray  # (P, 3) float64
    radius: np.ndarray  # (P,) float64
    normal: np.ndarray  # (P, 3) float64, of ribbons; 0 on tubes
    start: np.ndarray  # (S + 1,) int64
    ribbon: np.ndarray  # (S,) bool
    triangle: (
        np.ndarray
    )  # (S,) int64: one of the triangles that the strand stands for: its material and texture coordinates
    remaining: np.ndarray  # (T,) bool: triangles that stay polygons
    parts: int  # connected parts of the mesh
    remaining_parts: int  # parts that stay polygons

    def __len__(self) -> int:
        return len(self.start) - 1


@record
class PartStrands:
    """Strands that one kind of fit found: P points in S strands, one after another."""

    position: np.ndarray  # (P, 3) float64
    radius: np.ndarray  # (P,) float64
    normal: np.ndarray  # (P, 3) float64, unit on ribbons, 0 on tubes
    count: np.ndarray  # (S,) int64: points of each strand
    part: np.ndarray  # (S,) int64: the part of the mesh that each strand stands for

    def __len__(self) -> int:
        return len(self.count)


def no_strands() -> PartStrands:
    """A fit that found nothing."""
    empty = np.zeros(0, np.int64)
    return PartStrands(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), empty, empty)


def concatenate_strands(fits: Sequence[PartStrands]) -> PartStrands:
    """The strands of several fits, one fit after another."""
    return PartStrands(*(np.concatenate([getattr(fit, field.name) for fit in fits]) for field in fields(PartStrands)))
