"""What may befall files of scans that are not damaged: they change while they are read, lie far from the origin, are
called anything, hold nothing or the same point again and again."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.formats.points.e57 import pages
from pointsplat_addon.formats.points.gather import Selection, gather
from pointsplat_addon.formats.points.opening import open_points
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support.scan_files import write_e57, write_pcd, write_ply

laspy = pytest.importorskip("laspy", reason="it comes with the extension")

ROOT = Path(__file__).resolve().parents[3]
COUNT = 120_000  # more than a chunk of LASzip, and than what readers look at first
PLACE = [("x", "f8"), ("y", "f8"), ("z", "f8")]


def points(count: int, middle: float = 0.0, seed: int = 1) -> np.ndarray:
    random = np.random.default_rng(seed)
    return middle + np.round(random.uniform(-100, 100, (count, 3)), 3)


def las(path, position: np.ndarray, **columns: np.ndarray) -> None:
    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales = np.full(3, 0.001)
    header.offsets = np.round(position.mean(axis=0), -3) if len(position) else np.zeros(3)
    made = laspy.LasData(header)
    made.x, made.y, made.z = position.T
    for name, values in columns.items():
        made[name] = values
    made.write(str(path))


def ply(path, position: np.ndarray) -> None:
    found = np.zeros(len(position), PLACE)
    for axis, column in zip("xyz", position.T, strict=True):
        found[axis] = column
    write_ply(path, found, "binary_little_endian")


def pcd(path, position: np.ndarray) -> None:
    found = np.zeros(len(position), PLACE)
    for axis, column in zip("xyz", position.T, strict=True):
        found[axis] = column
    write_pcd(path, found, "binary")


def text(path, position: np.ndarray) -> None:
    np.savetxt(path, position, "%.3f", header="x y z", comments="")


def whole(paths, selection: Selection | None = None):
    readers = [open_points(path) for path in paths]
    work = gather(readers, selection or Selection())
    try:
        while True:
            next(work)
    except StopIteration as done:
        return done.value
    finally:
        for reader in readers:
            reader.close()


WRITERS = {"a.las": las, "a.laz": las, "a.ply": ply, "a.pcd": pcd, "a.xyz": text}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("how", ["shorter", "other", "gone"])
def test_files_that_change_while_they_are_read(tmp_path, name, how):
    """What is read is what the file had, or has; or the change is told. Mapped memory of a file that became shorter
    would end the process."""
    path = tmp_path / name
    position = points(COUNT)
    WRITERS[name](path, position)
    with open_points(path) as reader:
        chunks = reader.chunks((), 1000)
        first = next(chunks)["position"]
        np.testing.assert_allclose(first, position[: len(first)], rtol=0, atol=1e-9)
        if how == "shorter":
            os.truncate(path, 3 * path.stat().st_size // 4)
        elif how == "other":
            half = path.stat().st_size // 2
            with path.open("r+b") as file:
                file.seek(half)
                file.write(bytes(255 - byte for byte in path.read_bytes()[half:]))
        else:
            path.unlink()
        told = ""
        total = len(first)
        try:
            total += sum(len(chunk["position"]) for chunk in chunks)
        except (PointFileError, OSError) as error:
            told = str(error)
        assert total == COUNT or name in (told or "".join(reader.warnings))


def test_a_page_of_e57_that_is_gone(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "WINDOW", 16)
    path = tmp_path / "a.e57"
    position = points(10_000)
    prototype = "".join(f'<cartesian{axis} type="Float"/>' for axis in "XYZ")
    write_e57(path, prototype, [np.ascontiguousarray(column).tobytes() for column in position.T], len(position))
    with open_points(path) as reader:
        chunks = reader.chunks((), 1000)
        np.testing.assert_array_equal(next(chunks)["position"], position[:1000])
        os.truncate(path, 70_000)
        with pytest.raises(PointFileError, match=r"^a\.e57: ends at byte 70,000, before its pages do"):
            list(chunks)


@pytest.mark.parametrize("name", WRITERS)
def test_paths_with_spaces_and_letters_of_any_script(tmp_path, name):
    folder = tmp_path / "Überflug 2026 – 点群"
    folder.mkdir()
    position = points(40)
    path = folder / f"größe é {name}"
    WRITERS[name](path, position)
    np.testing.assert_allclose(whole([path]).columns["position"], position, rtol=0, atol=1e-5)
    path.write_bytes(b"\0")
    with pytest.raises(PointFileError, match=f"größe é {name}"):
        whole([path])


@pytest.mark.parametrize("name", WRITERS)
def test_offsets_of_a_billion_keep_a_millimetre(tmp_path, name):
    position = points(500, 1e9)
    WRITERS[name](tmp_path / name, position)
    found = whole([tmp_path / name])
    np.testing.assert_allclose(found.columns["position"] + found.origin, position, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("count", [0, 1, 1000])
def test_none_one_and_coincident_points(tmp_path, name, count):
    position = np.tile([[1.0, 2.0, 3.0]], (count, 1))
    WRITERS[name](tmp_path / name, position)
    if name == "a.xyz" and count == 0:
        with pytest.raises(PointFileError, match=r"a\.xyz: has no line of three numbers"):
            whole([tmp_path / name])
        return
    np.testing.assert_array_equal(whole([tmp_path / name]).columns["position"], position)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.xyz"])
def test_points_that_are_no_numbers_are_left_out_and_counted(tmp_path, name):
    position = points(300)
    position[7, 1], position[50, 0], position[299] = np.nan, np.inf, -np.inf
    WRITERS[name](tmp_path / name, position)
    found = whole([tmp_path / name])
    kept = position[np.isfinite(position).all(axis=1)]
    np.testing.assert_allclose(found.columns["position"], kept, rtol=0, atol=1e-5)
    # Lines of text that are no points are no records of it.
    assert found.dropped == 3 or name == "a.xyz"


@pytest.mark.parametrize("end", ["las", "laz"])
def test_columns_of_zeros_are_left_out_but_colours_stay(tmp_path, end):
    """Black is a colour; a column of which one file has something begins with zeros."""
    first, second = points(100), points(60, seed=2)
    las(tmp_path / f"a.{end}", first)
    las(tmp_path / f"b.{end}", second, user_data=np.arange(60), green=np.full(60, 65_535))
    found = whole([tmp_path / f"a.{end}"])
    assert set(found.columns) == {"position", "color"}
    np.testing.assert_array_equal(found.columns["color"], np.tile(np.array([0, 0, 0, 255], np.uint8), (100, 1)))
    found = whole([tmp_path / f"{name}.{end}" for name in "aba"])
    zeros = np.zeros(100)
    np.testing.assert_array_equal(found.columns["user_data"], np.concatenate([zeros, np.arange(60), zeros]))
    np.testing.assert_array_equal(found.columns["color"][:, 1], np.concatenate([zeros, np.full(60, 255), zeros]))


def test_extra_bytes_without_a_record_of_what_they_are(tmp_path):
    """The points are read, whatever the bytes mean; laspy calls them by its own name."""
    position = points(50)
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.add_extra_dim(laspy.ExtraBytesParams("unknown", "uint32"))
    header.scales = np.full(3, 0.001)
    made = laspy.LasData(header)
    made.x, made.y, made.z = position.T
    made["unknown"] = np.arange(50)
    made.write(str(tmp_path / "a.las"))
    data = bytearray((tmp_path / "a.las").read_bytes())
    record = data.index(b"LASF_Spec\0")
    data[record : record + 9] = b"ELSEWHERE"
    (tmp_path / "a.las").write_bytes(data)
    found = whole([tmp_path / "a.las"])
    np.testing.assert_allclose(found.columns["position"], position, rtol=0, atol=1e-5)


LIMITED = """
import resource, sys
from pathlib import Path

import laspy, lazrs, numpy

from pointsplat_addon.formats.points.gather import Selection, gather
from pointsplat_addon.formats.points.opening import open_points

used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (64 << 20), used + (64 << 20)))
try:
    with open_points(Path(sys.argv[1])) as reader:
        list(gather([reader], Selection()))
except ValueError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("end", "place", "layout", "value"),
    [
        ("las", 100, "<I", 1_069_128_089),  # records before the points, as in PDAL's garbage_nVariableLength.las
        ("las", 247, "<Q", 1 << 40),  # points
        ("laz", 247, "<Q", 1 << 40),
        ("las", 243, "<I", 1 << 31),  # records behind the points
    ],
)
def test_hostile_headers_take_no_memory(tmp_path, end, place, layout, value):
    path = tmp_path / f"a.{end}"
    made = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    made.x, made.y, made.z = points(500).T
    made.write(str(path))
    data = bytearray(path.read_bytes())
    struct.pack_into(layout, data, place, value)
    path.write_bytes(data)
    done = subprocess.run([sys.executable, "-c", LIMITED, str(path)], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"a.{end}: ") or place == 247  # more points than there are is a warning
