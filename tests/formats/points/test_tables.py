"""Scans as tables: PLY, PCD and text hold what was written, of each kind and byte order."""

from __future__ import annotations

import numpy as np
import pytest

from pointsplat_addon.formats.points.opening import open_points
from pointsplat_addon.formats.points.ply import kind_of
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.formats.points.text.table import guess
from tests.support.scan_files import write_pcd, write_ply


def records(count: int = 1000) -> np.ndarray:
    random = np.random.default_rng(3)
    found = np.empty(count, [("x", "f8"), ("y", "f8"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
                             ("nx", "f4"), ("ny", "f4"), ("nz", "f4"), ("quality", "i4")])  # fmt: skip
    for name in found.dtype.names or ():
        kind = found.dtype[name].kind
        found[name] = random.integers(0, 200, count) if kind in "iu" else random.normal(size=count)
    found["x"] += 5e6
    return found


def whole(path, size=300):
    with open_points(path) as reader:
        chunks = list(reader.chunks(size=size))
    assert all(0 < len(chunk["position"]) <= size for chunk in chunks)
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}


def assert_equal(found, given):
    position = np.stack([given[axis].astype(np.float64) for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(found["position"], position)
    np.testing.assert_array_equal(found["color"], np.stack([given[c] for c in ("red", "green", "blue")], axis=1))
    np.testing.assert_array_equal(found["normal"], np.stack([given[c] for c in ("nx", "ny", "nz")], axis=1))
    np.testing.assert_array_equal(found["quality"], given["quality"])


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_holds_what_was_written(tmp_path, order):
    given = records()
    write_ply(tmp_path / "a.ply", given, order)
    assert_equal(whole(tmp_path / "a.ply"), given)


def test_a_ply_file_is_a_mesh_a_scan_or_splats(tmp_path):
    given = records(3)
    write_ply(tmp_path / "scan.ply", given, "binary_little_endian", after="element face 0\nproperty list uchar int v")
    write_ply(tmp_path / "mesh.ply", given, "binary_little_endian", after="element face 7\nproperty list uchar int v")
    names = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "rot_0")
    write_ply(tmp_path / "splats.ply", np.zeros(3, [(name, "f4") for name in names]), "binary_little_endian")
    assert [kind_of(tmp_path / f"{name}.ply") for name in ("scan", "mesh", "splats")] == ["POINTS", "MESH", "SPLATS"]


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_pcd_holds_what_was_written(tmp_path, data):
    lzf = pytest.importorskip("lzf", reason="it comes with the extension") if data == "binary_compressed" else None
    given = records()
    write_pcd(tmp_path / "a.pcd", given, data, lzf and lzf.compress)
    assert_equal(whole(tmp_path / "a.pcd"), given)


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_colours_of_pcd_are_bytes_in_a_number(tmp_path, data):
    given = np.zeros(2, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("rgb", "f4")])
    given["x"] = 1, np.nan
    given["rgb"] = np.array([0x00102030, 0x00FFFEFD], np.uint32).view(np.float32)
    if data == "ascii":  # written as the number that the bytes are, as newer versions of PCL do
        given["rgb"] = 0x00102030, 0x00FFFEFD
    write_pcd(tmp_path / "a.pcd", given, data)
    found = whole(tmp_path / "a.pcd")
    np.testing.assert_array_equal(found["color"], [[0x10, 0x20, 0x30], [0xFF, 0xFE, 0xFD]])
    assert np.isnan(found["position"][1, 0])


def test_a_viewpoint_of_pcd_is_where_a_scanner_stood(tmp_path):
    given = np.zeros(1, [("x", "f4"), ("y", "f4"), ("z", "f4")])
    write_pcd(tmp_path / "a.pcd", given, "binary", viewpoint="1 2 3 1 0 0 0")
    write_pcd(tmp_path / "b.pcd", given, "binary")
    with open_points(tmp_path / "a.pcd") as reader:
        np.testing.assert_array_equal(reader.header.stations, [[1, 2, 3]])
    with open_points(tmp_path / "b.pcd") as reader:
        assert len(reader.header.stations) == 0


