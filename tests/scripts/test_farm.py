"""A film on many machines: what is killed is drawn elsewhere, what is there stays, what fails is said.

Most tests share out frames that a stand-in for render.py "draws": a copy of the scripts in which rendering writes a few
bytes, waits, or fails as a file of instructions says. One draws real frames.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pointsplat_addon.formats.whole_image import is_whole
from scripts.common.farm_task import publish
from scripts.common.version import version_of

ROOT = Path(__file__).resolve().parents[2]

# FILE.blend holds, as JSON, the seconds that a frame takes and frames that raise; machines have their own faults.
STAND_IN = """
def render(args):
    import time
    told = json.loads(args.file.read_text())
    with open(args.file.with_suffix(".calls"), "a") as calls:
        calls.write(f"{args.frame} {os.getpid()} {os.getppid()}\\n")
    if args.require.split()[0] != version_of(ROOT) or "MACHINE_FAULT" in os.environ:
        raise MachineError(os.environ.get("MACHINE_FAULT", "another version"))
    if args.frame in told.get("raises", []):
        raise RuntimeError(f"frame {args.frame}: Error: PointSplat: ConversionError: Cow: ValueError: broken")
    time.sleep(told.get("seconds", 0))
    if not args.part:
        args.output.write_text(f"frame {args.frame}")
    args.report.write_text(json.dumps({"device": "none", "version": f"{version_of(ROOT)} Blender 5"}))


"""


class Farm:
    """A copy of the scripts with the stand-in, and the processes that a test starts there."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.processes = folder, []
        version = (f"pointsplat_addon/{name}.py" for name in ("__init__", "formats/__init__", "formats/code_version"))
        for name in ("scripts/farm.py", "scripts/common", *version):
            source, target = ROOT / name, folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if source.is_dir() else shutil.copy)(source, target)
        shutil.copy(ROOT / "blender_manifest.toml", folder)
        text = (ROOT / "scripts" / "render.py").read_text(encoding="utf-8")
        start = 'if __name__ == "__main__":'
        (folder / "scripts" / "render.py").write_text(text.replace(start, STAND_IN + start), encoding="utf-8")

    def start(self, *words: object, **faults: str) -> subprocess.Popen:
        with (self.folder / "log").open("a") as log:
            process = subprocess.Popen(
                [sys.executable, str(self.folder / "scripts" / "farm.py"), *map(str, words)],
                stdout=subprocess.PIPE if words[0] == "render" else log,
                stderr=subprocess.STDOUT,
                text=True,
                env=os.environ | faults,
                start_new_session=True,
            )
        self.processes.append(process)
        return process

    def render(self, *words: object) -> subprocess.Popen:
        return self.start("render", self.folder / "film.blend", "--output", self.folder / "out" / "shot.png", *words)

    def film(self, **told: object) -> None:
        (self.folder / "film.blend").write_text(json.dumps(told))

    def scheduler(self) -> tuple[str, Callable[[], subprocess.Popen]]:
        """The address of a scheduler, and what starts it."""
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            port = found.getsockname()[1]
        return f"tcp://127.0.0.1:{port}", lambda: self.start("scheduler", "--port", port)

    def calls(self) -> list[list[int]]:
        """(frame, process, its parent) of all that was begun."""
        path = self.folder / "film.calls"
        lines = path.read_text().splitlines() if path.exists() else []
        return [[int(word) for word in line.split()] for line in lines]

    def pictures(self) -> dict[str, str]:
        return {p.name: p.read_text() for p in sorted((self.folder / "out").glob("*.png"))}

    def report(self) -> dict:
        return json.loads((self.folder / "out" / "shot.farm" / "report.json").read_text())

    def wait_for(self, frames: int) -> None:
        """Wait until so many frames were begun."""
        deadline = time.monotonic() + 60
        while len(self.calls()) < frames:
            assert time.monotonic() < deadline, (self.folder / "log").read_text()
            time.sleep(0.02)


def kill(process: subprocess.Popen) -> None:
    """A process and all below it, as a machine fails."""
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@pytest.fixture
def farm(tmp_path: Path) -> Iterator[Farm]:
    found = Farm(tmp_path)
    yield found
    for process in found.processes:
        if process.poll() is None:
            kill(process)


def ended(process: subprocess.Popen) -> tuple[int, str]:
    said, _ = process.communicate(timeout=120)
    return process.returncode, said


def all_of(*numbers: int) -> dict[str, str]:
    return {f"shot_{n:04d}.png": f"frame {n}" for n in numbers}


def test_a_killed_worker_s_frame_is_drawn_elsewhere_and_the_same_command_goes_on(farm: Farm) -> None:
    farm.film(seconds=0.5)
    client = farm.render("--frames", "1-4", "--workers", 2)
    farm.wait_for(3)
    os.kill(farm.calls()[2][2], signal.SIGKILL)  # the worker; dask starts another
    farm.wait_for(4)
    kill(client)  # with its scheduler and workers
    client = farm.render("--frames", "1-5", "--workers", 2)
    code, said = ended(client)
    assert code == 0, said
    assert farm.pictures() == all_of(1, 2, 3, 4, 5)
    assert "to go, about 0:00:" in said
    assert not list((farm.folder / "out" / "shot.farm" / "parts").glob("*.json"))
    times = {p: p.stat().st_mtime_ns for p in (farm.folder / "out").glob("*.png")}
    code, said = ended(farm.render("--frames", "1-5", "--workers", 1))
    assert (code, {p: p.stat().st_mtime_ns for p in times}) == (0, times)
    assert "0 of 5 frames are missing" in said


