"""Entwine folders and COPC files by pages: together all points of the file, each within its page's bounds."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.surface.nearest import median_spacing
from pointsplat_addon.formats.hierarchies.opening import open_pages
from pointsplat_addon.formats.points.gather import Selection, gather
from pointsplat_addon.formats.points.opening import open_points
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support.octrees import SIDE, write_octree
from tests.support.scan_files import write_copc, write_ept, write_ply

ROUNDING = 2e-5  # of float32 at 200; worst measured: 7.7e-6


def some_points(count: int = 3000) -> np.ndarray:
    return np.random.default_rng(count).integers(0, SIDE, (count, 3)) * [1, 1, 0] + [0, 0, SIDE // 3]


def whole(path: Path):
    """All points of a file, as the import has them."""
    work = gather([open_points(path)], Selection())
    while True:
        try:
            next(work)
        except StopIteration as done:
            return done.value


@pytest.mark.parametrize("kind", ["laszip", "binary", "zstandard"])
def test_pages_hold_all_points_of_the_folder_each_within_its_bounds(tmp_path: Path, kind: str) -> None:
    nodes = write_octree(tmp_path, some_points(), 200, kind)
    with open_pages(tmp_path) as source:
        directory = source.directory
        pages = [source.read(page) for page in range(len(directory))]
    assert len(directory) == len(nodes) > 20
    assert directory.additive
    assert [len(page["position"]) for page in pages] == directory.count.tolist()
    for page, (low, high) in zip(pages, directory.bounds, strict=True):
        assert ((page["position"] >= low - ROUNDING) & (page["position"] <= high + ROUNDING)).all()
    position = np.concatenate([page["position"] for page in pages]) + directory.origin
    found = whole(tmp_path / "ept.json")
    expected = found.columns["position"] + found.origin
    order, other = (np.lexsort(np.round(p, 2).T) for p in (position, expected))
    np.testing.assert_allclose(position[order], expected[other], atol=ROUNDING)
    assert (directory.parent[1:] < np.arange(1, len(directory))).all()
    assert (directory.level[1:] == directory.level[directory.parent[1:]] + 1).all()
    assert directory.nbytes.sum() == sum(file.stat().st_size for file in (tmp_path / "ept-data").iterdir())


def test_spacings_are_those_of_the_points_not_of_the_cells_that_they_were_sorted_into(tmp_path: Path) -> None:
    write_octree(tmp_path, some_points(), 200)
    with open_pages(tmp_path) as source:
        spacing = source.directory.spacing
        assert spacing[0] == np.float32(median_spacing(source.read(0)["position"]))
        np.testing.assert_array_equal(spacing, spacing[0] / 2.0**source.directory.level)


@pytest.mark.parametrize("kind", ["laszip", "binary", "zstandard"])
def test_a_page_whose_file_is_gone_or_cut_short_says_so(tmp_path: Path, kind: str) -> None:
    some = np.random.default_rng(3).integers(0, 10_000, (60, 3))
    write_ept(tmp_path, {"0-0-0-0": some[:20], "1-0-0-0": some[20:40], "1-1-1-1": some[40:]}, kind)
    with open_pages(tmp_path) as source:
        [first] = (tmp_path / "ept-data").glob("1-0-0-0.*")
        first.write_bytes(first.read_bytes()[:30])
        [second] = (tmp_path / "ept-data").glob("1-1-1-1.*")
        second.unlink()
        assert len(source.read(0)["position"]) == 20
        for page in (1, 2):
            with pytest.raises(PointFileError):
                source.read(page)


def test_chunks_of_copc_are_pages(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy", reason="it comes with the extension")
    made = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
    made.x, made.y, made.z = np.random.default_rng(1).uniform(0, 900, (3, 500))
    made.red, made.green, made.blue = np.random.default_rng(2).integers(0, 256, (3, 500)) << 8
    made.update_header()
    write_copc(tmp_path / "a.copc.laz", made)
    with open_pages(tmp_path / "a.copc.laz") as source:
        assert source.directory.parent.tolist() == [-1, 0, 1]
        pages = [source.read(page) for page in range(3)]
        origin = source.directory.origin
    position, color = (np.concatenate([page[name] for page in pages]) for name in ("position", "color"))
    np.testing.assert_allclose(position + origin, made.xyz, atol=1e-4)  # worst measured: 3e-5, of float32
    code = np.stack([made.red, made.green, made.blue], axis=1) / 65280
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(color, linear, atol=1e-6)  # worst measured: 1.2e-7


def test_other_files_are_none(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", np.zeros(3, [("x", "f4"), ("y", "f4"), ("z", "f4")]), "ascii")
    with pytest.raises(PointFileError, match="by pages only"):
        open_pages(tmp_path / "a.ply")
    (tmp_path / "a.copc.laz").write_bytes(b"LASF" + bytes(373) + b"copc" + bytes(400))
    with pytest.raises(PointFileError):
        open_pages(tmp_path / "a.copc.laz")
