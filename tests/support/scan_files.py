"""Writes small scans of formats that no library here writes, for tests."""

from __future__ import annotations

import io
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


def write_copc(path: Path, las: Any, nodes: int = 3) -> None:
    """A COPC file of laspy's points, of the point formats 6 to 8, split over a chain of so many nodes."""
    import laspy
    import lazrs

    header = las.header
    packing = lazrs.LazVlr.new_for_compression(header.point_format.id, 0, use_variable_size_chunks=True)
    header.are_points_compressed = True
    header.vlrs = laspy.vlrs.vlrlist.VLRList()
    header.vlrs.append(laspy.vlrs.VLR("copc", 1, "COPC info VLR", bytes(160)))
    header.vlrs.append(laspy.vlrs.VLR("laszip encoded", 22204, "", packing.record_data()))
    stream = io.BytesIO()
    header.write_to(stream, ensure_same_size=False)
    start = stream.tell()
    points = las.points.array.view(np.uint8).reshape(len(las.points), -1)
    compressor = lazrs.LasZipCompressor(stream, packing)
    for part in np.array_split(points, nodes):
        compressor.compress_many(np.ascontiguousarray(part).ravel())
        compressor.finish_current_chunk()
    compressor.done()
    first = stream.seek(0, io.SEEK_END)
    stream.seek(start)
    entries, at = b"", start + 8
    for level, (count, size) in enumerate(lazrs.read_chunk_table(stream, packing)):
        entries += struct.pack("<4iQii", level, 0, 0, 0, at, size, count)
        at += size
    stream.seek(first)
    stream.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(entries), b"EPT Hierarchy") + entries)
    found = bytearray(stream.getvalue())
    struct.pack_into("<QI", found, 235, first, 1)
    struct.pack_into("<5dQQ2d", found, 375 + 54, 0, 0, 0, 1e3, 1.0, first + 60, len(entries), 0.0, 1.0)
    path.write_bytes(found)


def write_ept(folder: Path, nodes: dict[str, np.ndarray], kind: str, pages: tuple[str, ...] = ()) -> None:
    """An Entwine folder of whole-numbered positions (N, 3), in hundredths, by the names of nodes; the hierarchy of the
    nodes `pages` stands in files of their own. kind: laszip, binary or zstandard."""
    (folder / "ept-data").mkdir(parents=True)
    (folder / "ept-hierarchy").mkdir()
    schema = [{"name": name, "type": "signed", "size": 4, "scale": 0.01, "offset": 100.0} for name in "XYZ"]
    schema += [{"name": name, "type": "unsigned", "size": 2} for name in ("Intensity", "Red", "Green", "Blue")]
    record = np.dtype([(d["name"], f"<{'i' if d['type'] == 'signed' else 'u'}{d['size']}") for d in schema])
    facts = {
        "bounds": [0, 0, 0, 200, 200, 200], "dataType": kind, "schema": schema, "version": "1.1.0",
        "points": sum(map(len, nodes.values())), "srs": {"authority": "EPSG", "horizontal": "2154"},
    }  # fmt: skip
    (folder / "ept.json").write_text(json.dumps(facts), encoding="utf-8")
    root = {name: -1 if name in pages else len(position) for name, position in nodes.items()}
    (folder / "ept-hierarchy" / "0-0-0-0.json").write_text(json.dumps(root), encoding="utf-8")
    for name in pages:
        text = json.dumps({name: len(nodes[name])})
        (folder / "ept-hierarchy" / f"{name}.json").write_text(text, encoding="utf-8")
    for name, position in nodes.items():
        records = np.zeros(len(position), record)
        for axis, column in zip("XYZ", position.T, strict=True):
            records[axis] = column
        records["Intensity"] = np.arange(len(position)) % 7
        _write_node(folder / "ept-data" / name, records, kind)


def _write_node(path: Path, records: np.ndarray, kind: str) -> None:
    """The points of a node, with the ending of their kind."""
    if kind == "binary":
        records.tofile(path.with_suffix(".bin"))
    elif kind == "zstandard":
        import zstandard

        path.with_suffix(".zst").write_bytes(zstandard.ZstdCompressor().compress(records.tobytes()))
    else:
        import laspy

        made = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
        made.X, made.Y, made.Z = records["X"], records["Y"], records["Z"]
        made.intensity = records["Intensity"]
        made.write(str(path.with_suffix(".laz")))
