"""Keeps packed hierarchies in a folder, one file for each content key.

A file holds, little-endian: magic (8 bytes), version (uint32), length of the header (uint32), blake2b digest
of all that follows (32 bytes), the header (JSON: layout, counts, origin, longest length), then the records of
points, of nodes, and the order (int32). Nothing is allocated before the claimed sizes agree with the file's.

The content key holds VERSION: files of another version are not found under it, and the hierarchy is built again.
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path

import numpy as np

from ..core.lod.hierarchy import Hierarchy
from ..core.lod.quantisation import Layout, Packed, pack, unpack
from ..core.scene.cloud import PointCloud
from .whole_file import write_whole

MAGIC = b"PSPLAT\r\n"
VERSION = 3
SUFFIX = ".pshier"
FIXED = struct.Struct("<8sII32s")
HEADER_LIMIT = 1 << 16  # bytes; a header has a few hundred


class CacheError(ValueError):
    """A cache file that cannot be used; the message names the file and what is wrong with it."""


def content_key(cloud: PointCloud, leaf_size: int) -> str:
    """A hexadecimal key (blake2b) that two clouds share only if all their attributes are equal, bit by bit."""
    digest = hashlib.blake2b(f"{VERSION} {leaf_size}".encode(), digest_size=20)
    digest.update(np.ascontiguousarray(cloud.origin, "<f8").tobytes())
    for name, array in cloud.arrays().items():
        digest.update(f"{name} {array.shape} {array.dtype.str}".encode())
        digest.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return digest.hexdigest()


def path_of(folder: Path | str, key: str) -> Path:
    """The path of a key's file. Any text may be a key: its hash is the file's name."""
    return Path(folder) / (hashlib.blake2b(key.encode(), digest_size=20).hexdigest() + SUFFIX)


def write(folder: Path | str, key: str, hierarchy: Hierarchy | Packed) -> Path:
    """Writes a hierarchy under `key`, quantised, and returns the file's path. Readers see the whole file or none, also
    where the machine fails: the file gets its name when its bytes are on the disk.

    The folder is made if it is missing. Raises OSError where it cannot be written.
    """
    packed = hierarchy if isinstance(hierarchy, Packed) else pack(hierarchy)
    header = _header(packed)
    parts = [header, *(_bytes(a) for a in (packed.points, packed.nodes, packed.order.astype("<i4")))]
    fixed = FIXED.pack(MAGIC, VERSION, len(header), _digest(parts))
    target = path_of(folder, key)
    write_whole(target, (fixed, *parts))
    return target


def read(folder: Path | str, key: str) -> Hierarchy | None:
    """The hierarchy under `key`; returns None if there is no file.

    Raises CacheError for a file that is damaged or of another kind, OSError where reading fails.
    """
    path = path_of(folder, key)
    try:
        with path.open("rb") as file:
            content = file.read()
    except FileNotFoundError:
        return None
    try:
        return unpack(_parse(memoryview(content)))
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise CacheError(f"{path}: {error}") from error


def _header(packed: Packed) -> bytes:
    layout = packed.layout
    return json.dumps({
        "normal": layout.normal,
        "axis": layout.axis,
        "radii": layout.radii,
        "attributes": layout.attributes,
        "points": len(packed.points),
        "nodes": len(packed.nodes),
        "origin": [float(x) for x in packed.origin],
        "longest": float(packed.longest),
    }).encode()  # fmt: skip


def _parse(content: memoryview) -> Packed:
    """The records in a file's bytes.

    Raises ValueError, KeyError, TypeError, OverflowError or RecursionError for anything that `write` would not have
    written.
    """
    if len(content) < FIXED.size:
        raise ValueError("truncated")
    magic, version, length, digest = FIXED.unpack_from(content)
    if magic != MAGIC:
        raise ValueError("not a hierarchy file")
    if version != VERSION:
        raise ValueError(f"version {version}, expected {VERSION}")
    body = content[FIXED.size :]
    if length > min(HEADER_LIMIT, len(body)):
        raise ValueError("truncated")
    if _digest([body]) != digest:
        raise ValueError("damaged: its checksum differs")
    header = json.loads(bytes(body[:length]))
    layout, counts = _layout(header), (header["points"], header["nodes"])
    if not all(type(n) is int and 0 <= n < 2**31 for n in counts):
        raise ValueError(f"impossible counts {counts}")
    kinds = (layout.dtype(nodes=False), layout.dtype(nodes=True), np.dtype("<i4"))
    sizes = [kind.itemsize * n for kind, n in zip(kinds, (*counts, counts[0]), strict=True)]
    if length + sum(sizes) != len(body):
        raise ValueError(f"{len(body) - length} bytes of records, expected {sum(sizes)}")
    ends = length + np.cumsum([0, *sizes])
    points, nodes, order = (np.frombuffer(body[a:b], k) for k, a, b in zip(kinds, ends[:-1], ends[1:], strict=True))
    origin, longest = np.array(header["origin"], np.float64), float(header["longest"])
    if origin.shape != (3,) or not np.isfinite(origin).all() or not 0 < longest < 3e38:
        raise ValueError("impossible origin or longest length")
    return Packed(layout, points, nodes, order.astype(np.int32), origin, longest)


def _layout(header: dict) -> Layout:
    """Raises ValueError, TypeError or KeyError for a layout that no hierarchy has."""
    if type(header["radii"]) is not int:
        raise ValueError("impossible layout")
    attributes = tuple((name, tuple(shape)) for name, shape in header["attributes"])
    return Layout(bool(header["normal"]), bool(header["axis"]), header["radii"], attributes)


def _digest(parts: list) -> bytes:
    digest = hashlib.blake2b(digest_size=32)
    for part in parts:
        digest.update(part)
    return digest.digest()


def _bytes(array: np.ndarray) -> memoryview:
    return np.ascontiguousarray(array).view(np.uint8).data
