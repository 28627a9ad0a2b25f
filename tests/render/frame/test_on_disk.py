"""Shadows and light that processes share on disk: pictures are the same to the bit whether these were read or made."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.cache import on_disk
from pointsplat_addon.render.cache.keys import Key, Kind
from pointsplat_addon.render.cache.on_disk import OnDisk, UnstableError, form_of_records, text_of
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.device.protocol import EMPTY
from pointsplat_addon.render.passes.shadow.kept_depths import as_numbers, kept
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl

ROOT = Path(__file__).resolve().parents[3]
DOWN = np.array([0.0, 0.0, -1.0])
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
COMBINED = frozenset({"combined", "depth"})
FIRST, SECOND = cameras.camera((0.3, -5.0, 2.5), far=50.0), cameras.camera((2.5, -4.0, 1.5), far=50.0)
FILES = 5  # of the scene: a table of each light, maps, and shares of light at both samples of the wide lamp


def case(lamp=(0.5, -0.5, 3.0), ball=(1.0, 0.0, 0.5), alpha: float = 0.5, resolution: int = 64, extinction=2.0) -> Case:
    """Smoke, an opaque ball and a pane over a floor, under a sun and a wide lamp."""
    table = build.materials(2, alpha=[1.0, alpha], translucent=np.array([False, True]))
    smoke = build.points(f"smoke of {extinction}", clouds.smoke_cloud(8, extinction))
    pane = build.mesh(replace(meshes.plane_mesh("pane on disk", 0.5), materials=(1,)), "POLYGONS")
    scene = build.scene(
        (build.mesh(meshes.plane_mesh("floor on disk", 3.0), "POLYGONS"), LAID),
        (build.mesh(meshes.sphere_mesh("ball on disk", 12), "POLYGONS"), build.moved(ball, 0.4)),
        (smoke, build.moved((-0.9, 0.2, 0.9), 0.6)),
        (pane, build.moved((0.2, -0.9, 1.2)) @ LAID),
        lights=(Light("POINT", np.full(3, 60.0), np.array(lamp), DOWN, radius=0.2), build.sun(2.0, (0.3, 0.2, -1.0))),
        table=table,
    )
    return Case(scene, FIRST, Settings(technique="VISIBILITY", shadow_resolution=resolution))


class Process:
    """A renderer that knows nothing, as that of another process, with a folder of what others have left."""

    def __init__(self, folder: Path | None, at_once: bool = True) -> None:
        self.store = Store()
        self.store.on_disk = OnDisk(folder, lambda: None, at_once)
        self.renderer = Renderer(opengl().device, self.store)

    def picture(self, of: Case, camera: Camera = FIRST) -> dict[str, np.ndarray]:
        try:
            # As many samples as give two lattices: the wide lamp is looked at from other points in each.
            return self.renderer.render(of.scene, Request(camera, of.settings, COMBINED, 34)).pixels
        finally:
            self.renderer.release()


@pytest.fixture(autouse=True)
def made(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What is made while there is a folder. Everything pays: scenes of tests are small."""
    found: list[object] = []
    make = on_disk._made

    def counted(making: Callable[[], object], form: on_disk.Form) -> tuple[object, float, int]:
        found.append(making)
        return make(making, form)

    monkeypatch.setattr(on_disk, "_made", counted)
    monkeypatch.setattr(on_disk, "_pays", lambda took, size: True)
    return found


