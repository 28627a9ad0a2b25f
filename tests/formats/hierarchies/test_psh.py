"""The file format of hierarchies on disk: sizes, and damage."""

from __future__ import annotations

import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.formats.hierarchies import pages as coding
from pointsplat_addon.formats.hierarchies.psh import HEAD, PshPages
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support import damage
from tests.support.scans import FAR, built, small_pages, write_las

pytest.importorskip("laspy", reason="it comes with the extension")
QUICK, LONG = 200, 10_000  # damaged files
MOST_MEMORY = 16_000_000  # bytes; measured 0.2e6


def small_file(folder: Path, monkeypatch, normals: bool = True) -> Path:
    small_pages(monkeypatch)
    random = np.random.default_rng(0)
    write_las(
        folder / "a.las", random.random((2000, 3)) * 10 + FAR, random.integers(65536, size=(2000, 3)).astype("u2")
    )
    built([folder / "a.las"], folder / "a.psh", normals=normals, attributes=("intensity",))
    return folder / "a.psh"


def test_normals_are_off_by_at_most_a_degree():
    random = np.random.default_rng(0)
    normal = random.normal(size=(3, 100_000))
    normal /= np.linalg.norm(normal, axis=0)
    found = coding.frames()[coding.encode_normal(normal)]
    away = np.degrees(np.arccos(np.clip((found[:, :3].T * normal).sum(axis=0), -1, 1)))
    assert away.max() < 1.0  # measured 0.95
    axes = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
    np.testing.assert_allclose(coding.frames()[coding.encode_normal(axes)][:, :3].T, axes, atol=1e-7)
    assert coding.encode_normal(np.zeros((3, 1)))[0] == coding.NONE
    assert not coding.frames()[coding.NONE].any()


def test_colours_of_8_bits_come_back():
    code = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(coding.encode_color(coding.linear_of_code()[code]), code)


def test_lengths_are_off_by_a_thirtieth_at_most():
    length = np.exp2(np.linspace(-15, 0, 10_000))
    found = coding.decode_length(coding.encode_length(length, 1.0), 1.0)
    assert np.abs(found / length - 1).max() < 0.03  # measured 0.028


@pytest.mark.parametrize("extent", [0.0, 1e-3, 60.0, 5000.0])
def test_positions_of_points_keep_millimetres(extent):
    random = np.random.default_rng(0)
    position = np.array(FAR)[:, None] + extent * random.random((3, 1000))
    grid = coding.grid_of(position.min(axis=1), position.max(axis=1), True)
    assert grid.wide == (extent > 66)
    columns = coding.encode_position(position, grid)
    exact = np.stack([
        (columns["low"][i] + (columns["high"][i] * 65536.0 if grid.wide else 0)) * grid.step[i] + grid.low[i]
        for i in range(3)
    ])  # fmt: skip
    assert np.abs(exact - position).max() <= 5e-4


def test_a_page_that_is_damaged_is_refused_and_no_other(tmp_path, monkeypatch):
    path = small_file(tmp_path, monkeypatch)
    with PshPages(path) as pages:
        count = len(pages.directory)
        at = HEAD.size + int(pages.directory.nbytes[:1].sum()) // 2
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)
    with PshPages(path) as pages:
        said = {}
        for page in range(count):
            try:
                pages.read(page)
            except PointFileError as error:
                said[page] = str(error)
    assert list(said.values()) == [f"a.psh: page {next(iter(said))} is damaged: its checksum is wrong"]


def read(path: Path) -> None:
    """Reads all pages; a damaged file is refused with its name."""
    said = []
    try:
        with PshPages(path) as pages:
            for page in range(len(pages.directory)):
                try:
                    found = pages.read(page)
                except PointFileError as error:
                    said.append(str(error))
                    continue
                assert {len(column) for column in found.values()} == {int(pages.directory.count[page])}
                assert all(np.isfinite(column).all() for column in found.values())
    except PointFileError as error:
        said.append(str(error))
    assert all(text.startswith("a.psh: ") for text in said)


@pytest.mark.parametrize("count", [QUICK, pytest.param(LONG, marks=pytest.mark.long)])
@pytest.mark.parametrize("mended", [False, True])
def test_damaged_files_are_read_or_refused(tmp_path, monkeypatch, count, mended):
    """`mended`: with the checksums of what was damaged, so that what they say is read."""
    path = small_file(tmp_path, monkeypatch)
    content = path.read_bytes()
    read(path)
    random = np.random.default_rng([count, mended])
    tracemalloc.start()
    try:
        for number in range(count):
            found = (
                with_damaged_directory(content, random)
                if mended
                else damage.damaged(content, number % damage.KINDS, random)
            )
            path.write_bytes(found)
            tracemalloc.reset_peak()
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                read(path)
            assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY, number
    finally:
        tracemalloc.stop()


def with_damaged_directory(content: bytes, random: np.random.Generator) -> bytes:
    """The file with other bytes in its directory, and checksums that fit them."""
    from pointsplat_addon.formats.hierarchies.psh import pack_head

    offset = HEAD.unpack(content[: HEAD.size])[2]
    directory = damage.damaged(content[offset:], int(random.integers(1, damage.KINDS)), random)
    return pack_head(directory, offset) + content[HEAD.size : offset] + directory


@pytest.mark.parametrize("normals", [False, True])
def test_a_point_takes_at_most_20_bytes(tmp_path, monkeypatch, normals):
    small_pages(monkeypatch, page=1 << 11, chunk=1 << 15)
    random = np.random.default_rng(0)
    x, y = random.random((2, 40_000)) * 200
    position = np.stack([x, y, np.sin(x / 5)], axis=1) + FAR
    write_las(tmp_path / "a.las", position, random.integers(65536, size=(40_000, 3)).astype("u2"))
    made = built([tmp_path / "a.las"], tmp_path / "a.psh", normals=normals)
    assert made.nbytes <= 20 * made.points  # measured 13.8 and 16.4 bytes a point
