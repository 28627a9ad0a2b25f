"""Shapes of the points of a PointCloud object: balls, disks, or ellipses that close the surface of a scan.

What neighbourhoods tell of the points is kept by their positions' content, and written into nobody's data.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import bpy
import numpy as np

from ...core.numeric.record import value_record
from ...core.surface.nearest import scan_spacing
from ...core.surface.neighbourhoods.estimate import Ellipses, estimate_ellipses, turn_towards
from . import arrays

STATIONS = "pointsplat_stations"  # custom property of an object: scanner positions, three doubles each
STATION = "station"  # attribute: the row of the station that saw a point
Lookup = Callable[[str, Callable[[], Any]], Any]  # the object of a key, made only if it is not known


@value_record
class PointShape:
    """How the points of an object are drawn. A radius of 0 takes what the points have."""

    kind: str = "GIVEN"  # BALLS, DISKS, SURFACE; GIVEN: disks across their normals, where they have some
    radius: float = 0.0  # in units of `unit`; of SURFACE the greatest half-axis
    unit: str = "OBJECT"  # SPACING: the median distance between neighbours
    stations: tuple[float, ...] = ()  # x, y, z of each, object units

    @property
    def estimates(self) -> bool:
        """Whether it asks the points' neighbourhoods."""
        return self.kind in ("DISKS", "SURFACE")


AS_GIVEN = PointShape()


class Elements(NamedTuple):
    """Centres (N, 3), normals (N, 3), major axes (N, 3) or None and half-axes (N,) or (N, 2) of points."""

    position: np.ndarray
    normal: np.ndarray
    axis: np.ndarray | None
    radii: np.ndarray


def shape_of(ob: bpy.types.Object) -> PointShape:
    """Returns the shape that an object's settings ask for."""
    settings = ob.pointsplat
    if ob.type != "POINTCLOUD":
        return PointShape(radius=settings.radius)
    radius = 0.0 if settings.radius_unit == "PIXELS" else settings.radius
    found = ob.original.get(STATIONS, ()) if settings.shape in ("DISKS", "SURFACE") else ()
    stations = tuple(float(x) for x in found)
    return PointShape(settings.shape, radius, settings.radius_unit, stations[: len(stations) // 3 * 3])


def pixel_radius_of(ob: bpy.types.Object) -> float:
    """Returns the radius in pixels of every view; 0 where the points have one in space."""
    settings = ob.pointsplat
    return settings.radius if ob.type == "POINTCLOUD" and settings.radius_unit == "PIXELS" else 0.0


def station_of(data: Any) -> np.ndarray | None:
    """Which station saw each point, (N,) int32; None without such an attribute."""
    attribute = data.attributes.get(STATION)
    if attribute is None or attribute.domain != "POINT" or attribute.data_type not in ("INT", "INT8"):
        return None
    found = np.empty(len(attribute.data), np.int32)
    attribute.data.foreach_get("value", found)
    return found


def radius_of(shape: PointShape, position: np.ndarray) -> float:
    """Returns the radius in object units; 0 where the points have their own."""
    if shape.radius > 0 and shape.unit == "SPACING":
        return shape.radius * scan_spacing(position)
    return shape.radius


def elements(
    shape: PointShape,
    position: np.ndarray,
    radius: np.ndarray,
    normal: np.ndarray | None,
    station: np.ndarray | None,
    lookup: Lookup,
) -> Elements:
    """Returns disks or ellipses for points (N, 3) with radii (N,), and normals (N, 3) and stations (N,) if known.

    Normals look to the station that saw the point, else to the side of the given normals, else upwards. Disks have the
    given normals. Ellipses lie in the planes of their neighbours. Points that lie on no surface have the normal zero:
    they are balls.
    """
    found: Ellipses = lookup(
        f"ellipses {arrays.digest(position)}", lambda: estimate_ellipses(np.ascontiguousarray(position, np.float32))
    )
    directions = found.normal.copy()
    if shape.stations:
        places = np.array(shape.stations, np.float32).reshape(-1, 3)
        row = np.zeros(1, np.int32) if station is None else np.clip(station, 0, len(places) - 1)
        turn_towards(directions, position, places[row] if len(row) > 1 else places[row[0]])
    elif normal is not None:
        turn_towards(directions, np.zeros_like(normal), normal)
    if shape.kind == "DISKS":
        if normal is not None:
            given = np.isfinite(normal).all(axis=1) & normal.any(axis=1)
            directions = np.where(given[:, None], arrays.unit_or_up(normal), directions).astype(np.float32)
        return Elements(position, directions, None, radius)
    radii = found.radii
    limit = radius_of(shape, position)
    radii = np.minimum(radii, np.float32(limit)) if limit > 0 else radii
    return Elements(position + found.offset, directions, found.axis, radii)
