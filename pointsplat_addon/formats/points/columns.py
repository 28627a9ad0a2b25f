"""Names of attributes: those that readers share, and how files spell them.

`position` and the tuples below are put together from columns of their own; all other attributes are one column each,
under the standard name where there is one and else under the file's.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .reader import Attribute, PointFileError

# Attributes that are tuples, and their components in order, by normalised names.
TUPLES: dict[str, tuple[tuple[str, ...], ...]] = {
    "position": (("x", "y", "z"), ("px", "py", "pz"), ("posx", "posy", "posz"), ("easting", "northing", "elevation"),
                 ("cartesianx", "cartesiany", "cartesianz"), ("longitude", "latitude", "elevation"),
                 ("longitude", "latitude", "height"), ("lon", "lat", "height")),
    "color": (("red", "green", "blue"), ("r", "g", "b"), ("diffusered", "diffusegreen", "diffuseblue"),
              ("colorred", "colorgreen", "colorblue"), ("rf", "gf", "bf")),
    "normal": (("nx", "ny", "nz"), ("normalx", "normaly", "normalz")),
    "velocity": (("vx", "vy", "vz"), ("velocityx", "velocityy", "velocityz")),
}  # fmt: skip
# Attributes of one column: the standard's names of LAS in lower case, and other spellings of them.
SPELLINGS = {
    "intensity": ("intensity", "i", "reflectance", "amplitude"),
    "classification": ("classification", "class", "label", "scalarclassification"),
    "return_number": ("returnnumber", "returnnum", "return"),
    "number_of_returns": ("numberofreturns", "numreturns"),
    "gps_time": ("gpstime", "time", "timestamp"),
    "scan_angle": ("scanangle", "scananglerank"),
    "scan_direction_flag": ("scandirectionflag",),
    "edge_of_flight_line": ("edgeofflightline",),
    "user_data": ("userdata",),
    "point_source_id": ("pointsourceid", "ptsrcid"),
    "scanner_channel": ("scannerchannel", "scanchannel"),
    "infrared": ("nir", "infrared", "nearinfrared"),
    "alpha": ("alpha", "a"),
    "radius": ("radius", "pscale"),
}
STANDARD = {spelling: name for name, spellings in SPELLINGS.items() for spelling in spellings}


def normalised(name: str) -> str:
    """The name in lower case, without what spellings differ by."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def attributes_of(columns: list[tuple[str, np.dtype]], path: Path) -> tuple[Attribute, ...]:
    """Returns the attributes that a file's columns make, the position first.

    Names that come twice are told apart by a number. Raises PointFileError where there is no position.
    """
    named = distinct([name for name, _ in columns])
    types = dict(zip(named, [np.dtype(dtype) for _, dtype in columns], strict=True))
    known = {}  # the first of each spelling
    for name in named:
        known.setdefault(normalised(name), name)
    found: dict[str, Attribute] = {}
    used: set[str] = set()
    for name, spellings in TUPLES.items():
        for spelling in spellings:
            if all(part in known for part in spelling):
                source = tuple(known[part] for part in spelling)
                dtype = np.dtype(np.float64) if name == "position" else np.result_type(*(types[s] for s in source))
                found[name] = Attribute(name, dtype, 3, source)
                used.update(source)
                break
    if "position" not in found:
        raise PointFileError(path, f"has no columns x, y and z, but {', '.join(named) or 'none'}")
    for name in named:
        if name not in used:
            standard = STANDARD.get(normalised(name), name)
            standard = name if standard in found else standard
            found[standard] = Attribute(standard, types[name], 1, (name,))
    return tuple(found.values())


def distinct(names: list[str]) -> list[str]:
    """The names, later ones that equal earlier ones with a number behind them."""
    taken: dict[str, int] = {}
    found = []
    for name in names:
        taken[name] = taken.get(name, 0) + 1
        found.append(name if taken[name] == 1 else f"{name}_{taken[name]}")
    return found


def assemble(records: dict[str, np.ndarray] | np.ndarray, attributes: list[Attribute]) -> dict[str, np.ndarray]:
    """Returns the attributes of records, whose columns are fields of a structured array or entries of a dictionary."""
    found = {}
    for attribute in attributes:
        parts = [np.asarray(records[name]) for name in attribute.source]
        value = parts[0] if attribute.components == 1 else np.stack(parts, axis=-1)
        found[attribute.name] = np.ascontiguousarray(value, attribute.dtype.newbyteorder("="))
    return found
