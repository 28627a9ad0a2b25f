"""Hierarchies on disk that are built from scans: what they hold, and that however a build goes they are the same."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.material.color_models import linear_from_srgb
from pointsplat_addon.formats.hierarchies.building import build as building
from pointsplat_addon.formats.hierarchies.building import files as building_files
from pointsplat_addon.formats.hierarchies.building import inputs, nodes
from pointsplat_addon.formats.hierarchies.building.workers import Alone
from pointsplat_addon.formats.hierarchies.pages import Layout
from pointsplat_addon.formats.hierarchies.psh import PshPages
from pointsplat_addon.formats.points.reader import PointFileError
from tests.support.scan_files import write_ply
from tests.support.scans import FAR, built, coverage, cut, leaves, small_pages, write_las

pytest.importorskip("laspy", reason="it comes with the extension")


PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def hills(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3), whole millimetres far from zero, of a hilly surface of 100 by 80, and colours (N, 3) uint16."""
    random = np.random.default_rng(seed)
    x, y = random.random((2, count)) * [[100.0], [80.0]]
    z = 5 * np.sin(x / 10) * np.cos(y / 8)
    position = np.round(np.stack([x, y, z], axis=1) + FAR, 3)
    return position, (np.stack([x, y, 50 + z], axis=1) * 2).astype(np.uint16) * np.uint16(257)


def two_tiles(folder: Path) -> tuple[list[Path], np.ndarray, np.ndarray]:
    """Two files that overlap, and all their points."""
    parts = [hills(5000), hills(3000, 1)]
    files = [folder / f"tile{i}.laz" for i in range(2)]
    for file, first, (position, color) in zip(files, (0, 5000), parts, strict=True):
        number = first + np.arange(len(position))
        write_las(file, position, color, intensity=number, classification=position[:, 0] > FAR[0] + 50)
    return files, np.concatenate([p for p, _ in parts]), np.concatenate([c for _, c in parts])


def points_of(pages: PshPages) -> dict[str, np.ndarray]:
    """All points, as the leaves hold them; positions float64."""
    parts = [pages.read(int(page)) for page in leaves(pages)]
    found = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    found["position"] = found["position"].astype(np.float64) + pages.directory.origin
    return found


