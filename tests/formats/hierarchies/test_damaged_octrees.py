"""Damaged COPC files and Entwine folders: each page is read or refused, in little memory, and makes splats."""

from __future__ import annotations

import shutil
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.formats.hierarchies.opening import open_pages
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.stream.page import make_page
from pointsplat_addon.stream.tree import PageTree
from tests.support import damage
from tests.support.octrees import SIDE, PlainLook, write_octree
from tests.support.scan_files import write_copc

laspy = pytest.importorskip("laspy", reason="it comes with the extension")
QUICK, LONG = 100, 10_000  # damaged files
MOST_MEMORY = 16_000_000  # bytes; measured 0.3e6
COUNTS = [QUICK, pytest.param(LONG, marks=pytest.mark.long)]


def read(path: Path) -> int:
    """Reads all pages and makes splats of them; returns how many there are, or -1 of what cannot be opened."""
    try:
        with open_pages(path) as source:
            tree, count = PageTree(source.directory), 0
            for page in range(len(tree)):
                try:
                    found = source.read(page)
                except (PointFileError, OSError):
                    continue
                assert len({len(column) for column in found.values()}) == 1
                made = make_page(tree, page, found, PlainLook())
                assert made.count.sum() == (0 if made.cloud is None else len(made.cloud))
                assert made.cloud is None or np.isfinite(made.cloud.position).all()
                count += 1
            return count
    except (PointFileError, OSError):
        return -1


def damaged_files(path: Path, source: Path, files: list[Path], count: int, seed: int) -> tuple[int, int, int]:
    """Reads a scan that is opened at `path`, once with each of `count` damages to one of its `files`; returns how many
    of these could not be opened, how many had fewer pages, and the most bytes that one took."""
    whole, content = read(path), {file: file.read_bytes() for file in files}
    random, refused, fewer, most = np.random.default_rng(seed), 0, 0, 0
    tracemalloc.start()
    try:
        for number in range(count):
            file = files[int(random.integers(len(files)))]
            file.write_bytes(damage.damaged(content[file], number % damage.KINDS, random))
            tracemalloc.reset_peak()
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                found = read(path)
            file.write_bytes(content[file])
            refused, fewer = refused + (found < 0), fewer + (0 <= found < whole)
            most = max(most, tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert read(path) == whole > 1
    shutil.rmtree(source)
    return refused, fewer, most


@pytest.mark.parametrize("count", COUNTS)
def test_damaged_copc_files_are_read_or_refused(tmp_path: Path, count: int) -> None:
    made = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
    made.x, made.y, made.z = np.random.default_rng(1).uniform(0, 900, (3, 400))
    made.update_header()
    path = tmp_path / "scan" / "a.copc.laz"
    path.parent.mkdir()
    write_copc(path, made, 4)
    refused, fewer, most = damaged_files(path, path.parent, [path], count, count)
    assert refused > 0
    assert fewer > 0
    assert most < MOST_MEMORY


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", ["laszip", "binary", "zstandard"])
def test_damaged_entwine_folders_are_read_or_refused(tmp_path: Path, kind: str, count: int) -> None:
    some = np.random.default_rng(3).integers(0, SIDE, (120, 3)) * [1, 1, 0] + [0, 0, SIDE // 3]
    folder = tmp_path / "scan"
    write_octree(folder, some, 30, kind)
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    files += [folder / "ept.json", folder / "ept-hierarchy" / "0-0-0-0.json"] * 5  # which each page depends on
    refused, fewer, most = damaged_files(folder / "ept.json", folder, files, count, count)
    assert refused > 0
    assert fewer > 0
    assert most < MOST_MEMORY
