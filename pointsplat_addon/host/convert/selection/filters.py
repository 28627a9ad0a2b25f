"""Filters of a PointCloud object: its points are kept by class, height, distance or any attribute.

They are evaluated before anything is made of the points: what is left out is no neighbour of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import bpy
import numpy as np

from ....core.numeric.record import value_record
from ....core.numeric.vectors import each_block
from .. import arrays
from ..point_shapes import STATION, STATIONS, station_of

ORIGIN = "pointsplat_origin"  # custom property of an object: map coordinates of its own origin, three doubles
ATTRIBUTES = {
    "CLASS": "classification",
    "INTENSITY": "intensity",
    "RETURN": "return_number",
    "TIME": "gps_time",
}  # by kind of filter, as importers name them


class FilterError(ValueError):
    """A filter that cannot be evaluated; the message does not name the object."""


@value_record
class PointFilter:
    """One condition; points whose value is not a number do not meet it, inverted or not."""

    kind: str  # a key of ATTRIBUTES, HEIGHT, DISTANCE or ATTRIBUTE
    attribute: str = ""  # of ATTRIBUTE
    classes: str = ""  # of CLASS: numbers such as "2, 6"; empty: all
    low: float = 0.0  # least and greatest value of the other kinds
    high: float = 0.0
    inverted: bool = False


@value_record
class Filters:
    """The filters of one object, all of which its points must meet."""

    filters: tuple[PointFilter, ...]
    height: float = 0.0  # on the map, of the object's origin
    stations: tuple[float, ...] = ()  # x, y, z of each scanner position, object units; none: the object's origin


def filters_of(ob: bpy.types.Object) -> Filters | None:
    """The filters of an object that are in use; None without any."""
    if ob.type != "POINTCLOUD" or len(ob.pointsplat.filters) == 0:
        return None
    found = tuple(
        PointFilter(f.kind, f.attribute, f.classes, f.low, f.high, f.invert) for f in ob.pointsplat.filters if f.use
    )
    if not found:
        return None
    kinds = {f.kind for f in found}
    height = _numbers(ob, ORIGIN)[2:3] if "HEIGHT" in kinds else ()
    stations = _numbers(ob, STATIONS) if "DISTANCE" in kinds else ()
    return Filters(found, *height, stations=stations) if height else Filters(found, stations=stations)


def kept_points(data: Any, filters: Filters) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """Rows (K,) of the points of a point cloud, or of columns by name, that meet all filters, None for all; and what
    went wrong.

    A filter that cannot be evaluated keeps all points.
    """
    if _count(data) == 0:  # not even positions
        return None, ()
    kept = np.ones(_count(data), bool)
    messages = []
    for one in filters.filters:
        try:
            kept &= _met(data, one, filters)
        except FilterError as error:
            messages.append(f"{error}: this filter is left out")
    return None if kept.all() else np.flatnonzero(kept), tuple(messages)


def values(data: Any, kind: str, attribute: str, filters: Filters) -> np.ndarray:
    """What a filter compares: (N,) of any type of numbers. Raises FilterError where there is no such attribute."""
    if kind in ("HEIGHT", "DISTANCE"):
        position = _attribute(data, "position", "its points")
        if kind == "HEIGHT":
            return position[:, 2] + np.float64(filters.height)
        return _distance(data, position, filters.stations)
    found = _attribute(data, ATTRIBUTES.get(kind, attribute), kind.lower())
    if found.ndim == 1:
        return found
    # A colour's alpha is not part of its length.
    return np.sqrt(np.einsum("ij,ij->i", found[:, :3], found[:, :3], dtype=np.float64))


def _count(data: Any) -> int:
    return len(data["position"]) if isinstance(data, Mapping) else len(data.points)


def class_numbers(text: str) -> frozenset[int]:
    """The numbers of classes that a text such as "2, 6" lists. Raises FilterError where it has something else."""
    words = text.replace(",", " ").split()
    if not all(word.isascii() and word.isdigit() for word in words):
        raise FilterError(f'Classes are numbers such as 2, 6; "{text}" has something else')
    return frozenset(map(int, words))


def _met(data: Any, one: PointFilter, filters: Filters) -> np.ndarray:
    """(N,) bool: which points meet a filter."""
    classes = class_numbers(one.classes) if one.kind == "CLASS" else frozenset()
    if one.kind == "CLASS" and not classes:
        return np.ones(_count(data), bool)
    value = values(data, one.kind, one.attribute, filters)
    met = np.empty(len(value), bool)

    def fill(block: slice) -> None:
        part = value[block]
        found = np.isin(part, list(classes)) if classes else (part >= one.low) & (part <= one.high)
        if one.inverted:
            found = ~found & (part == part)
        met[block] = found

    each_block(len(value), fill)
    return met


def _attribute(data: Any, name: str, what: str) -> np.ndarray:
    """An attribute of the points as numbers, (N,) or (N, 3 | 4)."""
    if isinstance(data, Mapping):
        if name not in data:
            raise FilterError(
                f'There is no attribute "{name}" to filter by' if name else f"The filter by {what} names none"
            )
        return data[name]
    attribute = data.attributes.get(name)
    if attribute is None or attribute.domain != "POINT" or len(attribute.data) != len(data.points):
        raise FilterError(
            f'There is no attribute "{name}" to filter by' if name else f"The filter by {what} names none"
        )
    kind = attribute.data_type
    if kind in arrays.NUMBER_TYPES:
        return arrays.values(attribute, 1, arrays.NUMBER_TYPES[kind])
    if kind in arrays.COLOR_TYPES:
        return arrays.scene_linear(arrays.stored_colors(attribute))
    if kind == "FLOAT_VECTOR":
        return arrays.values(attribute, 3, np.float32)
    raise FilterError(f'The attribute "{name}" is of a type that filters cannot read ({kind})')


def _distance(data: Any, position: np.ndarray, stations: Iterable[float]) -> np.ndarray:
    """(N,) float32 distances of points (N, 3) to the scanner that saw them, else to the object's origin."""
    places = np.array(tuple(stations) or (0.0, 0.0, 0.0), np.float32).reshape(-1, 3)
    row = None
    if len(places) > 1:
        row = data.get(STATION) if isinstance(data, Mapping) else station_of(data)
    found = np.empty(len(position), np.float32)

    def fill(block: slice) -> None:
        start = places[0] if row is None else places[np.clip(row[block], 0, len(places) - 1)]
        found[block] = np.linalg.norm(position[block] - start, axis=1)

    each_block(len(position), fill)
    return found


def _numbers(ob: bpy.types.Object, name: str) -> tuple[float, ...]:
    """A custom property of the original object that holds points, three numbers each; () without."""
    found = ob.original.get(name, ())
    try:
        numbers = tuple(float(x) for x in found)
    except (TypeError, ValueError):  # somebody else's property
        return ()
    return numbers[: len(numbers) // 3 * 3]
