"""Damaged files of captured splats of every format: truncated, with flipped bits, with numbers overwritten.

Whatever a file says, a reader ends, names the file, and takes no memory that the file's size does not allow.
"""

from __future__ import annotations

import struct
import tracemalloc
import zlib

import numpy as np
import pytest

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.formats.splats.writing.spz import write_spz
from tests.support import splat_files as files
from tests.support.damage import KINDS, damaged

QUICK, LONG = 60, 2000  # damaged files of each kind
COUNT = 300
# Bytes: what a file's size allows. Measured at most 526,102, and 17e6 of text, which is read in blocks.
MOST_MEMORY = 64_000_000


def spz(version):
    def write(path):
        random = np.random.default_rng(version)
        shapes = (3,), (3,), (4,), (3,), ()
        arrays = [random.uniform(0.1, 0.9, (COUNT, *shape)).astype(np.float32) for shape in shapes]
        sh = random.uniform(-0.5, 0.5, (COUNT, 3, 3)).astype(np.float32)
        write_spz(path, CapturedSplats(*arrays, sh=sh), version)

    return write


def packed(path):
    random = np.random.default_rng(0)
    words = random.integers(1 << 32, size=(COUNT, 4)).tolist()
    files.write_packed_ply(path, [[0.0] * 3 + [1.0] * 3 + [-5.0] * 3 + [0.0] * 3] * 2, words, [[7] * 9] * COUNT)


def splat(path):
    one = struct.pack("<6f8B", 1, 2, 3, 0.5, 0.25, 2, 255, 0, 51, 204, 128, 128, 0, 128)
    path.write_bytes(one * COUNT)


def ksplat(path):
    one = struct.pack("<3H3e4e4B", 32767, 0, 65534, 0.5, 0.25, 2, 0, 0, 3, 0, 255, 0, 51, 204)
    files.write_ksplat(path, 1, [one] * COUNT, 0, (10, 20, 30), 4.0)


WRITERS = {
    "little.ply": lambda path: files.write_splat_ply(path, files.splat_columns(COUNT, 8)),
    "text.ply": lambda path: files.write_splat_ply(path, files.splat_columns(COUNT), ""),
    "packed.ply": packed,
    "a.splat": splat,
    "a.ksplat": ksplat,
    "gzip.spz": spz(3),
    "zstd.spz": spz(4),
    "a.sog": lambda path: files.write_sog(path, files.sog_files(COUNT)),
}


def picture(data: bytes, name: str) -> np.ndarray:
    """Pixels of a picture; of a damaged one none, as Blender has it."""
    try:
        return files.read_picture(data, name)
    except (OSError, ValueError, SyntaxError):
        return np.empty((0, 0, 4), np.uint8)


def read(path) -> None:
    """Reads all of a file; what is wrong with it has to be told with its name."""
    said = path.name
    try:
        with open_splats(path, picture) as reader:
            count = 0
            for part in reader.chunks():
                count += len(part)
                for name in ("position", "scale", "rotation", "base", "opacity"):
                    assert np.isfinite(getattr(part, name)).all()
                assert (part.scale >= 0).all()
                assert ((part.opacity >= 0) & (part.opacity <= 1)).all()
            assert count + reader.dropped == reader.header.count
    except PointFileError as error:
        said = str(error)
    assert path.name in said


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("count", [QUICK, pytest.param(LONG, marks=pytest.mark.long)])
def test_damaged_files_are_read_or_refused(tmp_path, name, count):
    path = tmp_path / name
    WRITERS[name](path)
    data = path.read_bytes()
    read(path)
    random = np.random.default_rng([count, zlib.crc32(name.encode())])
    tracemalloc.start()
    try:
        for number in range(count):
            # A new file: an open one is mapped into memory.
            path.unlink()
            path.write_bytes(damaged(data, int(random.integers(KINDS)), random))
            tracemalloc.reset_peak()
            read(path)
            assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY, number
    finally:
        tracemalloc.stop()
