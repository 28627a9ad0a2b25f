"""Pictures of scans that are read by pages, beside those of the same points in memory."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Geometry, PointSize, Scene, StreamedScan
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.cache.keys import streamed_names
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.frame import frame as frame_module
from pointsplat_addon.render.frame.visibility.tiles import cells_of_tile
from pointsplat_addon.render.plan.request import Request, Result
from pointsplat_addon.render.prepare import streamed as streamed_pages
from pointsplat_addon.render.prepare.streamed import with_pages
from pointsplat_addon.stream.need import needed_pages
from pointsplat_addon.stream.pool import POOL, PagePool
from pointsplat_addon.stream.tree import PageTree
from scripts.scenes import build, cameras
from scripts.scenes.drawing import opengl
from tests.support.octrees import MemoryPages, PlainLook, scan_in_memory

COUNT, MOST, RADIUS = 20_000, 300, 0.006
CAMERA = cameras.camera(eye=(0.5, -1.0, 1.2), target=(0.5, 0.5, 0.3), resolution=(96, 64))
SETTINGS = Settings(technique="VISIBILITY", tolerance=0.05)
SIZE = PointSize(RADIUS)
FINE, COARSE = 0.05, 1.5  # pixels of tolerance


@pytest.fixture(autouse=True)
def empty_pool():
    POOL.clear()
    yield
    POOL.clear()


def hills(count: int = COUNT) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(7)
    place = random.uniform(0.01, 0.99, (count, 2))
    height = 0.3 + 0.1 * np.sin(9 * place[:, 0]) * np.cos(7 * place[:, 1])
    color = np.stack([place[:, 0], place[:, 1], 1 - place[:, 0]], axis=1)
    return np.column_stack([place, height]).astype(np.float32), color.astype(np.float32)


def paged(path: Path, size: PointSize = SIZE, **more) -> tuple[MemoryPages, Scene]:
    position, color = hills()
    source = MemoryPages(position, MOST, 0.06)
    source.columns["color"] = color
    streamed = StreamedScan(scan_in_memory(source, path / "scan"), PlainLook(), size, **more)
    return source, scene_of(Geometry(f"paged {path}", "Paged", streamed=streamed))


def in_memory() -> Scene:
    position, color = hills()
    cloud = PointCloud(position, color=color, radii=np.full((COUNT, 1), RADIUS, np.float32))
    return scene_of(Geometry("in memory", "In memory", cloud=cloud))


def scene_of(geometry: Geometry) -> Scene:
    return build.scene((geometry, np.eye(4)), world=World(np.full(3, 0.2)))


def render(scene: Scene, tolerance: float = FINE, **settings) -> Result:
    request = Request(CAMERA, replace(SETTINGS, tolerance=tolerance, **settings), frozenset({"combined"}), 17)
    return opengl().render(scene, request)


def test_all_pages_show_what_the_same_points_in_memory_do(tmp_path: Path) -> None:
    source, scene = paged(tmp_path)
    found, expected = render(scene), render(in_memory())
    difference = np.abs(found.pixels["combined"] - expected.pixels["combined"])
    # Points lie in another order, which decides between equal depths: worst measured 0.0.

    assert difference.max() == 0
    assert found.report["streamed"] == {
        "needed_pages": len(source.directory), "drawn_pages": len(source.directory), "points": COUNT,
        "pages": len(source.directory), "bytes": int(source.directory.nbytes.sum()),
    }  # fmt: skip
    assert "streamed" not in expected.report


@pytest.mark.parametrize("tolerance", [FINE, COARSE])
def test_a_final_picture_has_small_tiles_and_is_the_same_in_one(tmp_path: Path, monkeypatch, tolerance: float) -> None:
    """Small ones take less memory beside what is drawn, of which each draws what it shows."""
    _, scene = paged(tmp_path)
    asked: list[tuple[bool, bool]] = []

    def in_tiles(cells: int):
        def made(primitives: int, shown: bool, streamed: bool) -> int:
            asked.append((shown, streamed))
            return cells

        return made

    monkeypatch.setattr(frame_module, "cells_of_tile", in_tiles(1 << 14))
    divided = render(scene, tolerance, use_shadows=False).pixels["combined"]
    monkeypatch.setattr(frame_module, "cells_of_tile", in_tiles(1 << 22))
    whole = render(scene, tolerance, use_shadows=False).pixels["combined"]
    assert asked == [(False, True)] * 2
    few, shown, many = (cells_of_tile(10_000_000, *asked) for asked in ((False, True), (True, True), (False, False)))
    assert few < shown < many
    assert np.abs(divided - whole).max() < 1e-3  # measured 5.7e-4, at rims of balls, whose normals rounding turns


def test_sub_samples_are_let_go_before_passes_are_read(tmp_path: Path, monkeypatch) -> None:
    """Passes are copied several times until they are in a file, beside pages, which stay. Bytes of each sub-sample."""
    _, scene = paged(tmp_path)
    held: dict[str, int] = {}

    def noting(name: str):
        call = getattr(frame_module.Frame, name)

        def noted(self):
            held[name] = self.device.bytes_allocated()
            return call(self)

        monkeypatch.setattr(frame_module.Frame, name, noted)

    noting("keep_shown")
    noting("pixels")
    render(scene, FINE, use_shadows=False)
    width, height = CAMERA.window[2:]
    assert held["keep_shown"] - held["pixels"] >= 16 * 17 * width * height  # of sub-samples; measured 39


@pytest.mark.parametrize("tolerance", [1.2, COARSE, 4.0])
def test_a_picture_reads_the_pages_that_its_tolerance_needs_and_no_others(tmp_path: Path, tolerance: float) -> None:
    source, scene = paged(tmp_path)
    report = render(scene, tolerance).report["streamed"]
    wider = replace(CAMERA, region=(-1, -1, 98, 66))  # what the pixel filter takes in
    need = needed_pages(PageTree(source.directory), CAMERA.view_from_world[None], CAMERA, tolerance)
    more = needed_pages(PageTree(source.directory), CAMERA.view_from_world[None], wider, tolerance)
    assert set(need.pages.tolist()) <= set(source.read_pages) <= set(more.pages.tolist())
    assert len(source.read_pages) == len(set(source.read_pages)) == report["pages"] == report["needed_pages"]
    assert 0 < len(source.read_pages) < len(source.directory)
    again = render(scene, tolerance).report["streamed"]
    assert (again["pages"], again["bytes"]) == (0, 0)
    assert again["drawn_pages"] == report["drawn_pages"]


def test_coarse_pages_cover_as_much_as_all_points(tmp_path: Path) -> None:
    _, scene = paged(tmp_path, PointSize())
    fine, coarse = (render(scene, tolerance, use_shadows=False).pixels["combined"] for tolerance in (FINE, COARSE))
    assert np.abs(fine - coarse)[..., :3].mean() < 0.05


def wall_and_ground() -> tuple[np.ndarray, np.ndarray]:
    """A ground and, out of view of TOP, a wall that a sun from the right has shade it; and what is the wall."""
    random = np.random.default_rng(8)
    ground = random.uniform(0.01, 0.99, (30_000, 3)) * [1, 1, 0] + [0, 0, 0.05]
    wall = random.uniform(0, 1, (10_000, 3)) * [0, 0.5, 0.6] + [0.9, 0.25, 0.06]
    return np.concatenate([ground, wall]).astype(np.float32), np.arange(40_000) >= 30_000


TOP = cameras.camera(eye=(0.35, 0.499, 3.0), target=(0.35, 0.5, 0.0), resolution=(48, 48), parallel=0.6)


def test_pages_out_of_view_cast_shadows_into_it(tmp_path: Path) -> None:
    position, of_wall = wall_and_ground()
    source = MemoryPages(position, MOST, 0.06)
    streamed = StreamedScan(scan_in_memory(source, tmp_path / "scan"), PlainLook(), PointSize(0.008))
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-1.0, 0.0, -1.0]) / np.sqrt(2))

    def picture(geometry: Geometry) -> tuple[np.ndarray, dict]:
        scene = replace(scene_of(geometry), lights=(sun,))
        request = Request(TOP, SETTINGS, frozenset({"combined"}), 17)
        result = opengl().render(scene, request)
        return result.pixels["combined"][..., :3].astype(float), result.report

    def cloud(which: np.ndarray) -> Geometry:
        radii = np.full((which.sum(), 1), 0.008, np.float32)
        return Geometry(f"cloud {which.sum()}", "Cloud", cloud=PointCloud(position[which], radii=radii))

    truth, _ = picture(cloud(np.ones(len(position), bool)))
    without, _ = picture(cloud(~of_wall))
    assert np.abs(truth - without).mean() > 0.2 * without.mean()
    found, report = picture(Geometry(f"paged {tmp_path}", "Paged", streamed=streamed))
    # The map of shadows has other bounds. Measured: 1.0e-4 of what the wall changes.
    assert np.abs(found - truth).mean() < 3e-4 * np.abs(truth - without).mean()
    assert report["streamed"]["pages"] < len(source.directory)


def test_what_the_budget_does_not_hold_is_drawn_more_coarsely_and_said(tmp_path: Path) -> None:
    source, scene = paged(tmp_path)
    for columns in range(40):  # so that the least budget holds a part of the pages
        source.columns[f"more {columns}"] = np.zeros(COUNT, np.float32)
    scene = replace(scene, geometries=(replace(scene.geometries[0], key=f"budget {tmp_path}"),))
    POOL.clear()
    report = render(scene, FINE, memory_budget=0.2).report
    assert report["streamed"]["drawn_pages"] < report["streamed"]["needed_pages"]
    assert any("memory budget" in warning for warning in report["warnings"])
    assert POOL.nbytes <= 0.2 * (1 << 20)


def test_a_damaged_page_is_drawn_by_its_parent_and_said_once(tmp_path: Path) -> None:
    source, scene = paged(tmp_path)
    source.damaged = {5}
    report = render(scene).report
    assert sum("pages cannot be read" in warning for warning in report["warnings"]) == 1
    assert report["streamed"]["drawn_pages"] < len(source.directory)


def test_a_missing_file_is_shown_by_what_stands_in(tmp_path: Path) -> None:
    position, color = hills(500)
    stand_in = PointCloud(position, color=color, radii=np.full((500, 1), RADIUS, np.float32))
    _, scene = paged(tmp_path, stand_in=stand_in)
    (tmp_path / "scan").unlink()
    result = render(scene)
    assert any("is missing" in warning for warning in result.report["warnings"])
    assert result.report["points"]["cut"] == 500


def test_clip_boxes_cut_pages_as_they_cut_points_in_memory(tmp_path: Path) -> None:
    box = np.diag([4.0, 4.0, 1.0, 1.0])[None] + np.array([[0, 0, 0, -2], [0, 0, 0, -2], [0, 0, 0, 0], [0, 0, 0, 0]])
    _, scene = paged(tmp_path, box_from_object=box)
    found = render(scene)
    position, color = hills()
    kept = (np.abs(position[:, :2] * 4 - 2) <= 1).all(axis=1)
    cloud = PointCloud(position[kept], color=color[kept], radii=np.full((kept.sum(), 1), RADIUS, np.float32))
    expected = render(scene_of(Geometry("clipped", "Clipped", cloud=cloud)))
    assert found.report["streamed"]["points"] == int(kept.sum())
    assert np.abs(found.pixels["combined"] - expected.pixels["combined"]).max() <= 1e-6


def viewport_pictures(scene: Scene) -> list[int]:
    """How many points each picture of a view has, until nothing is waited for."""
    request = Request(CAMERA, SETTINGS, frozenset({"combined"}), 17, interactive=True)
    renderer, shown, waiting = opengl(), [], True
    while waiting:
        frame = renderer.start(scene, request)
        streamed = frame.frame_plan.streamed
        assert streamed is not None
        shown.append(streamed.points)
        waiting = streamed.waiting
        seen = streamed.arrivals
        frame.release()
        if waiting:
            POOL.wait(5.0, seen)
    return shown


def test_a_viewport_draws_what_is_there_and_then_the_rest(tmp_path: Path) -> None:
    source, scene = paged(tmp_path)
    source.seconds = 0.01
    shown = viewport_pictures(scene)
    assert shown[0] < shown[-1] == COUNT
    assert shown == sorted(shown)
    assert len(source.read_pages) == len(source.directory)


def test_pages_that_come_while_others_are_taken_are_drawn_next(tmp_path: Path, monkeypatch) -> None:
    source, scene = paged(tmp_path)
    source.seconds = 0.01
    taken = streamed_pages._shown

    def slowly(*given: Any) -> Any:
        found = taken(*given)
        while POOL.is_busy(streamed_pages.VIEWPORT):
            POOL.wait(5.0, POOL.arrivals)
        return found

    monkeypatch.setattr(streamed_pages, "_shown", slowly)
    shown = viewport_pictures(scene)
    assert shown[0] < shown[-1] == COUNT


def test_the_first_picture_of_a_viewport_is_not_empty(tmp_path: Path) -> None:
    source, scene = paged(tmp_path)
    source.seconds = 0.02
    request = Request(CAMERA, SETTINGS, frozenset({"combined"}), 17, interactive=True)
    frame = opengl().start(scene, request)
    assert frame.frame_plan.streamed is not None
    assert frame.frame_plan.streamed.points > 0
    frame.release()


def test_the_first_picture_of_a_viewport_waits_for_some_pages_but_not_long(tmp_path: Path, monkeypatch) -> None:
    request = Request(CAMERA, SETTINGS, frozenset({"combined"}), 17, interactive=True)
    drawn = {}
    for name, seconds, most in (("quick", 0.001, 60.0), ("slow", 0.2, streamed_pages.FIRST)):
        (tmp_path / name).mkdir()
        source, scene = paged(tmp_path / name)
        source.seconds = seconds
        monkeypatch.setattr(streamed_pages, "FIRST", most)
        frame = opengl().start(scene, request)
        assert frame.frame_plan.streamed is not None
        drawn[name] = frame.frame_plan.streamed.drawn
        frame.release()
        POOL.clear()
    assert 0 < drawn["slow"] < streamed_pages.ENOUGH <= drawn["quick"]


def test_a_coarse_picture_reads_and_draws_the_pages_of_the_fine_one(tmp_path: Path) -> None:
    _, scene = paged(tmp_path)
    settings = replace(SETTINGS, tolerance=COARSE)
    fine = Request(CAMERA, settings, frozenset({"combined"}), 5, interactive=True)
    halved = replace(fine, camera=CAMERA.with_coarser_pixels(2))
    found = []
    for request in (fine, replace(halved, pages_of=CAMERA), halved):
        while True:
            frame = opengl().start(scene, request)
            streamed = frame.frame_plan.streamed
            frame.release()
            assert streamed is not None
            if not streamed.waiting:
                break
        found.append((streamed.needed, streamed.drawn, streamed.points))
    assert found[0] == found[1] != found[2]


def test_of_what_a_kind_of_views_drew_of_scans_the_latest_is_kept(tmp_path: Path) -> None:
    _, scene = paged(tmp_path)
    renderer = opengl()
    drawn, seen = [], set()
    for interactive, tolerance in ((False, FINE), (False, COARSE), (True, FINE), (True, COARSE), (False, FINE)):
        settings = replace(SETTINGS, tolerance=tolerance)
        request = Request(CAMERA, settings, frozenset({"combined"}), 1, interactive=interactive)
        frame = renderer.start(scene, request)
        mine = {geometry.key for geometry in frame.frame_plan.scene.geometries if geometry.streamed is not None}
        frame.release()
        seen |= mine
        drawn = [one for one in drawn if one[0] != interactive] + [(interactive, mine)]
        stored, uploaded = renderer.store.keys(), renderer.kept.keys()
        of_pages = {name for key in stored for name in streamed_names(key) if str(tmp_path) in name}
        kept = {name for _, names in drawn for name in names}
        assert mine <= of_pages <= kept
        assert {name for key in uploaded for name in streamed_names(key)} == mine
    assert len(seen) >= 2


def test_a_view_that_moves_has_hard_coarse_shadows_of_what_it_shows(tmp_path: Path) -> None:
    position, _ = wall_and_ground()
    source = MemoryPages(position, MOST, 0.06)
    streamed = StreamedScan(scan_in_memory(source, tmp_path / "scan"), PlainLook(), PointSize(0.008))
    suns = tuple(Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-0.6, 0, -0.8]), radius=r) for r in (0.0047, 0.2))
    scene = replace(scene_of(Geometry(f"moving {tmp_path}", "Moving", streamed=streamed)), lights=suns)
    settings = replace(SETTINGS, tolerance=1.0, shadow_resolution=1024)
    found = []
    for moving in (False, True):
        request = Request(TOP, settings, frozenset({"combined"}), 5, interactive=True, moving=moving)
        frame = opengl().start(scene, request)
        plan = frame.frame_plan
        assert plan.streamed is not None
        found.append((plan.streamed.needed, plan.request.settings.shadow_resolution, plan.scene.lights[0].radius))
        assert plan.scene.lights[1].radius == 0.2
        frame.release()
    (still, *others), (moving, *those) = found
    assert moving < still
    assert (others, those) == ([1024, 0.0047], [256, 0.0])


def test_scenes_without_such_scans_start_no_threads_and_report_nothing() -> None:
    before = threading.active_count()
    pool = PagePool()
    scene = in_memory()
    again, streamed = with_pages(scene, CAMERA, SETTINGS, Store(), False, lambda: None, pool)
    assert again is scene
    assert streamed is None
    assert threading.active_count() == before


def test_a_picture_that_is_no_longer_wanted_stops_waiting(tmp_path: Path) -> None:
    source, scene = paged(tmp_path)
    source.seconds = 1.0
    asked = []

    def cancelled() -> bool:
        asked.append(True)
        return len(asked) > 3

    request = Request(CAMERA, SETTINGS, frozenset({"combined"}), 17)
    assert opengl().render(scene, request, cancelled=cancelled).cancelled
    source.seconds = 0.0
