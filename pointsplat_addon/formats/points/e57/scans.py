"""Reads E57 (ASTM E2807): all scans of a file, each with its pose, its fields, and flags of what is no point.

libE57's wheels would be half of what the extension may weigh (17 MB for each Python on Linux), and lighter readers know
neither poses nor flags; so this one reads what it needs, in chunks. Tests compare it with pye57.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ....core.numeric.record import record
from ....core.numeric.rotations import rotation_matrices
from ..columns import STANDARD, normalised
from ..reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .pages import Pages
from .records import Field, records

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
COLORS = ("colorRed", "colorGreen", "colorBlue")
NORMALS = ("normalX", "normalY", "normalZ")
INVALID = ("cartesianInvalidState", "sphericalInvalidState")
RENAMED = {"timeStamp": "gps_time", "returnIndex": "return_number", "returnCount": "number_of_returns"}
MOST_TEXT = 1 << 28  # bytes of XML


@record
class Scan:
    """One scan of a file."""

    place: int  # of its points, among the bytes without checksums
    count: int
    fields: list[Field]
    pose: np.ndarray | None  # (4, 4) float64, world from scanner

    def has(self, names: Collection[str]) -> bool:
        return {field.name for field in self.fields} >= set(names)


class E57Reader(FileReader):
    """All scans of an E57 file."""

    def __init__(self, path: Path) -> None:
        self._path, self.warnings = path, []
        self._pages = Pages(path)
        if self._pages.xml_length > MOST_TEXT:
            raise PointFileError(path, f"has {self._pages.xml_length:,} bytes of text")
        text = self._pages.read(self._pages.xml_place, self._pages.xml_length)
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise PointFileError(path, f"has text that cannot be read: {error}") from None
        self._scans = [self._scan(item) for item in _children(root, "data3D") if _child(item, "points") is not None]
        poses = [scan.pose for scan in self._scans if scan.pose is not None]
        several = len(self._scans) > 1
        attributes = _attributes(self._scans)
        attributes += [Attribute("station", np.dtype(np.int32))] if several and len(poses) == len(self._scans) else []
        stations = np.array([pose[:3, 3] for pose in poses]).reshape(-1, 3)
        bounds = self._bounds(root)
        self.header = Header(
            path,
            f"E57 of {len(self._scans)} scan{'' if len(self._scans) == 1 else 's'}",
            sum(scan.count for scan in self._scans),
            tuple(attributes),
            bounds,
            origin_of(bounds, stations),
            crs=_text(root, "coordinateMetadata"),
            stations=stations,
        )

    def _scan(self, item: ElementTree.Element) -> Scan:
        points = _child(item, "points")
        assert points is not None
        prototype = _child(points, "prototype")
        fields = [] if prototype is None else [self._field(child) for child in prototype]
        try:
            place, count = int(points.get("fileOffset", "")), int(points.get("recordCount", ""))
        except ValueError:
            raise PointFileError(self._path, "has a scan that does not say where its points are") from None
        found = Scan(self._pages.logical(place), count, fields, _pose(item))
        bits = sum(field.width for field in fields)
        if count < 0 or count * bits > 8 * self._pages.size:
            raise PointFileError(self._path, f"promises {count:,} points, for which it is too short")
        if count and not (found.has(CARTESIAN) or found.has(SPHERICAL)):
            raise PointFileError(self._path, f"has a scan without positions, of {', '.join(f.name for f in fields)}")
        return found

    def _field(self, child: ElementTree.Element) -> Field:
        name, kind = _local(child.tag), child.get("type")
        try:
            if kind == "Float":
                return Field(name, np.dtype("<f4" if child.get("precision") == "single" else "<f8"))
            if kind in ("Integer", "ScaledInteger"):
                least = int(child.get("minimum", -(1 << 63)))
                most = int(child.get("maximum", (1 << 63) - 1))
                bits = (most - least).bit_length() if most >= least else 65
                if bits <= 64:
                    scale = float(child.get("scale", 1.0)) if kind == "ScaledInteger" else None
                    return Field(name, None, least, bits, scale, float(child.get("offset", 0.0)))
        except ValueError:
            pass
        raise PointFileError(self._path, f'has a field "{name}" of the type {kind} whose limits make no sense')

    def _bounds(self, root: ElementTree.Element) -> np.ndarray | None:
        """Of all scans, in the world's coordinates; None where one does not tell its own."""
        found = []
        for item, scan in zip(
            (i for i in _children(root, "data3D") if _child(i, "points") is not None), self._scans, strict=True
        ):
            box = _child(item, "cartesianBounds")
            if box is None:
                return None
            try:
                corner = np.array([[float(_text(box, axis + end)) for axis in "xyz"] for end in ("Minimum", "Maximum")])
            except ValueError:
                return None
            corners = np.array([[corner[i >> k & 1, k] for k in range(3)] for i in range(8)])
            found.append(corners if scan.pose is None else corners @ scan.pose[:3, :3].T + scan.pose[:3, 3])
        if not found:
            return None
        corners = np.concatenate(found)
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        for number, scan in enumerate(self._scans):
            for values in records(self._pages, self._path, scan.place, scan.count, scan.fields, size):
                valid = np.ones(len(next(iter(values.values()))), bool)
                for name in INVALID:
                    valid &= values[name] == 0 if name in values else True
                values = values if valid.all() else {name: value[valid] for name, value in values.items()}
                count = int(valid.sum())
                found = {"position": _positions(values, scan)}
                for attribute in wanted[1:]:
                    if attribute.name == "station":
                        found["station"] = np.full(count, number, np.int32)
                    else:
                        found[attribute.name] = _column(values, attribute, count, scan.pose)
                yield found

    def close(self) -> None:
        self._pages.close()


