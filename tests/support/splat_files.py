"""Small files of captured splats written byte by byte, by nothing of the package's own, and whole files read."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.formats.splats.reader import SplatReader

NAMES = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
         "rot_2", "rot_3")  # fmt: skip


def write_splat_ply(
    path: Path, columns: dict[str, list[float]], order: str = "<", comments: tuple[str, ...] = ()
) -> None:
    """A PLY file of float properties in the dictionary's order. order: "<", ">" or "" for text."""
    count = len(next(iter(columns.values())))
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    lines = ["ply", f"format {kind} 1.0", *(f"comment {comment}" for comment in comments), f"element vertex {count}"]
    head = "\n".join([*lines, *(f"property float {name}" for name in columns), "end_header", ""]).encode()
    rows = [list(row) for row in zip(*columns.values(), strict=True)]
    if order:
        body = b"".join(struct.pack(f"{order}{len(row)}f", *row) for row in rows)
    else:
        body = "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    path.write_bytes(head + body)


def splat_columns(count: int, coefficients: int = 0, seed: int = 0) -> dict[str, list[float]]:
    """Random properties of splats in the order of the authors' files."""
    random = np.random.default_rng(seed)
    names = [*NAMES[:6], *(f"f_rest_{i}" for i in range(3 * coefficients)), *NAMES[6:]]
    return {name: random.normal(-1, 0.5, count).astype(np.float32).tolist() for name in names}


def write_packed_ply(
    path: Path,
    ranges: Sequence[Sequence[float]],
    words: Sequence[Sequence[int]],
    sh: Sequence[Sequence[int]] | None = None,
) -> None:
    """A packed PLY file. ranges: of each chunk, 12 or 18 numbers; words: of each splat its position, rotation, scale
    and colour; sh: bytes of each splat."""
    ends = [f"{end}{what}{axis}" for what in ("_", "_scale_") for end in ("min", "max") for axis in "xyz"]
    ends += [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {len(ranges)}"]
    lines += [f"property float {name}" for name in ends[: len(ranges[0]) if ranges else 18]]
    lines += [f"element vertex {len(words)}"]
    lines += [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    if sh is not None:
        lines += [f"element sh {len(sh)}", *(f"property uchar f_rest_{i}" for i in range(len(sh[0])))]
    body = b"".join(struct.pack(f"<{len(row)}f", *row) for row in ranges)
    body += b"".join(struct.pack("<4I", *row) for row in words) + b"".join(bytes(row) for row in sh or [])
    path.write_bytes(("\n".join(lines) + "\nend_header\n").encode() + body)


def spz_bytes(
    version: int, count: int, degree: int, fraction: int, flags: int, parts: list[bytes], tail: bytes = b""
) -> bytes:
    """An SPZ file of the bytes of its attributes; tail: of its extensions."""
    head = struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, fraction, flags, len(parts) if version == 4 else 0)
    if version < 4:
        return gzip.compress(head + b"".join(parts) + tail)
    import zstandard

    packed = [zstandard.ZstdCompressor().compress(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(p), len(part)) for p, part in zip(packed, parts, strict=True))
    start = (head + struct.pack("<I", 32 + len(tail))).ljust(32, b"\0")
    return start + tail + table + b"".join(packed)


def webp(pixels: list[list[int]], width: int) -> bytes:
    """A picture without loss of RGBA pixels, row by row from the top, filled up with zeros."""
    from PIL import Image

    height = -(-len(pixels) // width)
    array = np.zeros((height * width, 4), np.uint8)
    array[: len(pixels)] = pixels
    file = io.BytesIO()
    Image.fromarray(array.reshape(height, width, 4), "RGBA").save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def read_picture(data: bytes, _name: str) -> np.ndarray:
    """Pixels (H, W, 4) uint8 of a picture."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))


def sog_files(count: int, sh: bool = True) -> dict[str, bytes]:
    """A SOG set of random splats, by the names of its files."""
    random = np.random.default_rng(count)
    width = 4

    def random_pixels(alpha: int) -> bytes:
        pixels = random.integers(256, size=(count, 4))
        pixels[:, 3] = np.maximum(pixels[:, 3], alpha)
        return webp(pixels.tolist(), width)

    book = np.linspace(-3, 1, 256).tolist()
    meta = {
        "version": 2, "count": count, "antialias": True,
        "means": {"mins": [-1, -2, -3], "maxs": [1, 2, 3], "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": book, "files": ["scales.webp"]}, "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": book, "files": ["sh0.webp"]},
    }  # fmt: skip
    files = {f"{name}.webp": random_pixels(252 if name == "quats" else 255) for name in
             ("means_l", "means_u", "scales", "quats", "sh0")}  # fmt: skip
    if sh:
        meta["shN"] = {"count": 70, "bands": 1, "codebook": book, "files": ["centroids.webp", "labels.webp"]}
        centroids = [[*random.integers(256, size=3).tolist(), 255] for _ in range(2 * 64 * 3)]
        files["centroids.webp"] = webp(centroids, 64 * 3)
        files["labels.webp"] = webp([[int(i), 0, 0, 255] for i in random.integers(70, size=count)], width)
    files["meta.json"] = json.dumps(meta).encode()
    return files


def write_sog(path: Path, files: dict[str, bytes]) -> None:
    """A ZIP file, or a folder where the path has no ending."""
    if not path.suffix:
        path.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            (path / name).write_bytes(data)
        return
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


def write_ksplat(
    path: Path, level: int, splats: list[bytes], degree: int = 0, bucket: tuple | None = None, extent: float = 0.0
) -> None:
    """A .ksplat file of one section, whose splats are a full bucket of two and a partial one of the rest."""
    head = struct.pack("<BB2xI8xIH14xff", 0, 1, 1, len(splats), level, -2.0, 2.0).ljust(4096, b"\0")
    full, partial = (1, 1) if bucket else (0, 0)
    section = struct.pack("<IIIIfHxxIIIIH", len(splats), len(splats), 2, full + partial, extent, 12 if bucket else 0,
                          32767, 0, full, partial, degree).ljust(1024, b"\0")  # fmt: skip
    buckets = struct.pack("<I", len(splats) - 2) + 2 * struct.pack("<3f", *bucket) if bucket else b""
    path.write_bytes(head + section + buckets + b"".join(splats))


def read_all(reader: SplatReader) -> CapturedSplats:
    """Returns all splats of an open file that can be drawn, in its axes. Raises PointFileError and OSError."""
    parts = list(reader.chunks())
    header = reader.header
    shapes = {"position": (3,), "scale": (3,), "rotation": (4,), "base": (3,), "opacity": ()}
    if header.coefficients:
        shapes["sh"] = (header.coefficients, 3)
    found = {}
    for name, shape in shapes.items():
        arrays = [getattr(part, name) for part in parts]
        found[name] = np.concatenate([np.zeros((0, *shape), np.float32), *arrays])
    return CapturedSplats(**found, origin=np.array(header.origin, np.float64), antialiased=header.antialiased)
