"""E57: bits, checksums, packets, poses and flags, by hand; and a file that libE57 has written."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from pointsplat_addon.formats.points.e57.pages import checksums
from pointsplat_addon.formats.points.e57.records import unpacked
from pointsplat_addon.formats.points.opening import open_points
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support.scan_files import packed_integers, write_e57

FLOATS = "".join(f'<cartesian{axis} type="Float" precision="double"/>' for axis in "XYZ")


def test_checksums_are_those_of_castagnoli():
    # RFC 3720, B.4: 32 bytes of zeros, of ones, and rising ones.
    given = np.stack([np.zeros(32, np.uint8), np.full(32, 255, np.uint8), np.arange(32, dtype=np.uint8)])
    np.testing.assert_array_equal(checksums(given), [0x8A9136AA, 0x62A8AB43, 0x46DD794E])


@pytest.mark.parametrize("bits", [1, 3, 7, 8, 13, 19, 31, 32, 33, 55, 56, 57, 58, 61, 63])
def test_integers_of_any_width_are_unpacked(bits):
    random = np.random.default_rng(bits)
    given = [int(x) >> (63 - bits) for x in random.integers(0, 1 << 63, 100, dtype=np.uint64)]
    data = packed_integers(given, bits)
    assert unpacked(data, 0, bits, 100).tolist() == given
    assert unpacked(data, 5 * bits % 8, bits, 3).tolist() == given[:3] if bits % 8 == 0 else True
    shifted = (int.from_bytes(data, "little") << 5).to_bytes(len(data) + 1, "little")
    assert unpacked(shifted, 5, bits, 100).tolist() == given


def test_records_are_put_together_from_packets(tmp_path):
    count, random = 5000, np.random.default_rng(2)
    position = random.normal(size=(count, 3))
    level = random.integers(-3, 10, count)
    prototype = (
        FLOATS
        + '<intensity type="Integer" minimum="-3" maximum="9"/><rowIndex type="Integer" minimum="5" maximum="5"/>'
    )
    streams = [*(np.ascontiguousarray(column).tobytes() for column in position.T),
               packed_integers([int(v) + 3 for v in level], 4), b""]  # fmt: skip
    write_e57(tmp_path / "a.e57", prototype, streams, count, split=1000)
    with open_points(tmp_path / "a.e57") as reader:
        chunks = list(reader.chunks(size=700))
    np.testing.assert_array_equal(np.concatenate([chunk["position"] for chunk in chunks]), position)
    np.testing.assert_array_equal(np.concatenate([chunk["intensity"] for chunk in chunks]), level)
    assert (np.concatenate([chunk["rowIndex"] for chunk in chunks]) == 5).all()


def test_poses_turn_and_move_points_and_normals(tmp_path):
    half = np.sqrt(0.5)
    pose = (
        f'<pose type="Structure"><rotation type="Structure"><w>{half}</w><x>0</x><y>0</y><z>{half}</z></rotation>'
        "<translation><x>10</x><y>20</y><z>30</z></translation></pose>"
    )
    names = ("cartesianX", "cartesianY", "cartesianZ", "normalX", "normalY", "normalZ")
    prototype = "".join(f'<{name} type="Float" precision="single"/>' for name in names)
    streams = [struct.pack("<f", value) for value in (1, 2, 3, 0, 1, 0)]
    write_e57(tmp_path / "a.e57", prototype, streams, 1, pose)
    with open_points(tmp_path / "a.e57") as reader:
        np.testing.assert_array_equal(reader.header.stations, [[10, 20, 30]])
        [chunk] = reader.chunks()
    # A quarter turn about z takes x to y and y to -x.
    np.testing.assert_allclose(chunk["position"], [[8, 21, 33]], atol=1e-15)
    np.testing.assert_allclose(chunk["normal"], [[-1, 0, 0]], atol=1e-7)


def test_spherical_points_and_those_that_are_none(tmp_path):
    names = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
    prototype = "".join(f'<{name} type="Float"/>' for name in names)
    prototype += '<sphericalInvalidState type="Integer" minimum="0" maximum="2"/>'
    angles = np.array([[2, 0.5, 0.25], [3, -1, 1], [1, 0, 0]])
    streams = [*(np.ascontiguousarray(column).tobytes() for column in angles.T), packed_integers([0, 1, 0], 2)]
    write_e57(tmp_path / "a.e57", prototype, streams, 3)
    with open_points(tmp_path / "a.e57") as reader:
        [chunk] = reader.chunks()
    expected = [[2 * np.cos(0.5) * np.cos(0.25), 2 * np.sin(0.5) * np.cos(0.25), 2 * np.sin(0.25)], [1, 0, 0]]
    np.testing.assert_allclose(chunk["position"], expected, atol=1e-15)


def test_scaled_integers(tmp_path):
    prototype = "".join(
        f'<cartesian{axis} type="ScaledInteger" minimum="-1000" maximum="1000" scale="0.001" offset="{offset}"/>'
        for axis, offset in zip("XYZ", (5e6, 0, -3), strict=True)
    )
    raw = [[-1000, 0, 1000], [1, 2, 3], [0, 0, 999]]
    write_e57(tmp_path / "a.e57", prototype, [packed_integers([v + 1000 for v in row], 11) for row in raw], 3)
    with open_points(tmp_path / "a.e57") as reader:
        [chunk] = reader.chunks()
    expected = np.array(raw).T * 0.001 + [5e6, 0, -3]
    np.testing.assert_allclose(chunk["position"], expected, rtol=0, atol=1e-9)  # half a unit in the last place of 5e6


def test_what_libe57_writes(tmp_path):
    pye57 = pytest.importorskip("pye57", reason="it has no wheel for this machine")
    random = np.random.default_rng(4)
    count = 30_000
    data = {f"cartesian{axis}": random.normal(size=count) for axis in "XYZ"}
    data["intensity"] = random.random(count)
    data |= {f"color{name}": random.integers(0, 256, count) for name in ("Red", "Green", "Blue")}
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        file.write_scan_raw(data, rotation=np.array([0.5, 0.5, 0.5, 0.5]), translation=np.array([1.0, 2.0, 3.0]))
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        given = file.read_scan(0, intensity=True, colors=True, ignore_missing_fields=True)
    with open_points(tmp_path / "a.e57") as reader:
        chunks = list(reader.chunks(size=7000))
    position = np.concatenate([chunk["position"] for chunk in chunks])
    np.testing.assert_allclose(position, np.stack([given[f"cartesian{axis}"] for axis in "XYZ"], axis=1), atol=1e-14)
    color = np.concatenate([chunk["color"] for chunk in chunks])
    np.testing.assert_array_equal(color, np.stack([given[f"color{name}"] for name in ("Red", "Green", "Blue")], axis=1))
    np.testing.assert_array_equal(np.concatenate([chunk["intensity"] for chunk in chunks]), given["intensity"])


def test_a_wrong_checksum_is_found(tmp_path):
    streams = [np.arange(300.0).tobytes()] * 3
    write_e57(tmp_path / "a.e57", FLOATS, streams, 300)
    data = bytearray((tmp_path / "a.e57").read_bytes())
    data[3000] ^= 1
    (tmp_path / "a.e57").write_bytes(data)
    with pytest.raises(PointFileError, match=r"damaged at byte 2,048"), open_points(tmp_path / "a.e57") as reader:
        list(reader.chunks())


def test_points_that_are_promised_and_missing(tmp_path):
    write_e57(tmp_path / "a.e57", FLOATS, [np.arange(300.0).tobytes()] * 3, 320)
    found: list[np.ndarray] = []
    with open_points(tmp_path / "a.e57") as reader:
        chunks = (chunk["position"] for chunk in reader.chunks())
        with pytest.raises(PointFileError, match="promises 320 points and ends after 300"):
            found.extend(chunks)
    assert len(np.concatenate(found)) == 300