def _positions(values: Columns, scan: Scan) -> np.ndarray:
    if CARTESIAN[0] in values:
        position = np.stack([values[name].astype(np.float64) for name in CARTESIAN], axis=1)
    else:
        distance, azimuth, elevation = (values[name].astype(np.float64) for name in SPHERICAL)
        across = distance * np.cos(elevation)
        position = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    return position if scan.pose is None else position @ scan.pose[:3, :3].T + scan.pose[:3, 3]


def _column(values: Columns, attribute: Attribute, count: int, pose: np.ndarray | None) -> np.ndarray:
    """Values of an attribute; zeros where this scan lacks it."""
    if not all(name in values for name in attribute.source):
        shape = (count,) if attribute.components == 1 else (count, attribute.components)
        return np.zeros(shape, attribute.dtype)
    parts = [values[name] for name in attribute.source]
    found = parts[0] if len(parts) == 1 else np.stack(parts, axis=1)
    if attribute.name == "normal" and pose is not None:
        found = found @ pose[:3, :3].T
    return np.ascontiguousarray(found, attribute.dtype)


def _attributes(scans: list[Scan]) -> list[Attribute]:
    """The attributes of all scans."""
    types: dict[str, np.dtype] = {}
    for field in (field for scan in scans for field in scan.fields):
        known = types.get(field.name, field.value_type)
        types[field.name] = np.result_type(known, field.value_type)
    found = [Attribute("position", np.dtype(np.float64), 3, CARTESIAN)]
    for name, source in (("color", COLORS), ("normal", NORMALS)):
        if all(part in types for part in source):
            found.append(Attribute(name, np.result_type(*(types.pop(part) for part in source)), 3, source))
    for name, dtype in types.items():
        if name not in (*CARTESIAN, *SPHERICAL, *INVALID):
            standard = RENAMED.get(name, STANDARD.get(normalised(name), name))
            found.append(Attribute(standard, dtype, 1, (name,)))
    return found


def _pose(item: ElementTree.Element) -> np.ndarray | None:
    """World from scanner (4, 4) float64; None: the scan has no pose."""
    pose = _child(item, "pose")
    if pose is None:
        return None
    found = np.eye(4)
    rotation, translation = _child(pose, "rotation"), _child(pose, "translation")
    if rotation is not None:
        w, x, y, z = (_number(rotation, name) for name in "wxyz")
        length = np.sqrt(w * w + x * x + y * y + z * z)
        if 0 < length < np.inf:
            found[:3, :3] = rotation_matrices(np.array([w, x, y, z]) / length)
    if translation is not None:
        found[:3, 3] = [_number(translation, name) for name in "xyz"]
    return found if np.isfinite(found).all() else None


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]


def _child(item: ElementTree.Element, name: str) -> ElementTree.Element | None:
    return next((child for child in item if _local(child.tag) == name), None)


def _children(item: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    child = _child(item, name)
    return [] if child is None else list(child)


def _text(item: ElementTree.Element, name: str) -> str:
    child = _child(item, name)
    return "" if child is None or child.text is None else child.text.strip()


def _number(item: ElementTree.Element, name: str) -> float:
    try:
        return float(_text(item, name) or 0.0)
    except ValueError:
        return 0.0
