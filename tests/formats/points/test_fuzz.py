"""Damaged scans of every format: truncated, with flipped bits, with numbers of headers and words of text overwritten.

Whatever a file says, an import ends, names the file, and takes no memory that the file's size does not allow.
"""

from __future__ import annotations

import json
import re
import tracemalloc
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.formats.points.gather import Gathered, Selection, gather
from pointsplat_addon.formats.points.opening import FOLDERS, open_points
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support import damage
from tests.support.damage import KINDS
from tests.support.scan_files import (
    packed_integers,
    write_copc,
    write_e57,
    write_ept,
    write_pcd,
    write_ply,
    write_potree,
)

QUICK, LONG = 200, 10_000  # damaged files of each kind
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


def pts(path) -> None:
    rows = "".join(f"{i}.5 {i / 7} -1.5 {-i} {i % 256} 7 255\n" for i in range(COUNT // 2))
    path.write_text(2 * f"{COUNT // 2}\n{rows}")


def csv(path) -> None:
    path.write_text("X,Y,Z,Class,Quality\n" + "".join(f'"{i}",{i / 7},-1.5,2,{i % 9}e3\n' for i in range(COUNT)))


def copc(path) -> None:
    laspy = pytest.importorskip("laspy", reason="it comes with the extension")
    made = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
    made.x = made.y = made.z = np.arange(COUNT)
    write_copc(path, made)


def octree(depth: int, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Whole numbers (N, 3) below 2 to the power of `depth` for each name."""
    random = np.random.default_rng(0)
    return {name: random.integers(1 << depth, size=(COUNT // len(names), 3)) for name in names}


def ept(kind: str):
    nodes = octree(12, ("0-0-0-0", "1-0-0-0", "1-1-1-0", "2-3-2-0"))
    return lambda folder: write_ept(folder, nodes, kind, ("1-1-1-0", "2-3-2-0"))


def potree(folder) -> None:
    nodes = octree(0, ("r", "r0", "r7", "r07", "r071", "r0716", "r07163"))
    write_potree(folder, nodes, (-1.0, 2.0, 5.0), 8.0, 1e-3, 2)


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
    "a.pts": pts,
    "a.csv": csv,
    "a.copc.laz": copc,
    "laszip": ept("laszip"),
    "binary": ept("binary"),
    "zstandard": ept("zstandard"),
    "potree": potree,
}
WORD = rb"[^\s,;:{}\[\]]+"
# What stands where files of text have words: numbers that are none or beyond any type, and what is no number.
WORDS = [
    *(b"nan", b"-inf", b"1e400", b"-1e308", b"1e-320", b"-1", b"0", b"9" * 30, b"0x10", b"1_0"),
    *(b"\xc2\xbd", b"\xc2\xb2", b"\xff", b"\0", b"\n", b"\r", b"", b" ", b"abc", b"laszip"),
    *(b"null", b"true", b"{}", b"[]", b"[[[", b'"', b"''"),
]


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """A file with some damage."""
    text = len(data) > 0 and b"\0" not in data
    kind = int(random.integers(KINDS + 2 if text else KINDS))
    if kind < KINDS:
        return damage.damaged(data, kind, random)
    found, words = bytearray(data), list(re.finditer(WORD, data[: 400 if kind == KINDS else len(data)]))
    for _ in range(random.integers(1, 4)):  # words, of those at the beginning above all
        word = words[random.integers(len(words))]
        found[word.start() : word.end()] = WORDS[random.integers(len(WORDS))]
    return bytes(found)


def gathered(path: Path) -> Gathered:
    """All points of a file, as an import has them."""
    with open_points(path) as reader:
        work = gather([reader], Selection(), 1 << 10)
        while True:
            try:
                next(work)
            except StopIteration as done:
                return done.value


def read(path: Path, names: set[str]) -> None:
    """Imports all of a file; what is wrong with it has to be told with the name of a file."""
    said = ""
    try:
        found = gathered(path)
        assert {len(value) for value in found.columns.values()} == {len(found)}
    except PointFileError as error:
        said = str(error)
    file, _, what = said.partition(": ")
    assert not said or file in names or what == "is missing", said  # which names a file that was made up


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("count", [QUICK, pytest.param(LONG, marks=pytest.mark.long)])
def test_damaged_files_are_read_or_refused(tmp_path, name, count):
    path = tmp_path / name
    WRITERS[name](path)
    files = [file for file in sorted(path.rglob("*")) if file.is_file()] if path.is_dir() else [path]
    contents = {file: file.read_bytes() for file in files}
    heads = [file for file in files if file.name in FOLDERS]
    names = {file.name for file in files}
    read(path, set())
    random = np.random.default_rng([count, zlib.crc32(name.encode())])
    tracemalloc.start()
    try:
        for number in range(count):
            # What a folder says of itself is damaged as often as all that lies in it.
            among = heads if heads and random.integers(2) else files
            file = among[random.integers(len(among))]
            file.write_bytes(damaged(contents[file], random))
            tracemalloc.reset_peak()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # numbers beyond what their types hold
                read(path, names)
            assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY, number
            file.write_bytes(contents[file])
    finally:
        tracemalloc.stop()


def misleading(content: bytes):
    """Texts of JSON with each word, and each value at the top, replaced by each that it should not be."""
    for word in re.finditer(WORD, content):
        for other in WORDS:
            yield content[: word.start()] + other + content[word.end() :]
    facts = json.loads(content)
    for key in facts:
        for value in (None, True, 5, -1.5, 1e400, "x", "", "..", [], [[]], [{}], {}, {"x": {}}, [None] * 9):
            yield json.dumps({**facts, key: value}).encode()
        yield json.dumps({other: facts[other] for other in facts if other != key}).encode()


@pytest.mark.parametrize("name", ["binary", "laszip", "potree"])
def test_nothing_that_a_folder_says_is_taken_for_granted(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path)
    names = {file.name for file in path.rglob("*")}
    for file in [file for file in sorted(path.rglob("*")) if file.suffix in (".json", ".js")]:
        content = file.read_bytes()
        for damaged in misleading(content):
            file.write_bytes(damaged)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # numbers beyond what their types hold
                read(path, names)
        file.write_bytes(content)


def test_a_frame_of_zstandard_takes_no_memory_that_it_only_promises(tmp_path):
    WRITERS["zstandard"](tmp_path / "a")
    frame = b"\x28\xb5\x2f\xfd\xe0" + (1 << 50).to_bytes(8, "little") + b"\x01\0\0"  # an empty block
    (tmp_path / "a" / "ept-data" / "1-0-0-0.zst").write_bytes(frame)
    with pytest.raises(PointFileError, match=r"^1-0-0-0\.zst: "):
        gathered(tmp_path / "a")


@pytest.mark.parametrize("name", ["text.ply", "a.ptx"])
def test_counts_that_are_no_numbers_are_refused(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path)
    content = path.read_bytes()
    for count in WORDS:
        path.write_bytes(content.replace(b"300" if name == "text.ply" else b"30", count, 1))
        read(path, {name})
