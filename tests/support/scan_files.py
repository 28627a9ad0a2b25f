"""Writes small scans of formats that no library here writes, for tests."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from pointsplat_addon.formats.points.e57.pages import PAGE, PAYLOAD, checksums

PLY_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int", "i1": "char"}


def write_ply(path: Path, records: np.ndarray, order: str, before: str = "", after: str = "") -> None:
    """A PLY file of structured records, as ascii, binary_little_endian or binary_big_endian; `before` and `after` are
    further lines of the header, about the elements that follow and that are not written."""
    lines = [
        "ply",
        f"format {order} 1.0",
        "comment made by a test",
        *before.splitlines(),
        f"element vertex {len(records)}",
    ]
    lines += [f"property {PLY_TYPES[records.dtype[n].str[1:]]} {n}" for n in records.dtype.names or ()]
    head = "\n".join([*lines, *after.splitlines(), "end_header", ""]).encode()
    if order == "ascii":
        body = "".join(" ".join(repr(v.item()) for v in row) + "\n" for row in records).encode()
    else:
        body = records.astype(records.dtype.newbyteorder("<" if order.endswith("little_endian") else ">")).tobytes()
    path.write_bytes(head + body)


def write_pcd(
    path: Path, records: np.ndarray, data: str, compress: Any = None, viewpoint: str = "0 0 0 1 0 0 0"
) -> None:
    """A PCD file of structured records; `compress` packs bytes by LZF."""
    names = records.dtype.names or ()
    kinds = {"f": "F", "u": "U", "i": "I"}
    fields = [records.dtype[n] for n in names]
    head = "\n".join([
        "# .PCD v0.7", "VERSION 0.7", "FIELDS " + " ".join(names),
        "SIZE " + " ".join(str(d.base.itemsize) for d in fields),
        "TYPE " + " ".join(kinds[d.base.kind] for d in fields),
        "COUNT " + " ".join(str(d.shape[0] if d.shape else 1) for d in fields), f"WIDTH {len(records)}", "HEIGHT 1",
        f"VIEWPOINT {viewpoint}", f"POINTS {len(records)}", f"DATA {data}", "",
    ]).encode()  # fmt: skip
    if data == "ascii":
        rows = [[v for n in names for v in np.ravel(row[n]).tolist()] for row in records]
        body = "".join(" ".join("nan" if v != v else repr(v) for v in row) + "\n" for row in rows).encode()
    elif data == "binary":
        body = records.tobytes()
    else:
        raw = b"".join(np.ascontiguousarray(records[n]).tobytes() for n in names)
        packed = compress(raw)
        body = struct.pack("<II", len(packed), len(raw)) + packed
    path.write_bytes(head + body)


def paged(content: bytes) -> bytes:
    """Bytes in pages with checksums, as E57 has them."""
    content += bytes(-len(content) % PAYLOAD)
    pages = np.frombuffer(content, np.uint8).reshape(-1, PAYLOAD)
    stored = checksums(pages).astype(">u4").view(np.uint8).reshape(-1, 4)
    return np.concatenate([pages, stored], axis=1).tobytes()


def write_e57(
    path: Path, prototype: str, streams: list[bytes], count: int, pose: str = "", split: int = 1 << 14
) -> None:
    """An E57 file of one scan: `prototype` is XML, `streams` are the bytes of its fields, in packets of at most `split`
    bytes of each."""
    packets = b""
    for at in range(0, max(map(len, streams)), split):
        parts = [stream[at : at + split] for stream in streams]
        body = struct.pack(f"<{len(parts)}H", *map(len, parts)) + b"".join(parts)
        size = 6 + len(body)
        packets += struct.pack("<BBHH", 1, 0, size + (-size % 4) - 1, len(parts)) + body + bytes(-size % 4)
    section, data = 48, 48 + 32
    head = struct.pack("<B7xQQQ", 1, 32 + len(packets), physical(data), 0)
    xml = (
        f'<?xml version="1.0"?><e57Root type="Structure" xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0">'
        f'<data3D type="Vector"><vectorChild type="Structure">{pose}'
        f'<points type="CompressedVector" fileOffset="{physical(section)}" recordCount="{count}">'
        f'<prototype type="Structure">{prototype}</prototype></points></vectorChild></data3D></e57Root>'
    ).encode()
    place = data + len(packets)
    content = bytes(48) + head + packets + xml
    length = -(-len(content) // PAYLOAD) * PAGE
    start = struct.pack("<8sIIQQQQ", b"ASTM-E57", 1, 0, length, physical(place), len(xml), PAGE)
    path.write_bytes(paged(start + content[48:]))


def physical(place: int) -> int:
    """A place among the bytes without checksums as one in the file."""
    return place // PAYLOAD * PAGE + place % PAYLOAD


def packed_integers(values: list[int], bits: int) -> bytes:
    """Integers of so many bits each, the lowest bits first."""
    total = sum(value << bits * i for i, value in enumerate(values))
    return total.to_bytes(-(-bits * len(values) // 8), "little")


def write_potree(folder: Path, nodes: dict[str, np.ndarray], low: tuple, side: float, scale: float, step: int) -> None:
    """A Potree 1.7 folder: float64 positions (N, 3) by the names of nodes; attributes are positions and colours."""
    facts = {
        "version": "1.7", "octreeDir": "data", "pointAttributes": ["POSITION_CARTESIAN", "COLOR_PACKED"],
        "boundingBox": {**{f"l{a}": v for a, v in zip("xyz", low, strict=True)},
                        **{f"u{a}": v + side for a, v in zip("xyz", low, strict=True)}},
        "scale": scale, "hierarchyStepSize": step, "spacing": 1.0,
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cloud.js").write_text(json.dumps(facts), encoding="utf-8")
    record = np.dtype([("position", "<u4", 3), ("color", "u1", 4)])
    for name, position in nodes.items():
        corner, size = np.array(low, np.float64), side
        for digit in map(int, name[1:]):
            size /= 2
            corner += size * np.array([digit >> 2 & 1, digit >> 1 & 1, digit & 1])
        records = np.zeros(len(position), record)
        records["position"] = np.round((position - corner) / scale)
        records["color"] = [10, 20, 30, 255]
        steps = [name[1:][i : i + step] for i in range(0, len(name) - step, step)]
        place = folder.joinpath("data", "r", *steps)
        place.mkdir(parents=True, exist_ok=True)
        records.tofile(place / f"{name}.bin")
    for root in [name for name in nodes if (len(name) - 1) % step == 0]:
        below = sorted(
            (n for n in nodes if n.startswith(root) and len(n) - len(root) <= step), key=lambda name: (len(name), name)
        )
        rows = [(sum(1 << d for d in range(8) if f"{name}{d}" in nodes), len(nodes[name])) for name in below]
        steps = [root[1:][i : i + step] for i in range(0, len(root) - step, step)]
        data = b"".join(struct.pack("<BI", *row) for row in rows)
        folder.joinpath("data", "r", *steps, f"{root}.hrc").write_bytes(data)