@pytest.mark.parametrize(
    ("text", "names", "named"),
    [
        ("1 2 3\n4 5 6\n", "x y z", False),
        ("1 2 3 -7.5\n4 5 6 8\n", "x y z intensity", False),
        ("1 2 3 200 100 0\n4 5 6 0 0 255\n", "x y z red green blue", False),
        ("1 2 3 0.6 0 0.8\n4 5 6 0 1 0\n", "x y z nx ny nz", False),
        ("2\n1 2 3 -500 200 100 0\n4 5 6 12 0 0 255\n", "x y z intensity red green blue", False),
        ("1 2 3 200 100 0 0.6 0 0.8\n4 5 6 0 0 255 0 1 0\n", "x y z red green blue nx ny nz", False),
        ("X,Y,Z,Intensity\r\n1,2,3,4\r\n5,6,7,8\r\n", "X Y Z Intensity", True),
        ('"X";"Y";"Z"\n1;2;3\n', "X Y Z", True),
        ("# x y z reflectance\n1 2 3 4\n", "x y z reflectance", True),
    ],
)
def test_columns_of_text_are_named_or_guessed(tmp_path, text, names, named):
    (tmp_path / "a.txt").write_text(text, newline="")
    found = guess(tmp_path / "a.txt")
    assert (" ".join(found.names), found.named) == (names, named)


def test_lines_that_are_no_points_are_left_out_and_counted(tmp_path):
    (tmp_path / "a.xyz").write_text("# made by hand\nx y z\n1 2 3\n\n4 5\n7 8 9 10\n-1e3 nan 2.5e6\n")
    with open_points(tmp_path / "a.xyz") as reader:
        assert reader.header.count == 2
        found = np.concatenate([chunk["position"] for chunk in reader.chunks()])
        np.testing.assert_array_equal(found, [[1, 2, 3], [-1e3, np.nan, 2.5e6]])
        assert reader.warnings == ["a.xyz: 2 lines that do not have 3 numbers are left out"]


def test_the_count_before_points_of_pts_is_no_point(tmp_path):
    for promised, warnings in ((2, []), (3, ["a.pts: promises 3 points and has 2"])):
        (tmp_path / "a.pts").write_text(f"{promised}\n1 2 3 -50\n4 5 6 12\n")
        with open_points(tmp_path / "a.pts") as reader:
            found = np.concatenate([chunk["position"] for chunk in reader.chunks()])
            np.testing.assert_array_equal(found, [[1, 2, 3], [4, 5, 6]])
            assert reader.warnings == warnings


def test_text_is_read_in_blocks(tmp_path, monkeypatch):
    from pointsplat_addon.formats.points.text import rows as text_rows

    monkeypatch.setattr(text_rows, "BLOCK", 100)
    given = np.random.default_rng(1).normal(size=(500, 3))
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(map(repr, row)) for row in given.tolist()))
    np.testing.assert_array_equal(whole(tmp_path / "a.xyz")["position"], given)


def test_scans_of_ptx_are_posed(tmp_path):
    pose = "1 0 0\n0 1 0\n0 0 1\n"
    turned = "0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1\n"  # rows of vectors: x to y, y to -x
    first = f"1\n2\n0 0 0\n{pose}1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 0.5 255 0 7\n0 0 0 0.5 0 0 0\n"
    second = f"1\n1\n10 20 30\n{pose}{turned}1 0 5 0.25 1 2 3"
    (tmp_path / "a.ptx").write_text(first + second)
    found = whole(tmp_path / "a.ptx")
    np.testing.assert_array_equal(found["position"], [[1, 2, 3], [10, 21, 35]])
    np.testing.assert_array_equal(found["color"], [[255, 0, 7], [1, 2, 3]])
    np.testing.assert_array_equal(found["station"], [0, 1])
    with open_points(tmp_path / "a.ptx") as reader:
        np.testing.assert_array_equal(reader.header.stations, [[0, 0, 0], [10, 20, 30]])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.ply", b"plx", "is no PLY file"),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\n"
                  b"property float y\nproperty float z\nend_header\n" + bytes(24),
         "promises 999,999,999,999 points and ends after 2"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
         "no columns x, y and z"),
        ("a.pcd", b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 99\nDATA binary\n" + bytes(24), "ends after 2"),
        ("a.pcd", b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F\nPOINTS 9\nDATA ascii\n", "do not belong together"),
        ("a.ptx", b"99999\n99999\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 4\n",
         "too short"),
        ("a.xyz", b"no numbers\nhere\n", "no line of three numbers"),
        ("a.xyz", b"1 2 3\n4 5x 6\n", 'what is no number: "5x"'),
        ("a.bin", b"", "is none of"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_said(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PointFileError, match=says) as error, open_points(tmp_path / name) as reader:
        list(reader.chunks())
    assert str(error.value).startswith(name)
