"""Pages of scans that are too large for memory as splats: what a material shows of them, and which filters keep.

What is read of a file is opaque: a material's alpha cuts out what it makes nearly invisible, and media have no part in
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.material.graph import Needs, needs
from ...core.numeric.record import value_record
from ...core.scene.cloud import PointCloud
from ...core.scene.streamed import PointSize
from . import arrays
from .point_shapes import PointShape
from .pointcloud import AS_GIVEN, Points, convert_points
from .sample_material import SampleMaterial
from .selection.filters import Filters, kept_points

COLOR = "Col"  # what imports call the colours of a scan
FLAT = 0.05  # shortest over longest half-axis: what is thinner is a disk


@value_record
class LinkedScan:
    """The file of an object that stands for a scan."""

    path: Path


class ScanLook:
    """How elements of pages become splats, by a material and filters: see core/scene/streamed.py."""

    def __init__(self, material: SampleMaterial, filters: Filters | None, shape: PointShape) -> None:
        self._material = replace(material, alpha=1.0, translucent=False, medium=None, extinction=0.0)
        self._filters, self._disks = filters, shape.kind != "BALLS"
        self.key = arrays.digest(self._material.key, filters, self._disks)

    def cloud(self, elements: Mapping[str, np.ndarray], additive: bool) -> PointCloud | None:
        """See core/scene/streamed.py."""
        count = len(elements["position"])
        if count == 0:
            return None
        rows, _ = kept_points(elements, self._filters) if self._filters else (None, ())
        if rows is not None:
            if len(rows) == 0:
                return None
            elements = {name: array[rows] for name, array in elements.items()}
        position = np.ascontiguousarray(elements["position"], np.float32)
        normal = elements.get("normal") if self._disks else None
        points = Points(position, np.zeros(len(position), np.float32), normal, colors=self._colors(elements))
        _, made = convert_points(points, self._material, lambda key, make: make(), AS_GIVEN)
        return replace(made, radii=None)

    def _colors(self, elements: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the material reads, (N, 4) float32 by name; colours come first, as what nodes without a name read."""
        wanted = needs(self._material.graph) if self._material.graph else Needs()
        found: dict[str, np.ndarray] = {}
        if "color" in elements and (self._material.row == 0 or {None, COLOR} & wanted.colors):
            found[COLOR] = _four(elements["color"])
        for name in sorted(n for n in wanted.colors if n is not None and n != COLOR):
            if name in elements and (elements[name].ndim == 1 or elements[name].shape[1] == 3):
                found[name] = _four(elements[name])
        return found


def _four(values: np.ndarray) -> np.ndarray:
    """Numbers (N,), vectors or colours (N, 3) as the colour output of an attribute node, (N, 4)."""
    found = np.ones((len(values), 4), np.float32)
    found[:, :3] = values if values.ndim > 1 else values[:, None]
    return found


def point_size(shape: PointShape) -> PointSize:
    """Returns the radius that an object's settings ask for."""
    return PointSize(shape.radius, shape.unit == "SPACING")
