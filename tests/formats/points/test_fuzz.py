"""Damaged scans of every format: truncated, with flipped bits, with numbers of headers overwritten.

Whatever a file says, a reader ends, names the file, and takes no memory that the file's size does not allow.
"""

from __future__ import annotations

import tracemalloc
import warnings
import zlib

import numpy as np
import pytest

from pointsplat_addon.formats.points.opening import open_points
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support.scan_files import packed_integers, write_e57, write_pcd, write_ply

QUICK, LONG = 60, 2000  # damaged files of each kind
# Bytes: readers take blocks of fixed sizes, and some times a file's size. Measured at most 3.6e6, of E57's window.
MOST_MEMORY = 64_000_000
COUNT = 300


def table() -> np.ndarray:
    random = np.random.default_rng(0)
    found = np.zeros(COUNT, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    for name in "xyz":
        found[name] = random.normal(size=COUNT)
    return found


def las(path) -> None:
    laspy = pytest.importorskip("laspy", reason="it comes with the extension")
    made = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
    made.x = made.y = made.z = np.arange(COUNT)
    made.write(str(path))


def e57(path) -> None:
    prototype = "".join(f'<cartesian{axis} type="Float" precision="single"/>' for axis in "XYZ")
    prototype += '<intensity type="Integer" minimum="0" maximum="9"/>'
    column = np.linspace(0, 1, COUNT, dtype=np.float32).tobytes()
    write_e57(path, prototype, [column] * 3 + [packed_integers([7] * COUNT, 4)], COUNT)


def lzf(path) -> None:
    library = pytest.importorskip("lzf", reason="it comes with the extension")
    write_pcd(path, table(), "binary_compressed", library.compress)


def text(path) -> None:
    path.write_text("x y z intensity\n" + "".join(f"{i} {i / 7} -1.5 {i % 9}\n" for i in range(COUNT)))


def ptx(path) -> None:
    pose = "1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n"
    path.write_text(f"10\n{COUNT // 10}\n5 6 7\n{pose}" + "".join(f"{i} 1 2 0.5\n" for i in range(COUNT)))


WRITERS = {
    "a.las": las,
    "a.laz": las,
    "a.e57": e57,
    "text.ply": lambda path: write_ply(path, table(), "ascii"),
    "little.ply": lambda path: write_ply(path, table(), "binary_little_endian"),
    "text.pcd": lambda path: write_pcd(path, table(), "ascii"),
    "binary.pcd": lambda path: write_pcd(path, table(), "binary"),
    "packed.pcd": lzf,
    "a.xyz": text,
    "a.ptx": ptx,
}


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """A file with some damage."""
    kind = random.integers(4)
    found = bytearray(data)
    if kind == 0:
        return bytes(found[: random.integers(len(found) + 1)])
    if kind == 1:
        for at in random.integers(len(found), size=random.integers(1, 9)):
            found[at] ^= 1 << int(random.integers(8))
    elif kind == 2:  # numbers of the header
        at = int(random.integers(min(len(found), 400)))
        found[at : at + 4] = random.choice([b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\xff\xff\xff", b"9999"])
    else:
        at = int(random.integers(len(found)))
        found[at:at] = bytes(random.integers(256, size=random.integers(1, 50), dtype=np.uint8))
    return bytes(found)


def read(path) -> None:
    """Reads all of a file; what is wrong with it has to be told with its name."""
    said = path.name
    try:
        with open_points(path) as reader:
            for chunk in reader.chunks():
                assert {len(value) for value in chunk.values()} == {len(chunk["position"])}
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
            path.write_bytes(damaged(data, random))
            tracemalloc.reset_peak()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # numbers beyond what their types hold
                read(path)
            assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY, number
    finally:
        tracemalloc.stop()
