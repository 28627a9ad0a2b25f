"""LAS and LAZ as laspy writes them, in all point formats; hostile headers; Entwine and Potree folders of such files."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from pointsplat_addon.formats.points.gather import Selection, gather
from pointsplat_addon.formats.points.lidar import laz_chunks
from pointsplat_addon.formats.points.opening import open_points
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support.scan_files import write_potree

laspy = pytest.importorskip("laspy", reason="it comes with the extension")


def scan(point_format: int, count: int = 2000):
    """A file of random points near (5e6, 4e5, 100), in steps of a millimetre."""
    version = "1.4" if point_format >= 6 else "1.2" if point_format < 4 else "1.3"
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.offsets, header.scales = np.array([5e6, 4e5, 0.0]), np.full(3, 0.001)
    header.add_extra_dim(laspy.ExtraBytesParams("deviation", "float32"))
    las = laspy.LasData(header)
    random = np.random.default_rng(point_format)
    position = np.round(random.uniform(-100, 100, (count, 3)), 3) + np.array([5e6, 4e5, 100.0])
    las.x, las.y, las.z = position.T
    las.intensity = random.integers(0, 65536, count)
    las.classification = random.integers(0, 32, count)
    las.return_number = random.integers(0, 8, count)
    las["deviation"] = random.normal(size=count).astype(np.float32)
    for name in ("red", "green", "blue", "nir"):
        if name in las.point_format.dimension_names:
            las[name] = 257 * random.integers(0, 256, count)
    if "gps_time" in las.point_format.dimension_names:
        las.gps_time = 3e8 + random.random(count)
    return las, position


def whole(path, columns=None, size=700):
    with open_points(path) as reader:
        chunks = list(reader.chunks(columns, size))
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}


@pytest.mark.parametrize("end", ["las", "laz"])
@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 6, 7, 8])
def test_all_point_formats(tmp_path, point_format, end):
    las, position = scan(point_format)
    las.write(str(tmp_path / f"a.{end}"))
    found = whole(tmp_path / f"a.{end}")
    np.testing.assert_allclose(found["position"], position, rtol=0, atol=1e-9)  # half a unit in the last place of 5e6
    for name in ("intensity", "classification", "return_number", "deviation", "gps_time", "infrared"):
        if name in found:
            np.testing.assert_array_equal(found[name], np.asarray(las["nir" if name == "infrared" else name]))
    assert ("color" in found) == (point_format in (2, 3, 7, 8))
    if "color" in found:
        np.testing.assert_array_equal(found["color"][:, 1], las.green)


def test_only_wanted_columns_are_read(tmp_path):
    scan(7)[0].write(str(tmp_path / "a.laz"))
    assert set(whole(tmp_path / "a.laz", {"color"})) == {"position", "color"}


def run(readers, selection=None):
    """What gather returns."""
    work = gather(readers, selection or Selection(), 300)
    shares = []
    while True:
        try:
            shares.append(next(work))
        except StopIteration as done:
            assert shares == sorted(shares)
            assert shares[-1] == 1
            return done.value


def test_positions_keep_a_millimetre_in_float32(tmp_path):
    las, position = scan(7)
    las.write(str(tmp_path / "a.las"))
    with open_points(tmp_path / "a.las") as reader:
        found = run([reader])
    assert found.columns["position"].dtype == np.float32
    error = found.columns["position"].astype(np.float64) + found.origin - position
    assert np.abs(error).max() < 1.6e-5  # measured 1.53e-5: half a unit in the last place of 400 m in float32
    assert found.columns["color"].dtype == np.uint8  # multiples of 257 are eight bits
    assert np.abs(found.columns["gps_time"]).max() <= 1.0
    assert found.time_start == las.gps_time[0]


def test_bounds_that_lie_cost_no_precision(tmp_path):
    las, position = scan(6)
    las.write(str(tmp_path / "a.las"))
    damaged(tmp_path / "a.las", 179, "<2d", 5e9, 5e9)  # of x
    with open_points(tmp_path / "a.las") as reader:
        found = run([reader])
    np.testing.assert_allclose(found.columns["position"] + found.origin, position, rtol=0, atol=1.6e-5)


def test_points_are_chosen(tmp_path):
    las, position = scan(6)
    las.write(str(tmp_path / "a.las"))
    kept = np.isin(np.asarray(las.classification), (2, 6))
    low, high = position.min(axis=0), np.median(position, axis=0)
    inside = (position <= high).all(axis=1)
    with open_points(tmp_path / "a.las") as reader:
        assert len(run([reader], Selection(every=7))) == -(-len(position) // 7)
    with open_points(tmp_path / "a.las") as reader:
        found = run([reader], Selection(frozenset(), classes=frozenset({2, 6}), box=(tuple(low), tuple(high))))
    assert set(found.columns) == {"position"}
    np.testing.assert_allclose(found.columns["position"] + found.origin, position[kept & inside], rtol=0, atol=1.6e-5)


def test_tiles_of_a_survey_share_an_origin(tmp_path):
    first, here = scan(6)
    second, there = scan(7)
    first.write(str(tmp_path / "a.laz"))
    second.write(str(tmp_path / "b.laz"))
    readers = [open_points(tmp_path / name) for name in ("a.laz", "b.laz")]
    found = run(readers)
    for reader in readers:
        reader.close()
    np.testing.assert_allclose(
        found.columns["position"] + found.origin, np.concatenate([here, there]), rtol=0, atol=1.6e-5
    )
    assert (found.columns["color"][: len(here), :3] == 0).all()  # of the file that has no colours


def damaged(path, place, layout, *values):
    data = bytearray(path.read_bytes())
    struct.pack_into(layout, data, place, *values)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("place", "layout", "value", "says"),
    [
        (0, "4s", b"LASX", "is no LAS file"),
        (100, "<I", 1 << 30, "promises 1,073,741,824 records"),
        (96, "<I", 1 << 31, "points begin at byte 2,147,483,648"),
        (94, "<H", 60_000, "points begin at byte"),
        (105, "<H", 0, "points of no bytes"),
        (235, "<Q", 1 << 50, "records behind its points"),
    ],
)
def test_headers_that_lie_are_told(tmp_path, place, layout, value, says):
    las, _ = scan(6)
    las.write(str(tmp_path / "a.las"))
    path = damaged(tmp_path / "a.las", place, layout, value)
    if place == 235:
        damaged(path, 243, "<I", 5)
    with pytest.raises(PointFileError, match=says):
        open_points(path)


def test_a_record_behind_the_points_longer_than_the_file_is_told(tmp_path):
    las, _ = scan(6)
    las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("someone", 7, "", b"four")])
    las.write(str(tmp_path / "a.las"))
    (first,) = struct.unpack_from("<Q", (tmp_path / "a.las").read_bytes(), 235)
    with open_points(tmp_path / "a.las") as reader:
        assert reader.header.count == 2000
    damaged(tmp_path / "a.las", first + 20, "<Q", 1 << 40)
    with pytest.raises(PointFileError, match="a record behind its points that ends at byte"):
        open_points(tmp_path / "a.las")


def test_more_points_promised_than_there_are(tmp_path):
    las, _ = scan(6)
    las.write(str(tmp_path / "a.las"))
    damaged(tmp_path / "a.las", 247, "<Q", 1 << 40)
    with open_points(tmp_path / "a.las") as reader:
        assert "promises 1,099,511,627,776 points, and it has 2,000" in reader.warnings[0]


def test_truncated_laz_is_told(tmp_path):
    las, _ = scan(7, 60_000)
    las.write(str(tmp_path / "a.laz"))
    data = (tmp_path / "a.laz").read_bytes()
    (tmp_path / "a.laz").write_bytes(data[: len(data) // 2])
    with pytest.raises(PointFileError, match=r"a\.laz"), open_points(tmp_path / "a.laz") as reader:
        list(reader.chunks())


def test_batches_hold_each_chunk_once_and_no_more_than_they_may(monkeypatch):
    monkeypatch.setattr(laz_chunks.os, "cpu_count", lambda: 2)
    chunks = [(100, 1), (100, 2), (300, 3), (100, 4), (100, 5), (100, 6)]
    assert list(laz_chunks.batches(chunks, 750, 10, 2000)) == [
        [(100, 1), (100, 2)],
        [(300, 3)],
        [(100, 4), (100, 5)],
        [(50, 6)],
    ]
    assert [len(batch) for batch in laz_chunks.batches([(1, 1)] * 20, 20, 10, 2000)] == [8, 8, 4]


def test_chunks_of_laz_that_promise_gigabytes_are_decoded_one_by_one(tmp_path):
    """Side by side, lazrs would allocate 2^30 points, and abort the process where there is no room for them."""
    las, position = scan(6)
    las.write(str(tmp_path / "a.laz"))
    data = (tmp_path / "a.laz").read_bytes()
    record = data.index(b"laszip encoded") - 2 + 54
    damaged(tmp_path / "a.laz", record + 12, "<I", 1 << 30)
    np.testing.assert_allclose(whole(tmp_path / "a.laz")["position"], position, rtol=0, atol=1e-9)


@pytest.mark.parametrize("point_format", [3, 7, 10])
def test_chunks_side_by_side_are_those_of_laspy(tmp_path, monkeypatch, point_format):
    """Three chunks of LASzip; each column alone, of which lazrs decodes no other layers, is as it is among all."""
    monkeypatch.setattr(laz_chunks.os, "cpu_count", lambda: 4)
    las, position = scan(point_format, 120_000)
    random = np.random.default_rng(1)
    for name in ("user_data", "point_source_id", "synthetic", "overlap", "wavepacket_size", "x_t"):
        if name in las.point_format.dimension_names:
            las[name] = random.integers(0, 2, len(position))
    las.write(str(tmp_path / "a.laz"))
    with open_points(tmp_path / "a.laz") as reader:
        assert [len(chunk["position"]) for chunk in reader.chunks((), 1 << 20)] == [120_000]
        assert [len(chunk["position"]) for chunk in reader.chunks((), 70_000)] == [70_000, 50_000]
        attributes = reader.header.attributes
    found = whole(tmp_path / "a.laz")
    np.testing.assert_allclose(found["position"], position, rtol=0, atol=1e-9)
    for attribute in attributes[1:]:
        truth = np.stack([np.asarray(las[name]) for name in attribute.source], axis=-1).reshape(
            found[attribute.name].shape
        )
        np.testing.assert_array_equal(found[attribute.name], truth)
        alone = whole(tmp_path / "a.laz", (attribute.name,))
        assert set(alone) == {"position", attribute.name}
        np.testing.assert_array_equal(alone[attribute.name], truth)


def test_a_damaged_chunk_is_told_after_those_before_it(tmp_path, monkeypatch):
    monkeypatch.setattr(laz_chunks.os, "cpu_count", lambda: 4)
    las, position = scan(0, 120_000)
    las.write(str(tmp_path / "a.laz"))
    with open_points(tmp_path / "a.laz") as reader:
        reader._packed = [*reader._packed[:2], (50_000, 100)]
        chunks = reader.chunks()
        found = [next(chunks)["position"], next(chunks)["position"]]
        with pytest.raises(PointFileError, match=r"a\.laz: cannot be read from point 100,000 on: "):
            next(chunks)
    np.testing.assert_allclose(np.concatenate(found), position[:100_000], rtol=0, atol=1e-9)


def test_an_entwine_folder_is_read_level_by_level(tmp_path):
    folder = tmp_path / "ept"
    (folder / "ept-data").mkdir(parents=True)
    (folder / "ept-hierarchy").mkdir()
    record = np.dtype([("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("Red", "<u2"), ("Green", "<u2"), ("Blue", "<u2")])
    schema = [{"name": name, "type": "signed", "size": 4, "scale": 0.01, "offset": 100.0} for name in "XYZ"]
    schema += [{"name": name, "type": "unsigned", "size": 2} for name in ("Red", "Green", "Blue")]
    facts = {"bounds": [0, 0, 0, 200, 200, 200], "dataType": "binary", "schema": schema, "points": 5}
    (folder / "ept.json").write_text(json.dumps(facts))
    (folder / "ept-hierarchy" / "0-0-0-0.json").write_text('{"0-0-0-0": 2, "1-0-0-0": -1, "1-1-0-0": 1}')
    (folder / "ept-hierarchy" / "1-0-0-0.json").write_text('{"1-0-0-0": 1, "2-0-0-0": 1}')
    rows = {}
    for number, (node, count) in enumerate({"0-0-0-0": 2, "1-0-0-0": 1, "1-1-0-0": 1, "2-0-0-0": 1}.items()):
        rows[node] = np.zeros(count, record)
        rows[node]["X"] = number
        rows[node].tofile(folder / "ept-data" / f"{node}.bin")
    found = whole(folder)
    np.testing.assert_allclose(found["position"][:, 0], [100, 100, 100.01, 100.02, 100.03], rtol=1e-12)
    assert found["color"].shape == (5, 3)
    (folder / "ept-data" / "1-1-0-0.bin").unlink()
    with pytest.raises(PointFileError, match=r"1-1-0-0\.bin: is missing"):
        whole(folder)


def test_a_potree_folder_is_read_level_by_level(tmp_path):
    random = np.random.default_rng(5)
    low, side = (-1.0, 2.0, 5.0), 8.0
    nodes = {}
    for name in ("r", "r0", "r7", "r07", "r071", "r0716", "r07163"):
        corner, size = np.array(low), side
        for digit in map(int, name[1:]):
            size /= 2
            corner = corner + size * np.array([digit >> 2 & 1, digit >> 1 & 1, digit & 1])
        nodes[name] = corner + random.random((10, 3)) * size
    write_potree(tmp_path / "p", nodes, low, side, 1e-6, 2)
    found = whole(tmp_path / "p")
    np.testing.assert_allclose(
        found["position"], np.concatenate(list(nodes.values())), rtol=0, atol=5.1e-7
    )  # half a step
    assert (found["color"] == [10, 20, 30, 255]).all()
