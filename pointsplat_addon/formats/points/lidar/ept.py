"""Reads Entwine Point Tiles: a folder with ept.json, an octree of files of points, level by level.

Nodes are named depth-x-y-z. Data are LAZ, records of the schema, or those compressed by Zstandard.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ..columns import assemble, attributes_of
from ..reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .las import LasReader

KINDS = {"signed": "i", "unsigned": "u", "float": "f"}
ENDS = {"laszip": "laz", "binary": "bin", "zstandard": "zst"}
ELSEWHERE = -1  # the number of points of a node whose hierarchy goes on in a file of its own
MOST_NODE = 1 << 30  # bytes of an unpacked node
LARGEST_WINDOW = 1 << 27  # bytes that Zstandard may look back: its own limit of what it unpacks without being asked


class EptReader(FileReader):
    """An Entwine folder, by its ept.json. `nodes`: points of each node that has some, by name."""

    def __init__(self, path: Path) -> None:
        self._path, self._folder, self.warnings = path, path.parent, []
        self.facts = facts = _json(path)
        self._end = ENDS.get(str(facts.get("dataType")), "")
        if not self._end:
            raise PointFileError(path, f'has data of the type "{facts.get("dataType")}", expected {", ".join(ENDS)}')
        self.nodes = self._hierarchy()
        try:
            self._record, self._scales = _schema(facts["schema"])
            box = np.array(facts.get("boundsConforming", facts["bounds"]), np.float64).reshape(2, 3)
            promised = int(facts["points"])
        except (KeyError, TypeError, ValueError, OverflowError):
            raise PointFileError(path, "has no schema, bounds and points that belong together") from None
        count = sum(self.nodes.values())
        columns = [
            (name, np.dtype(np.float64) if name in self._scales else self._record[name])
            for name in self._record.names or ()
        ]
        attributes = attributes_of(columns, path)
        if self._end == "laz" and self.nodes:
            with LasReader(self._file(next(iter(self.nodes)))) as first:
                attributes = first.header.attributes
        if promised != count:
            self.warnings.append(f"{path.name}: promises {promised:,} points, and its nodes have {count:,}")
        srs = facts.get("srs")
        srs = srs if isinstance(srs, dict) else {}
        crs = srs.get("wkt") or (f"{srs.get('authority')}:{srs.get('horizontal')}" if srs.get("horizontal") else "")
        title = f"EPT of {len(self.nodes):,} nodes, {facts['dataType']}"
        self.header = Header(path, title, count, attributes, box, origin_of(box), crs=str(crs))

    def _hierarchy(self) -> dict[str, int]:
        """Points of each node that has some, level by level."""
        found: dict[str, int] = {}
        pages, seen = ["0-0-0-0"], set()
        while pages:
            page = pages.pop()
            if page in seen:
                continue
            seen.add(page)
            for name, count in _json(self._folder / "ept-hierarchy" / f"{page}.json").items():
                if not isinstance(count, int) or not _is_node(name):
                    raise PointFileError(self._path, f'has a node "{name}" of {count} points')
                if count == ELSEWHERE:
                    pages.append(name)
                elif count > 0:
                    found[name] = count
        return {name: found[name] for name in sorted(found, key=lambda name: [int(n) for n in name.split("-")])}

    def _file(self, node: str) -> Path:
        """The file of a node's points. Raises PointFileError where there is none."""
        path = self._folder / "ept-data" / f"{node}.{self._end}"
        if not path.exists():
            raise PointFileError(path, "is missing")
        return path

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        names = [attribute.name for attribute in wanted]
        for node, count in self.nodes.items():
            path = self._file(node)
            if self._end == "laz":
                with LasReader(path) as reader:
                    yield from reader.chunks(names, size)
                continue
            records = self._records(path, count)
            for first in range(0, count, size):
                yield self._assembled(records[first : first + size], wanted)

    def node(self, name: str) -> tuple[Columns, int]:
        """Returns the points of one node, and the bytes of its file. Threads may call it side by side. Raises
        PointFileError and OSError."""
        path, count = self._file(name), self.nodes[name]
        size = path.stat().st_size
        if self._end != "laz":
            return self._assembled(self._records(path, count), self.wanted(None)), size
        with LasReader(path, threads=False) as reader:
            parts = list(reader.chunks(None, max(count, 1)))
        found = sum(len(part["position"]) for part in parts)
        if found != count:
            raise PointFileError(path, f"has {found:,} points, where {count:,} are promised")
        return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}, size

    def _assembled(self, records: np.ndarray, wanted: list[Attribute]) -> Columns:
        values = {name: records[name] for name in records.dtype.names or ()}
        for name, (scale, offset) in self._scales.items():
            values[name] = records[name] * scale + offset
        return assemble(values, wanted)

    def _records(self, path: Path, count: int) -> np.ndarray:
        data = path.read_bytes()
        size = count * self._record.itemsize
        if self._end == "zst":
            if size > MOST_NODE:
                raise PointFileError(path, f"promises {count:,} points")
            data = _decompressed(path, data, size)
        if len(data) < size:
            raise PointFileError(path, f"has {len(data):,} bytes, where {count:,} points take {size:,}")
        return np.frombuffer(data, self._record, count)


def _decompressed(path: Path, data: bytes, size: int) -> bytes:
    """At most `size` bytes that Zstandard packed. Memory grows with what is found, whatever the frame's header says."""
    import zstandard

    found = bytearray()
    try:
        with zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW).stream_reader(data) as reader:
            while len(found) < size and (part := reader.read(min(size - len(found), CHUNK))):
                found += part
    except zstandard.ZstdError as error:
        raise PointFileError(path, f"is damaged: {error}") from None
    return bytes(found)


def _is_node(name: str) -> bool:
    parts = name.split("-")
    return len(parts) == 4 and all(part.isdecimal() and len(part) < 12 for part in parts)


def _json(path: Path) -> dict:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise PointFileError(path, "is missing") from None
    except (ValueError, RecursionError) as error:
        raise PointFileError(path, f"is no JSON: {error}") from None
    if not isinstance(found, dict):
        raise PointFileError(path, "is no JSON object")
    return found


def _schema(schema: list[dict]) -> tuple[np.dtype, dict[str, tuple[float, float]]]:
    """The record, and scale and offset of the columns that have them."""
    fields = [(str(d["name"]), f"<{KINDS[d['type']]}{int(d['size'])}") for d in schema]
    scales = {
        str(d["name"]): (float(d.get("scale", 1.0)), float(d.get("offset", 0.0)))
        for d in schema
        if "scale" in d or "offset" in d
    }
    return np.dtype(fields), scales
