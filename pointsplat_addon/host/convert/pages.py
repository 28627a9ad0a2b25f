"""Pages of scans that are too large for memory as splats: what a material shows of them, and which filters keep.

What is read of a file is opaque: a material's alpha cuts out what it makes nearly invisible, and media have no part in
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.lod.balls.covered import node_shape
from ...core.material.graph import Needs, needs
from ...core.numeric.record import value_record
from ...core.scene.cloud import PointCloud
from ...core.scene.scene import PageSplats, PointSize
from ...core.surface.appearance import CLIP
from . import arrays
from .point_shapes import PointShape
from .point_shapes import elements as closing_elements
from .pointcloud import Points, appearance_of
from .sample_material import SampleMaterial
from .selection.filters import Filters, kept_points

AXIS, HALF_AXES = "major axis", "half-axes"  # of ellipses that were found for points
COLOR = "Col"  # what imports call the colours of a scan


@value_record
class LinkedScan:
    """The file of an object that stands for a scan."""

    path: Path


class ScanLook:
    """How elements of pages become splats, by a material and filters: see core/scene/scene.py."""

    def __init__(self, material: SampleMaterial, filters: Filters | None, shape: PointShape) -> None:
        self._material = replace(material, alpha=1.0, translucent=False, medium=None, extinction=0.0)
        self._filters, self._shape = filters, shape
        self.key = arrays.digest(
            self._material.key, filters, shape.kind, shape if shape.kind == "SURFACE" else shape.stations
        )

    def splats(self, elements: Mapping[str, np.ndarray], additive: bool) -> PageSplats | None:
        """See core/scene/scene.py."""
        if len(elements["position"]) == 0:
            return None
        rows, _ = kept_points(elements, self._filters) if self._filters else (None, ())
        elements = elements if rows is None else _taken(elements, rows)
        if len(elements["position"]) == 0:
            return None
        nodes, disks = "radii" in elements, self._shape.kind != "BALLS" and "radii" not in elements
        if disks and self._shape.kind == "SURFACE" and not additive:
            elements = _closed(elements, self._shape)
        elif disks and self._shape.estimates and "normal" not in elements:
            elements = _faced(elements, self._shape)
        position = np.ascontiguousarray(elements["position"], np.float32)
        points = Points(position, None, elements.get("normal") if disks else None, colors=self._colors(elements))
        look = appearance_of(points, self._material)
        alpha = look.pop("alpha", None)
        if alpha is not None and not (alpha >= CLIP).all():
            seen = np.flatnonzero(alpha >= CLIP)
            elements, look = _taken(elements, seen), _taken(look, seen)
        if self._material.row:
            look["material"] = np.full(len(look["position"]), self._material.row, np.uint16)
        if not nodes:
            ellipses = {name: elements[of] for name, of in (("axis", AXIS), ("radii", HALF_AXES)) if of in elements}
            return PageSplats(PointCloud(**look, **ellipses))
        shape, radius = node_shape(*(elements[name] for name in ("normal", "axis", "radii", "covered")))
        share = np.ascontiguousarray(elements["covered"], np.float32)
        return PageSplats(PointCloud(**look, radii=radius[:, None], share=share), shape)

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


def _closed(elements: Mapping[str, np.ndarray], shape: PointShape) -> dict[str, np.ndarray]:
    """Points of a page as ellipses that close the surface: their neighbours are those in the page."""
    position = np.ascontiguousarray(elements["position"], np.float32)
    radius = np.zeros(len(position), np.float32)
    found = closing_elements(shape, position, radius, elements.get("normal"), None, lambda _key, make: make())
    half = found.radii if found.radii.ndim == 2 else found.radii[:, None]
    columns = {"position": found.position, "normal": found.normal, HALF_AXES: half}
    return {**elements, **columns, **({} if found.axis is None else {AXIS: found.axis})}


def _faced(elements: Mapping[str, np.ndarray], shape: PointShape) -> dict[str, np.ndarray]:
    """Points of a page with normals across their neighbours in the page, zero where these make no surface."""
    position = np.ascontiguousarray(elements["position"], np.float32)
    disks, radius = replace(shape, kind="DISKS"), np.zeros(len(position), np.float32)
    found = closing_elements(disks, position, radius, None, None, lambda _key, make: make())
    return {**elements, "normal": found.normal}


def _taken(columns: Mapping[str, np.ndarray], rows: np.ndarray) -> dict[str, np.ndarray]:
    return {name: array[rows] for name, array in columns.items()}


def _four(values: np.ndarray) -> np.ndarray:
    """Numbers (N,), vectors or colours (N, 3) as the colour output of an attribute node, (N, 4)."""
    found = np.ones((len(values), 4), np.float32)
    found[:, :3] = values if values.ndim > 1 else values[:, None]
    return found


def point_size(shape: PointShape) -> PointSize:
    """Returns the radius that an object's settings ask for."""
    return PointSize(shape.radius, shape.unit == "SPACING")
