"""What becomes of a film whose machines are killed while they draw it, and how much faster two draw than one.

    python -m scripts.studies.farm killed --folder WORK [--frames 48] [--seed 1]
    python -m scripts.studies.farm faults --folder WORK [--frames 6]
    python -m scripts.studies.farm speed --folder WORK [--frames 8] [--turns 2]

*killed* draws the film of scripts/demos/film.py in one process, then by four workers, of which two are killed at
random moments, as is the scheduler, which is started again. It says how many frames differ in any bit, and how many
were written more than once. *faults* has a good machine and four with a fault each, two of them by mounts of their own,
for which it has to be root: it prints what the farm says. *speed* draws in turns by one worker and by two, each with
one thread. docs/notes/farm.md has the results.
"""

import argparse
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path

import bpy
import numpy as np

from scripts.common.process import environment, run

ROOT = Path(__file__).resolve().parents[2]
FARM, RENDER = (str(ROOT / "scripts" / name) for name in ("farm.py", "render.py"))
ONE_THREAD = {**os.environ, "LP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def film(folder: Path, frames: int) -> Path:
    path = folder / "film.blend"
    command = [sys.executable, "-m", "scripts.demos.film", "--output", str(path), "--frames", str(frames)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return path


def pixels(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    found = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(found)
    bpy.data.images.remove(image)
    return found.view(np.uint32)


class Watch(threading.Thread):
    """Sees every file of a film appear, and whether any changes later."""

    def __init__(self, folder: Path) -> None:
        super().__init__(daemon=True)
        self.folder, self.seen, self.changed = folder, {}, set()
        self.start()

    def run(self) -> None:
        while True:
            for path in self.folder.glob("shot_*.exr"):
                stat = path.stat()
                found = stat.st_ino, stat.st_mtime_ns, stat.st_size
                if self.seen.setdefault(path.name, found) != found:
                    self.changed.add(path.name)
            time.sleep(0.01)


def start(
    *words: str, log: Path, farm: str = FARM, mount: str = "", more: dict[str, str] | None = None
) -> subprocess.Popen:
    """A process of a session of its own, so that all below it can be killed at once. `mount`: a command of the shell,
    whose mounts are its own. `more`: of the environment."""
    command = [sys.executable, farm, *words]
    if mount:
        command = ["unshare", "--mount", "sh", "-c", f'{mount}; exec "$@"', "sh", *command]
    with log.open("a") as file:
        return subprocess.Popen(
            command, stdout=file, stderr=file, env=ONE_THREAD | (more or {}), start_new_session=True
        )


def free_address() -> tuple[str, int]:
    """Of a scheduler, and its port."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    return f"tcp://127.0.0.1:{port}", port


def kill(process: subprocess.Popen) -> None:
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def killed(folder: Path, frames: int, seed: int) -> None:
    rng = random.Random(seed)
    blend, numbers = film(folder, frames), f"1-{frames}"
    alone, together = folder / "alone", folder / "together"
    for old in (alone, together):
        shutil.rmtree(old, ignore_errors=True)
    command = [sys.executable, RENDER, str(blend), "--frames", numbers, "--output", str(alone / "shot.exr")]
    subprocess.run(command, check=True, capture_output=True, env=ONE_THREAD)
    print(f"one process has drawn {len(list(alone.glob('*.exr')))} frames", flush=True)

    together.mkdir(parents=True)
    watch, log = Watch(together), folder / "farm.log"
    address, port = free_address()
    scheduler = start("scheduler", "--port", str(port), log=log)
    workers = [start("worker", address, log=log) for _ in range(4)]
    words = "render", str(blend), "--frames", numbers, "--output", str(together / "shot.exr"), "--scheduler", address
    client = start(*words, "--threads", "1", log=folder / "client.log")
    try:
        moments = sorted(rng.sample(range(2, frames - 8), 3))
        events = ["worker", "scheduler", "worker"]
        for moment, event in zip(moments, events, strict=True):
            while len(watch.seen) < moment and client.poll() is None:
                time.sleep(0.05)
            if client.poll() is not None:
                raise RuntimeError(f"the film ended early: {folder / 'client.log'} says why")
            time.sleep(rng.uniform(0, 4))
            print(f"{len(watch.seen)} frames are there: the {event} is killed", flush=True)
            if event == "worker":
                kill(workers.pop(rng.randrange(len(workers))))
            else:
                kill(scheduler)
                time.sleep(rng.uniform(0, 5))
                scheduler = start("scheduler", "--port", str(port), log=log)
        code = client.wait()
    finally:
        for process in (client, scheduler, *workers):
            if process.poll() is None:
                kill(process)
    names = sorted(path.name for path in alone.glob("*.exr"))
    differ = [n for n in names if not np.array_equal(pixels(alone / n), pixels(together / n))]
    left = [str(p.relative_to(together)) for p in together.rglob("*") if p.is_file() and p.name not in names]
    others = [name for name in left if not name.startswith("shot.farm")]
    print(f"exit code {code}; {len(names)} frames, {len(differ)} differ, {len(watch.changed)} were written twice")
    print(f"files beside the pictures: {others}")


def faults(folder: Path, frames: int) -> None:
    here, out, other = folder / "file", folder / "out", folder / "other"
    shutil.rmtree(out, ignore_errors=True)
    shutil.rmtree(other, ignore_errors=True)
    for made in (here, out):
        made.mkdir(parents=True, exist_ok=True)
    blend, log = film(here, frames), folder / "faults.log"
    for name in ("scripts", "pointsplat_addon", "shaders", "blender_manifest.toml"):
        source, target = ROOT / name, other / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)
    (other / "shaders" / "another.frag").write_text("// of another version")
    address, port = free_address()
    no_driver = {"__EGL_VENDOR_LIBRARY_FILENAMES": str(folder / "none")}
    processes = [
        start("scheduler", "--port", str(port), log=log),
        start("worker", address, log=log, more=no_driver),
        start("worker", address, log=log, mount=f"mount -t tmpfs none '{here}'"),
        start("worker", address, log=log, mount=f"mount -t tmpfs -o size=16k none '{out}'"),
        start("worker", address, log=log, farm=str(other / "scripts" / "farm.py")),
    ]
    words = "render", str(blend), "--frames", f"1-{frames}", "--output", str(out / "shot.exr"), "--scheduler", address
    client = start(*words, "--threads", "1", log=folder / "faults_client.log")
    try:
        time.sleep(30)  # in which only those with faults are there
        processes.append(start("worker", address, log=log))
        code = client.wait()
    finally:
        for process in (client, *processes):
            if process.poll() is None:
                kill(process)
    print((folder / "faults_client.log").read_text())
    print(f"exit code {code}; in the folder: {sorted(p.name for p in out.rglob('*'))}")


def speed(folder: Path, frames: int, turns: int) -> None:
    blend = film(folder, 48)
    print("| workers | by the clock | processor time | of the busiest |\n|---|---|---|---|")
    # Compiled modules, which each process has to make where the environment forbids that they are kept.
    compiled = environment(folder / "bytecode") | {"LP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    clock, busiest = defaultdict(list), defaultdict(list)
    for _ in range(turns):
        for workers in (1, 2):
            out = folder / "speed"
            shutil.rmtree(out, ignore_errors=True)
            words = "render", str(blend), "--frames", f"1-{frames}", "--output", str(out / "shot.exr")
            command = [sys.executable, FARM, *words, "--workers", str(workers), "--threads", "1"]
            subprocess.run(command, check=True, capture_output=True, env=compiled)
            report = json.loads((out / "shot.farm" / "report.json").read_text())
            clock[workers].append(report["seconds"])
            busiest[workers].append(max(row["processor"] for row in report["machines"].values()))
            row = report["seconds"], report["processor"], busiest[workers][-1]
            print(f"| {workers} |" + "".join(f" {seconds:.1f} s |" for seconds in row), flush=True)
    ratios = [sum(found[1]) / sum(found[2]) for found in (clock, busiest)]
    print(f"two over one: {ratios[0]:.2f} by the clock, {ratios[1]:.2f} by the processor time of the busiest worker")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["killed", "faults", "speed"])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--turns", type=int, default=2)
    options = parser.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if options.what == "killed":
        killed(folder, options.frames or 48, options.seed)
    elif options.what == "faults":
        faults(folder, options.frames or 6)
    else:
        speed(folder, options.frames or 8, options.turns)


if __name__ == "__main__":
    run(main)
