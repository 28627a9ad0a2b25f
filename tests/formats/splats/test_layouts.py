"""Files of captured splats written by hand: each format's numbers mean what its documentation says."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.formats.points import ply
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.formats.splats.axes import blender_from
from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.formats.splats.reader import messages
from tests.support import splat_files as files

C0 = 1 / math.sqrt(4 * math.pi)
ONE = {"x": [1.0], "y": [2.0], "z": [3.0], "f_dc_0": [0.1], "f_dc_1": [0.2], "f_dc_2": [0.3], "opacity": [0.0],
       "scale_0": [math.log(2)], "scale_1": [math.log(3)], "scale_2": [math.log(4)],
       "rot_0": [0.0], "rot_1": [0.0], "rot_2": [0.0], "rot_3": [-5.0]}  # fmt: skip


def read(path, level=0) -> Any:
    with open_splats(path, files.read_picture, level) as reader:
        return files.read_all(reader)


def check_one(found):
    np.testing.assert_allclose(found.position, [[1, 2, 3]])
    np.testing.assert_allclose(found.scale, [[2, 3, 4]], rtol=1e-6)
    np.testing.assert_allclose(found.rotation, [[0, 0, 0, -1]])
    np.testing.assert_allclose(found.base, [[0.1, 0.2, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(found.opacity, [0.5])


@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize("turned", [False, True])
def test_ply_has_logarithms_and_logits_in_any_order_of_properties(tmp_path, order, turned):
    columns = dict(reversed(ONE.items())) if turned else ONE
    files.write_splat_ply(tmp_path / "a.ply", columns, order)
    assert ply.kind_of(tmp_path / "a.ply") == "SPLATS"
    check_one(read(tmp_path / "a.ply"))


@pytest.mark.parametrize("count", [3, 8, 15, 24])
def test_ply_has_one_channels_coefficients_after_another(tmp_path, count):
    rest = {f"f_rest_{i}": [i / 100] for i in range(3 * count)}
    files.write_splat_ply(tmp_path / "a.ply", {**ONE, "nx": [math.nan], **rest})
    found = read(tmp_path / "a.ply")
    expected = np.arange(3 * count).reshape(3, count).T / 100
    np.testing.assert_allclose(found.sh, expected[None], rtol=1e-6)
    check_one(found)


def test_ply_without_a_third_scale_has_disks(tmp_path):
    columns = {name: values for name, values in ONE.items() if name != "scale_2"}
    files.write_splat_ply(tmp_path / "a.ply", columns)
    np.testing.assert_allclose(read(tmp_path / "a.ply").scale, [[2, 3, 0]], rtol=1e-6)


@pytest.mark.parametrize(("comment", "expected"), [
    ("SplatRenderMode: mip", True), ("antialiased 1", True), ("antialiased 0", False), ("SplatRenderMode: 2dgs", False),
])  # fmt: skip
def test_comments_of_ply_tell_of_training(tmp_path, comment, expected):
    files.write_splat_ply(tmp_path / "a.ply", ONE, comments=(comment,))
    assert read(tmp_path / "a.ply").antialiased == expected


def test_the_filter_of_mip_splatting_widens_splats_and_keeps_their_mass(tmp_path):
    files.write_splat_ply(tmp_path / "a.ply", {**ONE, "filter_3D": [1.5]})
    found = read(tmp_path / "a.ply")
    wider = np.sqrt(np.array([4, 9, 16]) + 2.25)
    np.testing.assert_allclose(found.scale[0], wider, rtol=1e-6)
    np.testing.assert_allclose(found.opacity * wider.prod(), 0.5 * 24, rtol=1e-6)
    assert found.antialiased


def test_far_positions_in_double_precision_have_an_origin(tmp_path):
    names = "".join(f"property {'double' if name in 'xyz' else 'float'} {name}\n" for name in ONE)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex 1\n{names}end_header\n"
    values = [500_000.125, *(column[0] for column in list(ONE.values())[1:])]
    (tmp_path / "a.ply").write_bytes(head.encode() + struct.pack("<3d11f", *values))
    found = read(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.origin + found.position[0].astype(np.float64), [500_000.125, 2, 3])


def test_packed_ply_has_shares_of_the_ranges_of_chunks(tmp_path):
    ranges = [[-1, 0, 10, 1, 4, 20, -8, -8, -8, 0, 0, 0, 0, 0, 0, 1, 2, 0.5], [5] * 6 + [-1] * 6 + [0.25] * 6]
    # The second splat: position (2047, 0, 1024), y is the largest component, colours (255, 128, 0), opacity 51.
    position = 2047 << 21 | 0 << 11 | 1024
    rotation = 2 << 30 | 1023 << 20 | 512 << 10 | 0
    scale = 2047 << 21 | 1023 << 11 | 0
    plain = [0, 0, 0, 0]
    words = [plain, [position, rotation, scale, 255 << 24 | 128 << 16 | 0 << 8 | 51], *[plain] * 254, [0, 0, 0, 255]]
    sh = [[128] * 9, [0, 255, 64, *range(6)], *[[128] * 9] * 255]
    files.write_packed_ply(tmp_path / "a.ply", ranges, words, sh)
    assert ply.kind_of(tmp_path / "a.ply") == "SPLATS"
    found = read(tmp_path / "a.ply")
    assert len(found) == 257
    np.testing.assert_allclose(found.position[1], [1, 0, 10 + 10 * 1024 / 2047], rtol=1e-6)
    np.testing.assert_allclose(np.log(found.scale[1]), [0, 0, -8], atol=1e-6)
    a, b, c = (np.array([1023, 512, 0]) / 1023 - 0.5) * math.sqrt(2)
    largest = math.sqrt(max(0, 1 - a * a - b * b - c * c))
    np.testing.assert_allclose(found.rotation[1], [a, b, largest, c], atol=1e-6)
    color = np.array([1, 2 * 128 / 255, 0])
    np.testing.assert_allclose(found.base[1], (color - 0.5) / C0, atol=1e-6)
    np.testing.assert_allclose(found.opacity[[0, 1, 256]], [0, 0.2, 1], rtol=1e-6)
    np.testing.assert_allclose(found.position[256], [5, 5, 5])
    steps = [-4, 4, 64.5 / 32 - 4, -4, *((i + 0.5) / 32 - 4 for i in range(1, 6))]
    np.testing.assert_allclose(found.sh[1], np.array(steps).reshape(3, 3).T, rtol=1e-6)


def test_packed_ply_without_ranges_of_colours_has_them_from_0_to_1(tmp_path):
    files.write_packed_ply(tmp_path / "a.ply", [[0] * 6 + [-1] * 6], [[0, 0, 0, 0xFF00FFFF]])
    np.testing.assert_allclose(read(tmp_path / "a.ply").base[0] * C0 + 0.5, [1, 0, 1], atol=1e-6)


def test_splat_has_bytes_of_colours_and_of_a_quaternion(tmp_path):
    (tmp_path / "a.splat").write_bytes(struct.pack("<6f8B", 1, 2, 3, 0.5, 0.25, 2, 255, 0, 51, 204, 128, 128, 0, 128))
    found = read(tmp_path / "a.splat")
    np.testing.assert_array_equal(found.position, [[1, 2, 3]])
    np.testing.assert_array_equal(found.scale, [[0.5, 0.25, 2]])
    np.testing.assert_array_equal(found.rotation, [[0, 0, -1, 0]])
    np.testing.assert_allclose(found.base[0] * C0 + 0.5, [1, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(found.opacity, [0.8], rtol=1e-6)


def test_ksplat_of_level_0_has_floats(tmp_path):
    one = struct.pack("<3f3f4f4B9f", 1, 2, 3, 0.5, 0.25, 2, 0, 0, 3, 0, 255, 0, 51, 204, *range(9))
    files.write_ksplat(tmp_path / "a.ksplat", 0, [one], 1)
    found = read(tmp_path / "a.ksplat")
    np.testing.assert_array_equal(found.position, [[1, 2, 3]])
    np.testing.assert_array_equal(found.scale, [[0.5, 0.25, 2]])
    np.testing.assert_array_equal(found.rotation, [[0, 0, 1, 0]])
    np.testing.assert_array_equal(found.sh[0], np.arange(9).reshape(3, 3).T)
    np.testing.assert_allclose(found.opacity, [0.8], rtol=1e-6)


@pytest.mark.parametrize("level", [1, 2])
def test_ksplat_of_higher_levels_has_positions_about_centres_of_buckets(tmp_path, level):
    sh = struct.pack("<24e", *range(24)) if level == 1 else bytes(range(24))
    one = struct.pack("<3H3e4e4B", 32767, 0, 65534, 0.5, 0.25, 2, 0, 0, 3, 0, 255, 0, 51, 204) + sh
    files.write_ksplat(tmp_path / "a.ksplat", level, [one] * 3, 2, (10, 20, 30), 4.0)
    found = read(tmp_path / "a.ksplat")
    np.testing.assert_allclose(found.position, [[10, 18, 32]] * 3, rtol=1e-6)
    np.testing.assert_array_equal(found.scale[2], [0.5, 0.25, 2])
    values = np.arange(24) if level == 1 else np.arange(24) * 4 / 255 - 2
    expected = np.concatenate([values[:9].reshape(3, 3).T, values[9:].reshape(3, 5).T])
    np.testing.assert_allclose(found.sh[1], expected, rtol=1e-5)


SMALL = struct.pack("<I", 3 << 30 | (1 << 9 | 511) << 20 | 0 << 10 | 0)  # -sqrt(1/2), 0, 0 and w, the largest


def spz_parts(version):
    place = struct.pack("<3e", 1, 2, -3) if version == 1 else b"\x00\x08\x00" + b"\x00\xf0\xff" + b"\x01\x00\x00"
    turn = bytes([0, 128, 127]) if version < 3 else SMALL
    sh = bytes([128, 0, 255, 192, 128, 128, 64, 128, 128])
    return [place, bytes([51]), bytes([255, 0, 128]), bytes([160, 176, 0]), turn, sh]


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_spz_has_bytes_of_everything(tmp_path, version):
    (tmp_path / "a.spz").write_bytes(files.spz_bytes(version, 1, 1, 11, 1, spz_parts(version)))
    found = read(tmp_path / "a.spz")
    place = [1, 2, -3] if version == 1 else [1, -2, 2**-11]
    np.testing.assert_allclose(found.position, [place])
    np.testing.assert_allclose(found.opacity, [0.2], rtol=1e-6)
    np.testing.assert_allclose(found.base[0] * 0.15 + 0.5, [1, 0, 128 / 255], atol=1e-6)
    np.testing.assert_allclose(found.scale[0], [1, math.e, math.exp(-10)], rtol=1e-5)
    s = math.sqrt(0.5)
    expected = [0, -1, 1 / 255, -1 / 255] if version < 3 else [s, -s, 0, 0]
    np.testing.assert_allclose(found.rotation[0], expected, atol=1e-4)  # measured 3.1e-5: of unit length only here
    np.testing.assert_allclose(found.sh[0], [[0, -1, 127 / 128], [0.5, 0, 0], [-0.5, 0, 0]])
    assert found.antialiased


def test_spz_without_gzip_is_read(tmp_path):
    import gzip

    (tmp_path / "a.spz").write_bytes(gzip.decompress(files.spz_bytes(2, 1, 1, 11, 0, spz_parts(2))))
    assert len(read(tmp_path / "a.spz")) == 1


@pytest.mark.parametrize("version", [3, 4])
def test_spz_names_its_axes_where_they_are_not_the_usual_ones(tmp_path, version):
    path = tmp_path / "a.spz"
    path.write_bytes(files.spz_bytes(version, 1, 1, 11, 0, spz_parts(version)))
    with open_splats(path) as reader:
        assert reader.header.axes == "RUB"
    tail = struct.pack("<II3s", 0x12340001, 3, b"abc") + struct.pack("<III", 0xADBE0003, 4, 12)
    path.write_bytes(files.spz_bytes(version, 1, 1, 11, 2, spz_parts(version), tail))
    with open_splats(path) as reader:
        assert reader.header.axes == "RFU"
    np.testing.assert_array_equal(blender_from("RFU"), np.eye(3))


def test_axes_of_files_turn_to_blenders():
    np.testing.assert_array_equal(blender_from("RDF") @ [0, -1, 0], [0, 0, 1])  # upwards
    np.testing.assert_array_equal(blender_from("RDF") @ [0, 0, 1], [0, 1, 0])  # forwards
    np.testing.assert_array_equal(blender_from("RUB") @ [0, 1, 0], [0, 0, 1])
    np.testing.assert_array_equal(blender_from("RUB") @ [0, 0, -1], [0, 1, 0])
    assert np.linalg.det(blender_from("LUB")) < 0


@pytest.mark.parametrize("name", ["a.sog", "folder"])
def test_sog_has_numbers_in_pixels(tmp_path, name):
    parts = files.sog_files(9)
    files.write_sog(tmp_path / name, parts)
    found = read(tmp_path / name)
    pixels = {key: files.read_picture(data, key) for key, data in parts.items() if key.endswith("webp")}
    flat = {key: picture.reshape(-1, 4)[:9].astype(np.float64) for key, picture in pixels.items()}
    share = (flat["means_l.webp"] + 256 * flat["means_u.webp"])[:, :3] / 65535
    n = np.array([-1, -2, -3]) + share * np.array([2, 4, 6])
    np.testing.assert_allclose(found.position, np.sign(n) * (np.exp(np.abs(n)) - 1), rtol=1e-5)
    book = np.linspace(-3, 1, 256)
    np.testing.assert_allclose(found.scale, np.exp(book[flat["scales.webp"][:, :3].astype(int)]), rtol=1e-6)
    np.testing.assert_allclose(found.base, book[flat["sh0.webp"][:, :3].astype(int)], rtol=1e-6)
    np.testing.assert_allclose(found.opacity, flat["sh0.webp"][:, 3] / 255)
    for row, pixel in zip(found.rotation, flat["quats.webp"], strict=True):
        stored = (pixel[:3] / 255 * 2 - 1) / math.sqrt(2)
        expected = np.insert(stored, int(pixel[3]) - 252, math.sqrt(max(0, 1 - (stored**2).sum())))
        np.testing.assert_allclose(row, expected / np.linalg.norm(expected), atol=1e-6)
    labels = flat["labels.webp"][:, 0].astype(int)
    for row, label in zip(found.sh, labels, strict=True):
        entry = pixels["centroids.webp"][label // 64, 3 * (label % 64) : 3 * (label % 64) + 3, :3]
        np.testing.assert_allclose(row, book[entry], rtol=1e-6)
    assert found.antialiased


def streamed(folder, **changes):
    """Two levels: 9 splats in two sets, and 4 in one."""
    for name, count in (("fine", 6), ("second", 3), ("coarse", 4)):
        files.write_sog(folder / name, files.sog_files(count, name != "second"))
    lods = [{"0": {"file": 2, "offset": 0, "count": 6}, "1": {"file": 0, "offset": 0, "count": 2}},
            {"0": {"file": 1, "offset": 1, "count": 2}, "1": {"file": 0, "offset": 2, "count": 2}}]  # fmt: skip
    meta = {
        "lodLevels": 2, "environment": None, "filenames": [f"{n}/meta.json" for n in ("coarse", "second", "fine")],
        "tree": {"children": [{"lods": entry} for entry in lods]}, **changes,
    }  # fmt: skip
    (folder / "lod-meta.json").write_text(json.dumps(meta))


def test_streamed_sog_is_read_at_one_level(tmp_path):
    streamed(tmp_path)
    fine, second, coarse = (read(tmp_path / name) for name in ("fine", "second", "coarse"))
    found = read(tmp_path)
    np.testing.assert_array_equal(found.position, np.concatenate([second.position[1:], fine.position]))
    np.testing.assert_array_equal(found.sh, np.concatenate([np.zeros((2, 3, 3)), fine.sh]))
    np.testing.assert_array_equal(read(tmp_path, 1).position, coarse.position)


def test_nodes_without_the_level_show_the_next_coarser_one(tmp_path):
    lods = {"0": {"file": 2, "offset": 0, "count": 6}}, {"1": {"file": 0, "offset": 2, "count": 2}}
    streamed(tmp_path, tree={"children": [{"lods": entry} for entry in lods]}, environment="second/meta.json")
    found = read(tmp_path)
    fine, second, coarse = (read(tmp_path / name) for name in ("fine", "second", "coarse"))
    expected = np.concatenate([coarse.position[2:], fine.position, second.position])
    np.testing.assert_array_equal(found.position, expected)


@pytest.mark.parametrize(("changes", "what"), [
    ({"lodLevels": 0}, "no level 0"), ({"filenames": ["a/meta.json"]}, "names file"), ({"tree": []}, "tree"),
    ({"filenames": ["../a/meta.json"] * 3}, "outside"), ({"filenames": ["none/meta.json"] * 3}, "missing"),
    ({"tree": {"lods": {"0": {"file": 0, "offset": 0, "count": 5}}}}, "up to 5"),
    ({"tree": {"lods": {"0": {"file": 0}}}}, "no file, offset and count"),
])  # fmt: skip
def test_streamed_sets_that_are_not_whole_are_refused(tmp_path, changes, what):
    streamed(tmp_path, **changes)
    with pytest.raises(PointFileError, match=what):
        read(tmp_path)


# What cannot be drawn


def columns_of(count):
    return {name: list(values) * count for name, values in ONE.items()}


@pytest.mark.parametrize(("name", "value"), [
    ("x", math.nan), ("y", math.inf), ("opacity", math.nan), ("opacity", -math.inf), ("scale_0", math.nan),
    ("scale_1", math.inf), ("scale_2", -math.inf), ("scale_0", 200.0), ("rot_0", math.nan), ("rot_1", math.inf),
    ("f_dc_1", math.nan),
])  # fmt: skip
def test_values_that_are_no_numbers_are_left_out_and_counted(tmp_path, name, value):
    columns = columns_of(3)
    columns[name][1] = value
    columns["x"][2] = 7.0
    files.write_splat_ply(tmp_path / "a.ply", columns)
    with open_splats(tmp_path / "a.ply") as reader:
        found = files.read_all(reader)
        assert reader.dropped == 1
        assert messages(reader) == ["1 splats with values that are no numbers are left out"]
    np.testing.assert_array_equal(found.position[:, 0], [1, 7])


def test_an_infinite_logit_is_opaque(tmp_path):
    files.write_splat_ply(tmp_path / "a.ply", {**ONE, "opacity": [math.inf]})
    assert read(tmp_path / "a.ply").opacity == 1


@pytest.mark.parametrize(("factor", "turned"), [(0.0, False), (1e-30, True), (1e30, True)])
def test_quaternions_of_any_length_turn_and_zero_does_not(tmp_path, factor, turned):
    files.write_splat_ply(tmp_path / "a.ply", {**ONE, "rot_1": [3.0 * factor], "rot_3": [4.0 * factor]})
    with open_splats(tmp_path / "a.ply") as reader:
        found = files.read_all(reader)
        assert reader.unturned == (not turned)
        assert bool(messages(reader)) == (not turned)
    np.testing.assert_allclose(found.rotation, [[0, 0.6, 0, 0.8] if turned else [1, 0, 0, 0]], rtol=1e-6)


@pytest.mark.parametrize("log", [-20.7, 20.7])
def test_scales_of_a_billionth_and_a_billion_are_kept(tmp_path, log):
    files.write_splat_ply(tmp_path / "a.ply", {**ONE, "scale_0": [log]})
    np.testing.assert_allclose(read(tmp_path / "a.ply").scale[0, 0], math.exp(log), rtol=1e-5)


@pytest.mark.parametrize("write", [
    lambda path: files.write_splat_ply(path / "a.ply", columns_of(0)),
    lambda path: files.write_packed_ply(path / "a.ply", [], []),
    lambda path: (path / "a.splat").write_bytes(b""),
    lambda path: files.write_ksplat(path / "a.ksplat", 0, []),
    lambda path: (path / "a.spz").write_bytes(files.spz_bytes(3, 0, 0, 12, 0, [b""] * 5)),
    lambda path: (path / "a.spz").write_bytes(files.spz_bytes(4, 0, 0, 12, 0, [b""] * 5)),
])  # fmt: skip
def test_files_of_no_splats_are_read(tmp_path, write):
    write(tmp_path)
    [path] = tmp_path.iterdir()
    assert len(read(path)) == 0


@pytest.mark.parametrize(("columns", "what"), [
    ({"x": [0.0], "y": [0.0], "z": [0.0], "red": [1.0]}, "a.ply: holds no captured splats: .* have no f_dc_0, f_dc_1"),
    ({**ONE, "f_rest_0": [0.0], "f_rest_1": [0.0]}, "2 coefficients"),
    ({**ONE, **{f"f_rest_{i}": [0.0] for i in range(1, 10)}}, "but not f_rest_0"),
    ({name: value for name, value in ONE.items() if name != "rot_3"}, "no rot_3"),
])  # fmt: skip
def test_a_ply_file_of_something_else_is_told_what_it_lacks(tmp_path, columns, what):
    files.write_splat_ply(tmp_path / "a.ply", columns)
    with pytest.raises(PointFileError, match=what):
        open_splats(tmp_path / "a.ply")


def test_chunks_are_counted_beyond_what_float32_counts():
    """Rows are numbered by integers: a reader of 2^24 + 3 splats yields the last ones as they are."""
    from pointsplat_addon.formats.splats.reader import BlockReader, SplatHeader

    class Counted(BlockReader):
        def decode(self, first, out):
            rows = first + np.arange(len(out.opacity))
            out.position[:] = np.stack([rows & 1, rows >> 1 & 0xFFFF, rows >> 17], axis=1)
            for array in out[1:]:
                array[:] = 1

    reader = Counted()
    reader.header = SplatHeader(None, "made", 2**24 + 3)  # pyright: ignore[reportArgumentType]
    total, last = 0, None
    for part in reader.chunks(1 << 21):
        total += len(part)
        last = part.position[-1]
    assert total == 2**24 + 3
    assert last is not None
    number = int(last[0]) + 2 * int(last[1]) + (int(last[2]) << 17)
    assert number == 2**24 + 2