def test_a_scheduler_may_be_started_again_and_a_machine_with_a_fault_gets_no_more_frames(farm: Farm) -> None:
    farm.film(seconds=0.3)
    address, start = farm.scheduler()
    scheduler = start()
    bad = farm.start("worker", address, MACHINE_FAULT="nothing to draw with")
    client = farm.render("--frames", "1-6", "--scheduler", address)
    farm.wait_for(1)
    farm.start("worker", address)
    farm.wait_for(3)
    kill(scheduler)
    kill(bad)
    time.sleep(0.5)
    start()
    code, said = ended(client)
    assert code == 0, said
    assert farm.pictures() == all_of(1, 2, 3, 4, 5, 6)
    assert "nothing to draw with" in said


def test_a_frame_that_raises_is_told_and_all_others_are_drawn(farm: Farm) -> None:
    farm.film(raises=[2])
    code, said = ended(farm.render("--frames", "1-4", "--workers", 2))
    assert code == 1, said
    assert farm.pictures() == all_of(1, 3, 4)
    assert "frame 2 FAILED: frame 2: Error: PointSplat: ConversionError: Cow: ValueError: broken" in said
    assert len({parent for frame, _, parent in farm.calls() if frame == 2}) == 2  # on another worker, too
    report = farm.report()
    assert list(report["failed"]) == ["2"]
    assert sorted(n for row in report["machines"].values() for n in row["frames"]) == [1, 3, 4]
    assert all(row["waiting"] >= 0 for row in report["machines"].values())


def test_parts_of_a_frame_are_drawn_and_joined(farm: Farm) -> None:
    farm.film()
    code, said = ended(farm.render("--frames", "1-2", "--workers", 2, "--parts", 3))
    assert code == 0, said
    assert farm.pictures() == all_of(1, 2)
    assert sorted(frame for frame, *_ in farm.calls()) == [1] * 4 + [2] * 4
    assert "frame 2, part 3, on" in said
    assert not list((farm.folder / "out" / "shot.farm").glob("*.parts"))


def test_where_no_machine_can_draw_each_says_why(farm: Farm, monkeypatch: pytest.MonkeyPatch) -> None:
    farm.film()
    monkeypatch.setenv("MACHINE_FAULT", "the disk is full")
    code, said = ended(farm.render("--frames", "1-3", "--workers", 2))
    assert code == 1, said
    assert farm.pictures() == {}
    assert said.count("the disk is full") >= 2
    assert "no machine can draw it" in said


def test_pictures_of_another_film_are_not_taken_for_its_own(farm: Farm) -> None:
    farm.film()
    assert ended(farm.render("--frames", "1-1", "--workers", 1))[0] == 0
    farm.film(seconds=0.1)
    code, said = ended(farm.render("--frames", "1-2", "--workers", 1))
    assert code == 2
    assert "are of another file" in said
    assert farm.pictures() == all_of(1)


MAKE_FILE = """
import os, sys
import bpy
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 32, 24
cube = bpy.data.objects["Cube"]
for frame in (1, 3):
    cube.location.x = frame - 2
    cube.keyframe_insert("location", frame=frame)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
sys.stdout.flush()
os._exit(0)
"""


def test_frames_by_two_workers_are_those_of_one_process_to_the_bit(tmp_path: Path) -> None:
    file = tmp_path / "cube.blend"
    subprocess.run([sys.executable, "-c", MAKE_FILE, str(file)], check=True, capture_output=True, timeout=120)
    words = [str(file), "--frames", "1-3", "--output"]
    alone = [sys.executable, str(ROOT / "scripts" / "render.py"), *words, str(tmp_path / "alone" / "shot.png")]
    subprocess.run(alone, check=True, capture_output=True, timeout=300)
    together = [sys.executable, str(ROOT / "scripts" / "farm.py"), "render", *words, str(tmp_path / "both/shot.png")]
    result = subprocess.run([*together, "--workers", "2"], capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    for frame in (1, 2, 3):
        one, other = (np.asarray(Image.open(tmp_path / by / f"shot_{frame:04d}.png")) for by in ("alone", "both"))
        assert np.array_equal(one, other)
    report = json.loads((tmp_path / "both" / "shot.farm" / "report.json").read_text())
    assert report["version"].startswith(f"{version_of(ROOT)} Blender ")


def test_a_name_that_is_taken_stays_with_its_file(tmp_path: Path) -> None:
    part, target = tmp_path / "part", tmp_path / "target"
    part.write_text("new")
    assert publish(part, target)
    part.write_text("newer")
    target.unlink()
    target.write_text("old")
    assert not publish(part, target)
    assert target.read_text() == "old"


@pytest.mark.parametrize("cut", [0, 1, 7, 40])
def test_a_picture_that_lost_its_end_is_not_whole(cut: int, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.new("RGB", (9, 9)).save(path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - cut])
    assert is_whole(path) == (cut == 0)