def assert_same(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    differ = {key: int((found[key] != pixels).any(axis=-1).sum()) for key, pixels in expected.items()}
    assert all(pixels.tobytes() == found[key].tobytes() for key, pixels in expected.items()), differ


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.psitem"))


def test_pictures_are_the_same_whether_shadows_and_light_were_read_or_made(tmp_path: Path, made: list) -> None:
    expected = [Process(None).picture(case(), camera) for camera in (FIRST, SECOND)]
    assert not made
    assert_same(Process(tmp_path).picture(case()), expected[0])
    assert len(files(tmp_path)) == len(made) == FILES
    # Another camera finds all that this one's picture has left.
    assert_same(Process(tmp_path).picture(case(), SECOND), expected[1])
    assert_same(Process(tmp_path).picture(case()), expected[0])
    assert len(made) == FILES


@pytest.mark.parametrize(
    ("change", "anew"),
    [
        ({"lamp": (0.5, -0.4, 3.0)}, 4),  # its table, maps, and with these both shares
        ({"ball": (1.0, 0.1, 0.5)}, 3),  # maps and shares: tables do not hold it
        ({"alpha": 0.6}, 2),  # shares: lamps look at the faces of panes
        ({"extinction": 2.5}, 4),  # tables and shares
        ({"resolution": 32}, FILES),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else str(value),
)
def test_what_changes_pictures_is_made_anew(tmp_path: Path, made: list, change: dict, anew: int) -> None:
    Process(tmp_path).picture(case())
    made.clear()
    changed = case(**change)
    assert_same(Process(tmp_path).picture(changed), Process(None).picture(changed))
    assert len(made) == anew


def test_colours_of_lights_do_not_matter(tmp_path: Path, made: list) -> None:
    Process(tmp_path).picture(case())
    made.clear()
    of = case()
    lamp, sun = of.scene.lights
    bright = replace(of, scene=replace(of.scene, lights=(replace(lamp, color=2 * lamp.color), sun)))
    assert_same(Process(tmp_path).picture(bright), Process(None).picture(bright))
    assert not made


@pytest.mark.parametrize("damage", ["cut off", "a bit", "empty", "other version"])
def test_damaged_files_are_made_anew(tmp_path: Path, made: list, caplog: pytest.LogCaptureFixture, damage: str) -> None:
    expected = Process(tmp_path).picture(case())
    for path in files(tmp_path):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= damage == "a bit"
        content[8] ^= damage == "other version"
        end = {"cut off": len(content) - 5, "empty": 0}.get(damage, len(content))
        path.write_bytes(content[:end])
    made.clear()
    assert_same(Process(tmp_path).picture(case()), expected)
    assert len(made) == FILES
    assert len([text for text in caplog.messages if "cannot be used" in text]) >= FILES
    made.clear()
    assert_same(Process(tmp_path).picture(case()), expected)
    assert not made


def test_what_is_made_once_leaves_a_mark_alone(tmp_path: Path, made: list) -> None:
    """Else each frame of a film in which things move would leave files that nobody reads."""
    for left in (0, FILES, FILES):
        Process(tmp_path, at_once=False).picture(case())
        assert len(files(tmp_path)) == left
    assert len(made) == 2 * FILES
    assert len(list((tmp_path / on_disk.MARKS).iterdir())) == FILES


def test_marks_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_disk, "MARK_DIGITS", 1)
    kept_there = OnDisk(tmp_path, lambda: None)
    for number in range(200):
        assert kept_there.lookup(("item", number), lambda: (1,), form_of_records()) == (1,)
    assert len(list((tmp_path / on_disk.MARKS).iterdir())) == 16
    assert not files(tmp_path)


def test_what_does_not_pay_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_disk, "_pays", lambda took, size: False)
    Process(tmp_path).picture(case())
    assert not files(tmp_path)
    monkeypatch.undo()
    assert not on_disk._pays(0.1, 0)
    assert not on_disk._pays(1.0, 150_000_000)
    assert on_disk._pays(1.3, 150_000_000)


@pytest.mark.parametrize("why", ["no lights", "without shadows", "in a viewport"])
def test_who_needs_none_pays_nothing(tmp_path: Path, made: list, monkeypatch: pytest.MonkeyPatch, why: str) -> None:
    def never(*_: object) -> str:
        raise AssertionError("nothing is to be looked for")

    monkeypatch.setattr(on_disk, "arithmetic", never)
    of, process = case(), Process(tmp_path)
    if why == "in a viewport":
        process.renderer.start(of.scene, Request(FIRST, of.settings, COMBINED, 1, interactive=True)).release()
        process.renderer.release()
    elif why == "no lights":
        process.picture(replace(of, scene=replace(of.scene, lights=())))
    else:
        process.picture(replace(of, settings=replace(of.settings, use_shadows=False)))
    assert not list(tmp_path.iterdir())
    assert not made


