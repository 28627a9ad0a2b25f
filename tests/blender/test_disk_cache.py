"""Hierarchies on disk among several processes: one makes each, and nobody's picture tells who did."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.core.lod.hierarchy import Hierarchy
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.surface.neighbourhoods.estimate import Ellipses, estimate_ellipses
from pointsplat_addon.host import disk_cache
from pointsplat_addon.host.convert import point_shapes, pointcloud
from pointsplat_addon.host.convert.point_shapes import PointShape
from pointsplat_addon.host.convert.sample_material import sample_material
from pointsplat_addon.render.cache import on_disk
from scripts.common.point_objects import point_cloud_object

ROOT = Path(__file__).resolve().parents[2]

# Says how many hierarchies it had to build.
READS = """
import os, sys, time
from pathlib import Path
import numpy as np
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.host import disk_cache
made, build = [], disk_cache.build

def slowly(points):
    made.append(points)
    time.sleep(1)
    return build(points)

disk_cache.MIN_POINTS, disk_cache.build = 100, slowly
disk_cache.build_or_read(Path(sys.argv[1]), PointCloud(np.random.default_rng(5).random((3000, 3), np.float32)))
print(len(made), flush=True)
os._exit(0)
"""


def cloud() -> PointCloud:
    rng = np.random.default_rng(5)
    position = rng.random((3000, 3), np.float32)
    return PointCloud(position, radii=rng.uniform(0.01, 0.02, (3000, 1)).astype(np.float32))


def bits(found: Hierarchy) -> list[bytes]:
    arrays = [getattr(found, f.name) for f in fields(found) if f.name not in ("cloud", "tree")]
    arrays += [getattr(found.tree, f.name) for f in fields(found.tree)] + list(found.cloud.arrays().values())
    return [array.tobytes() for array in arrays if array is not None]


def test_what_is_built_is_what_is_read_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_cache, "MIN_POINTS", 100)
    built, read = (disk_cache.build_or_read(tmp_path, cloud()) for _ in range(2))
    (tmp_path / "file").write_text("no folder")
    assert bits(built) == bits(read)
    assert bits(disk_cache.build_or_read(None, cloud())) == bits(read)
    assert bits(disk_cache.build_or_read(tmp_path / "file", cloud())) == bits(read)


def test_of_several_processes_one_builds_a_hierarchy(tmp_path: Path) -> None:
    command = [sys.executable, "-c", READS, str(tmp_path)]
    processes = [subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert sum(int(process.communicate(timeout=120)[0].split()[-1]) for process in processes) == 1
    assert len(list(tmp_path.glob("*.pshier"))) == 1
    assert not list(tmp_path.glob("*.tmp"))


def test_surfaces_of_scans_are_kept_and_read_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    position = np.column_stack([rng.random((2000, 2)), np.zeros(2000)]).astype(np.float32)
    data = point_cloud_object("scan", position, 0.01).data
    material = sample_material(default_materials(), 0, 0.0)
    calls: list[int] = []

    def counted(places: np.ndarray) -> Ellipses:
        calls.append(len(places))
        return estimate_ellipses(places)

    monkeypatch.setattr(point_shapes, "estimate_ellipses", counted)
    monkeypatch.setattr(on_disk, "_pays", lambda took, size: True)

    def read(folder: Path | None) -> list[bytes]:
        monkeypatch.setattr(pointcloud.STORE, "on_disk", on_disk.OnDisk(folder, lambda: None, True))
        found = pointcloud.read_pointcloud(data, material, lambda key, make: make(), PointShape("SURFACE"))
        assert found is not None
        return [array.tobytes() for array in found[1].arrays().values()]

    expected = read(None)
    assert read(tmp_path) == read(tmp_path) == expected
    assert len(calls) == 2
    data.attributes["position"].data[0].vector = (0.5, 0.5, 0.1)
    assert read(tmp_path) != expected
    assert len(calls) == 3