def test_leaves_hold_all_points(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    files, position, color = two_tiles(tmp_path)
    made = built(files, tmp_path / "a.psh", attributes=("intensity", "classification"))
    with PshPages(tmp_path / "a.psh") as pages:
        found = points_of(pages)
        assert made.points == pages.directory.points == len(found["position"]) == 8000
        assert pages.directory.count[leaves(pages)].max() <= 256
        order = np.argsort(found["intensity"])  # the points' numbers
        assert (found["intensity"][order] == np.arange(8000)).all()
        # Half a step of 16 bits of a page of 25 units, and of float32 50 units from the origin.
        assert np.abs(found["position"][order] - position).max() < 3e-4  # measured 1.9e-4
        np.testing.assert_allclose(found["color"][order], linear_from_srgb(color / 65535), atol=1e-6)
        assert (found["classification"][order] == (position[:, 0] > FAR[0] + 50)).all()


def test_pages_make_an_octree_of_what_they_bound(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    files, position, _ = two_tiles(tmp_path)
    built(files, tmp_path / "a.psh")
    with PshPages(tmp_path / "a.psh") as pages:
        given = pages.directory
        np.testing.assert_allclose(
            given.bounds[0] + given.origin, [position.min(axis=0), position.max(axis=0)], atol=1e-6
        )
        above = given.parent[1:]
        assert (given.bounds[1:, 0] >= given.bounds[above, 0]).all()
        assert (given.bounds[1:, 1] <= given.bounds[above, 1]).all()
        assert given.cube is not None
        assert (given.cube[1:, 3] <= given.cube[above, 3] / 2).all()
        inner = np.setdiff1d(np.arange(len(given)), leaves(pages))
        assert (given.count[inner] <= 256).all()
        assert (given.spacing[above] > given.spacing[1:]).mean() > 0.9
        for page in range(len(given)):
            held = pages.read(page)["position"]
            low, high = given.bounds[page]
            assert len(held) == given.count[page]
            assert (held >= low - 1e-4).all()
            assert (held <= high + 1e-4).all()


@pytest.mark.parametrize(("shape", "most"), [("plane", 0.03), ("grid", 0.06), ("sphere", 0.12), ("clumps", 0.16)])
def test_each_level_covers_as_much_as_the_points(tmp_path, monkeypatch, shape, most):
    """As balls of half their spacing. Relative errors measured: 0.022, 0.048, 0.101, 0.138."""
    small_pages(monkeypatch)
    random = np.random.default_rng(1)
    position = {
        "plane": lambda: random.random((4000, 3)) * [100, 100, 0],
        "grid": lambda: np.argwhere(np.ones((63, 63, 1))) * 1.6 + random.normal(scale=0.16, size=(3969, 3)),
        "sphere": lambda: 50 * (v := random.normal(size=(4000, 3))) / np.linalg.norm(v, axis=1, keepdims=True),
        "clumps": lambda: (20 * random.normal(size=(40, 1, 3)) + random.normal(size=(40, 100, 3))).reshape(-1, 3),
    }[shape]()
    write_las(tmp_path / "a.las", position, np.full((len(position), 3), 30000, np.uint16))
    built([tmp_path / "a.las"], tmp_path / "a.psh")
    samples = random.random((10_000, 2))
    with PshPages(tmp_path / "a.psh") as pages:
        levels = range(int(pages.directory.level.max()), -1, -1)
        share = [coverage(pages, cut(pages, level), 2, samples) for level in levels]
        assert len(share) > 2
        np.testing.assert_allclose(share[1:], share[0], rtol=most)


def test_each_level_has_the_mean_of_the_colours_and_of_the_attributes(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    files, _, _ = two_tiles(tmp_path)
    built(files, tmp_path / "a.psh", attributes=("intensity",))
    with PshPages(tmp_path / "a.psh") as pages:

        def means(level: int) -> np.ndarray:
            """By the areas of the balls, as far as what is covered tells them."""
            total, sums = 0.0, np.zeros(4)
            for page in cut(pages, level):
                found = pages.read(page)
                if "radii" in found:
                    depth = -np.log(np.clip(1 - found["covered"], 1 / 512, 1))
                    area = (np.sqrt(1 + 5 * depth) - 1) / 2.5 * found["radii"][:, 0] * found["radii"][:, 1]
                else:
                    area = np.full(len(found["position"]), (pages.directory.spacing[page] / 2) ** 2)
                total += area.sum()
                sums += area @ np.column_stack([found["color"], found["intensity"] / 8000])
            return sums / total

        levels = range(int(pages.directory.level.max()), -1, -1)
        truth, *others = (means(level) for level in levels)
        np.testing.assert_allclose(others, np.tile(truth, (len(others), 1)), rtol=0.035)  # measured 0.025


def test_merging_keeps_sums():
    random = np.random.default_rng(0)
    layout = Layout(color=True, normal=True, attributes=(("intensity", "<u2"),))
    position = random.random((3, 5000)) * 100 + np.array(FAR)[:, None]
    columns = {
        "color": random.integers(256, size=(5000, 3), dtype=np.uint8),
        "normal": random.normal(size=(5000, 3)),
        "intensity": random.integers(60000, size=5000),
    }
    points = nodes.elements_of_points(layout, position, columns, 0.5)
    merged, edge = nodes.merged(points, np.array(FAR), 100.0)
    again, wider = nodes.merged(merged, np.array(FAR), 100.0)
    assert wider >= 2 * edge

    def sums(rows: np.ndarray) -> np.ndarray:
        """Weight, weighted means, and the second moments about the mean of all."""
        mean = rows[1:] @ rows[0] / rows[0].sum()
        away = rows[1:4] - mean[:3, None]
        second = [rows[0] @ (rows[4 + k] + away[i] * away[j]) for k, (i, j) in enumerate(PAIRS)]
        return np.array([rows[0].sum(), *mean[:3], *mean[9:], *second])

    for some in (merged, again):
        assert some.rows.shape[1] < 0.35 * points.rows.shape[1]
        np.testing.assert_allclose(sums(some.rows), sums(points.rows), rtol=1e-9)


def test_normals_are_those_of_the_surface_across_chunks(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    position, _ = hills(6000)
    write_las(tmp_path / "a.las", position)
    built([tmp_path / "a.las"], tmp_path / "a.psh", normals=True)
    with PshPages(tmp_path / "a.psh") as pages:
        found = points_of(pages)
        x, y = found["position"][:, :2].T - np.array(FAR)[:2, None]
        truth = np.stack(
            [-0.5 * np.cos(x / 10) * np.cos(y / 8), 0.625 * np.sin(x / 10) * np.sin(y / 8), np.ones(len(x))]
        )
        truth /= np.linalg.norm(truth, axis=0)
        away = np.degrees(np.arccos(np.clip((found["normal"].T * truth).sum(axis=0), -1, 1)))
        assert np.median(away) < 1.5  # measured 1.06; the codes alone take 0.34
        assert np.percentile(away, 99) < 6  # measured 4.4
        inner = np.setdiff1d(np.arange(len(pages.directory)), leaves(pages))
        for page in inner:
            nodes = pages.read(int(page))
            assert (nodes["normal"][:, 2] > 0).all()
            assert (nodes["coherence"] > 0.5).all()


class Stopping(Alone):
    """Does so many steps, and is interrupted after the next one, before its result is known."""

    left = 0

    def run(self, works):
        for work, said in zip(works, super().run(works), strict=True):
            if Stopping.left == 0:
                raise KeyboardInterrupt
            Stopping.left -= 1
            yield said
            del work


def test_builds_that_are_stopped_go_on_to_the_same_bytes(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    files, _, _ = two_tiles(tmp_path)
    built(files, tmp_path / "whole.psh", normals=True)
    truth = (tmp_path / "whole.psh").read_bytes()
    monkeypatch.setattr(building, "workers_of", lambda count, scheduler: Stopping())
    output, tries = tmp_path / "a.psh", 0
    for tries in range(1, 100):
        Stopping.left = tries  # with those that are there already
        try:
            built(files, output, normals=True)
            break
        except KeyboardInterrupt:
            assert not output.exists()
    assert tries > 3
    assert output.read_bytes() == truth
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.psh", "tile0.laz", "tile1.laz", "whole.psh"]


def test_what_is_left_of_a_folder_that_was_being_deleted_is_not_taken(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    files, _, _ = two_tiles(tmp_path)

    def stopped(folder):
        (folder / "chunk-0.pages").unlink()
        raise KeyboardInterrupt

    monkeypatch.setattr(building.shutil, "rmtree", stopped)
    with pytest.raises(KeyboardInterrupt):
        built(files, tmp_path / "a.psh")
    truth = (tmp_path / "a.psh").read_bytes()
    monkeypatch.undo()
    small_pages(monkeypatch)
    built(files, tmp_path / "a.psh")
    assert (tmp_path / "a.psh").read_bytes() == truth
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.psh", "tile0.laz", "tile1.laz"]


def test_processes_build_the_same_bytes(tmp_path):
    files, _, _ = two_tiles(tmp_path)
    for workers in (1, 2):
        built(files, tmp_path / f"{workers}.psh", workers=workers)
    assert (tmp_path / "1.psh").read_bytes() == (tmp_path / "2.psh").read_bytes()


def test_workers_of_dask_build_the_same_bytes(tmp_path):
    distributed = pytest.importorskip("distributed", reason="Dask is optional")
    files, _, _ = two_tiles(tmp_path)
    built(files, tmp_path / "alone.psh", normals=True)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        built(files, tmp_path / "dask.psh", normals=True, scheduler=cluster.scheduler_address)
        content = bytearray(files[1].read_bytes())
        content[-3000:] = bytes(3000)
        (tmp_path / "broken.laz").write_bytes(content)
        with pytest.raises(PointFileError, match=r"^broken\.laz: "):
            built([tmp_path / "broken.laz"], tmp_path / "b.psh", scheduler=cluster.scheduler_address)
    assert (tmp_path / "alone.psh").read_bytes() == (tmp_path / "dask.psh").read_bytes()


def test_a_damaged_input_is_told_by_processes_too(tmp_path):
    files, _, _ = two_tiles(tmp_path)
    content = bytearray(files[1].read_bytes())
    content[-3000:] = bytes(3000)
    files[1].write_bytes(content)
    with pytest.raises(PointFileError, match=r"^tile1\.laz: "):
        built(files, tmp_path / "a.psh", workers=2)
    assert not (tmp_path / "a.psh").exists()


def test_a_full_disk_leaves_no_file_and_the_build_goes_on_afterwards(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    files, _, _ = two_tiles(tmp_path)
    built(files, tmp_path / "whole.psh")
    replace, room = os.replace, [0]

    def full(source, target):
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(building_files.os, "replace", full)
    for files_that_fit in (0, 2, 7, 12):
        room[0] = files_that_fit
        with pytest.raises(OSError, match="No space left"):
            built(files, tmp_path / "a.psh")
        assert not (tmp_path / "a.psh").exists()
        assert not list(tmp_path.rglob("*.part")), "what was half written is gone"
    room[0] = 1000
    built(files, tmp_path / "a.psh")
    assert (tmp_path / "a.psh").read_bytes() == (tmp_path / "whole.psh").read_bytes()


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    files, _, _ = two_tiles(tmp_path)
    (tmp_path / "not_a_folder").touch()
    with pytest.raises(OSError, match="not_a_folder"):
        built(files, tmp_path / "not_a_folder" / "a.psh")
    (tmp_path / "a.psh.building").mkdir()
    (tmp_path / "a.psh.building" / "mine.txt").touch()
    with pytest.raises(FileExistsError, match="no build has made it"):
        built(files, tmp_path / "a.psh")
    assert (tmp_path / "a.psh.building" / "mine.txt").exists()


@pytest.mark.parametrize("moment", ["before", "while"])
def test_a_file_that_changes_is_refused(tmp_path, monkeypatch, moment):
    files, _, _ = two_tiles(tmp_path)
    measured = inputs.Input.has_changed
    seen = []

    def changed(one):
        seen.append(one)
        if len(seen) == (1 if moment == "before" else 2):
            os.utime(one.path, ns=(5, 5))
        return measured(one)

    monkeypatch.setattr(inputs.Input, "has_changed", changed)
    with pytest.raises(PointFileError, match=r"^tile0\.laz: .*change"):
        built(files, tmp_path / "a.psh")
    assert not (tmp_path / "a.psh").exists()


def test_other_inputs_begin_another_build(tmp_path, monkeypatch):
    files, _, _ = two_tiles(tmp_path)
    monkeypatch.setattr(building, "workers_of", lambda count, scheduler: Stopping())
    Stopping.left = 1
    with pytest.raises(KeyboardInterrupt):
        built(files, tmp_path / "a.psh")
    monkeypatch.undo()
    assert built(files[:1], tmp_path / "a.psh").points == 5000


def test_reference_systems_that_differ_are_told(tmp_path):
    position, color = hills(100)
    for name, crs in (("a", 2154), ("b", 2154), ("c", 3005)):
        write_las(tmp_path / f"{name}.las", position, color, crs)
    made = built(sorted(tmp_path.glob("*.las")), tmp_path / "a.psh")
    [warning] = made.warnings
    assert "EPSG:2154: a.las, b.las; EPSG:3005: c.las" in warning
    with PshPages(tmp_path / "a.psh") as pages:
        assert pages.directory.crs == "EPSG:2154"
    assert built([tmp_path / "a.las", tmp_path / "b.las"], tmp_path / "b.psh").warnings == []


def test_many_small_files_are_read_together_and_closed(tmp_path, monkeypatch):
    position, color = hills(600)
    for i in range(200):
        write_las(tmp_path / f"{i:03}.las", position[3 * i : 3 * i + 3], color[3 * i : 3 * i + 3])
    files = sorted(tmp_path.glob("*.las"))
    open_at_once = []
    opened = inputs.open_single

    def counted(path, threads):
        open_at_once.append(len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0)
        return opened(path, threads)

    monkeypatch.setattr(inputs, "open_single", counted)
    assert len(inputs.tasks_of([inputs.input_of(file) for file in files])) == 1
    assert built(files, tmp_path / "a.psh").points == 600
    assert max(open_at_once) - min(open_at_once) < 10


def test_headers_that_know_no_bounds_or_wrong_ones(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    position, color = hills(3000)
    write_las(tmp_path / "a.las", position, color)
    built([tmp_path / "a.las"], tmp_path / "a.psh")
    wrong = bytearray((tmp_path / "a.las").read_bytes())
    wrong[179:227] = np.array([FAR[0] + 1, FAR[0], FAR[1] + 1, FAR[1], 1.0, 0.0]).tobytes()  # high and low of each axis
    (tmp_path / "wrong.las").write_bytes(wrong)
    made = built([tmp_path / "wrong.las"], tmp_path / "wrong.psh")
    assert "lie outside of the bounds" in made.warnings[0]
    record = np.zeros(3000, [(n, "f8") for n in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")])
    for name, column in zip(record.dtype.names or (), [*position.T, *(color.T >> 8)], strict=True):
        record[name] = column
    write_ply(tmp_path / "a.ply", record, "binary_little_endian")
    built([tmp_path / "a.ply"], tmp_path / "ply.psh")
    for name in ("wrong.psh", "ply.psh"):
        with PshPages(tmp_path / "a.psh") as one, PshPages(tmp_path / name) as other:
            assert len(one.directory) == len(other.directory)
            np.testing.assert_allclose(one.directory.bounds, other.directory.bounds, atol=1e-6)
            for mine, theirs in zip(points_of(one).values(), points_of(other).values(), strict=True):
                np.testing.assert_allclose(np.sort(mine, axis=0), np.sort(theirs, axis=0), atol=1e-3)


def test_points_that_are_crowded_are_sorted_by_finer_cells(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    monkeypatch.setattr(building, "CHUNK", 3000)
    random = np.random.default_rng(0)
    position = np.concatenate([random.random((8000, 3)) * 0.5, [[20_000.0, 0, 0]]])
    write_las(tmp_path / "a.las", position)
    built([tmp_path / "a.las"], tmp_path / "a.psh")
    with PshPages(tmp_path / "a.psh") as pages:
        assert pages.directory.points == 8001
        assert pages.directory.count.max() <= 256


def test_points_that_are_not_finite_are_left_out_and_no_points_are_refused(tmp_path):
    record = np.zeros(10, [(n, "f8") for n in "xyz"])
    record["x"] = np.arange(10)
    record["y"][3] = np.nan
    write_ply(tmp_path / "a.ply", record, "binary_little_endian")
    made = built([tmp_path / "a.ply"], tmp_path / "a.psh")
    assert (made.points, made.dropped) == (9, 1)
    write_ply(tmp_path / "empty.ply", record[:0], "binary_little_endian")
    with pytest.raises(PointFileError, match="has no points"):
        built([tmp_path / "empty.ply"], tmp_path / "empty.psh")


def test_colours_of_8_bits_in_fields_of_16(tmp_path):
    position, color = hills(900)
    bright = color.copy()
    bright[:300] = bright[:300] % 2  # next to black, in a file that has 16 bits
    for name, values in (("a", color >> 8), ("b", color // 257 * 256), ("c", bright)):
        write_las(tmp_path / f"{name}.las", position, values)
        built([tmp_path / f"{name}.las"], tmp_path / f"{name}.psh")
    truth = np.sort(linear_from_srgb((color >> 8) / 255.0), axis=0)
    for name in ("a", "b"):
        with PshPages(tmp_path / f"{name}.psh") as pages:
            np.testing.assert_allclose(np.sort(points_of(pages)["color"], axis=0), truth, atol=1e-6)
    with PshPages(tmp_path / "c.psh") as pages:
        assert (points_of(pages)["color"] == 0).all(axis=1).sum() >= 300


def test_points_at_one_position(tmp_path, monkeypatch):
    small_pages(monkeypatch)
    write_las(tmp_path / "a.las", np.tile([[1.0, 2.0, 3.0]], (1000, 1)))
    built([tmp_path / "a.las"], tmp_path / "a.psh")
    with PshPages(tmp_path / "a.psh") as pages:
        assert pages.directory.points == 1000
        np.testing.assert_array_equal(points_of(pages)["position"], np.tile([1.0, 2.0, 3.0], (1000, 1)))


def test_memory_that_is_too_small_is_told(tmp_path):
    files, _, _ = two_tiles(tmp_path)
    with pytest.raises(ValueError, match="MB of memory"):
        built(files, tmp_path / "a.psh", memory=1 << 20)