def test_folders_that_cannot_be_written_change_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("no folder")
    for at_once in (True, False):
        assert_same(Process(tmp_path / "file", at_once).picture(case()), Process(None).picture(case()))
    assert any("Nothing can be kept" in text for text in caplog.messages)


# Says how often it had to make the item.
READS = """
import os, sys, time
from pathlib import Path
import numpy as np
from pointsplat_addon.render.cache.on_disk import OnDisk, form_of_records
made = []

def make():
    made.append(1)
    time.sleep(1.0)
    return {"values": np.arange(100_000)}

found = OnDisk(Path(sys.argv[1]), lambda: None, True).lookup(("item", 1), make, form_of_records())
assert (found["values"] == np.arange(100_000)).all()
print(len(made), flush=True)
os._exit(0)
"""


def test_of_several_processes_one_makes_an_item(tmp_path: Path) -> None:
    command = [sys.executable, "-c", READS, str(tmp_path)]
    processes = [subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert sum(int(process.communicate(timeout=120)[0]) for process in processes) == 1
    assert len(files(tmp_path)) == 1
    assert not list(tmp_path.glob("*.tmp"))


def test_a_process_that_is_killed_while_it_makes_an_item_leaves_it_to_others(tmp_path: Path) -> None:
    command = [sys.executable, "-c", READS.replace("sleep(1.0)", "sleep(600 if sys.argv[2:] else 0.3)"), str(tmp_path)]
    first = subprocess.Popen([*command, "slow"], cwd=ROOT)
    while not list(tmp_path.glob("*.lock")):
        assert first.poll() is None
    other = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    first.kill()
    first.wait()
    assert int(other.communicate(timeout=120)[0]) == 1
    assert len(files(tmp_path)) == 1


def test_keys_are_told_apart_by_all_that_they_hold() -> None:
    key = Key(Kind.SHADOW_TABLE, ("a", b"b"), look="c", spacing=0.5, other=(1, None))
    others = [
        key._replace(kind=Kind.SHADOW_MAPS), key._replace(content=("a", "b")), key._replace(look=""),
        key._replace(spacing=0.25), key._replace(other=(1.0, None)), key._replace(content=("a, b'b'",)),
    ]  # fmt: skip
    assert len({text_of(one) for one in (key, *others)}) == 1 + len(others)
    assert text_of(Key(*key)) == text_of(key)


@pytest.mark.parametrize("held", [object(), np.zeros(3), {1}, "streamed pages", len])
def test_keys_of_one_process_or_view_alone_are_not_looked_for(tmp_path: Path, held: object) -> None:
    key = Key(Kind.SHADOW_TABLE, ("a", held))  # pyright: ignore[reportArgumentType]
    with pytest.raises(UnstableError):
        text_of(key)
    assert OnDisk(tmp_path, lambda: None, True).lookup(key, lambda: 3, form_of_records()) == 3
    assert not list(tmp_path.iterdir())


def test_depths_that_a_device_may_change_are_not_kept() -> None:
    bits = np.full((3, 100), EMPTY, np.uint32)
    bits[1, 70:] = np.linspace(0, 9, 30, dtype=np.float32).view(np.uint32)
    found = kept(bits)
    assert found is not None
    assert found["runs"].shape == (1, 64)
    numbers = as_numbers(found)
    assert numbers.shape == bits.shape
    assert (np.where(numbers < 0, EMPTY, numbers.view(np.uint32)) == bits).all()
    for value in (np.float32(1e-40), np.float32(-1), np.float32(np.inf), np.float32(np.nan)):
        bits[0, 0] = value.view(np.uint32)
        assert kept(bits) is None, value
