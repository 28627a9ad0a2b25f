"""What becomes of a film whose machines are killed while they draw it, and how much faster two draw than one.

    python -m scripts.studies.farm killed --folder WORK [--frames 48] [--seed 1]
    python -m scripts.studies.farm speed --folder WORK [--frames 8] [--turns 2]

*killed* draws the film of scripts/demos/film.py in one process, then by four workers, of which two are killed at
random moments, as is the scheduler, which is started again. It says how many frames differ in any bit, and how many
were written more than once. *speed* draws it in turns by one worker and by two, each with one thread.
docs/notes/farm.md has the results.
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
from pathlib import Path

import bpy
import numpy as np

from scripts.common.process import run

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


def start(*words: str, log: Path) -> subprocess.Popen:
    """A process of a session of its own, so that all below it can be killed at once."""
    with log.open("a") as file:
        return subprocess.Popen(
            [sys.executable, FARM, *words], stdout=file, stderr=file, env=ONE_THREAD, start_new_session=True
        )


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
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler = start("scheduler", "--port", str(port), log=log)
    workers = [start("worker", address, log=log) for _ in range(4)]
    words = "render", str(blend), "--frames", numbers, "--output", str(together / "shot.exr"), "--scheduler", address
    client = start(*words, "--threads", "1", log=folder / "client.log")
    try:
        moments = sorted(rng.sample(range(2, frames - 8), 3))
        events = ["worker", "scheduler", "worker"]
        for moment, event in zip(moments, events, strict=True):
            while len(watch.seen) < moment:
                time.sleep(0.05)
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


def speed(folder: Path, frames: int, turns: int) -> None:
    blend = film(folder, 48)
    print("| workers | by the clock | processor time |\n|---|---|---|")
    clock: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(turns):
        for workers in (1, 2):
            out = folder / "speed"
            shutil.rmtree(out, ignore_errors=True)
            words = "render", str(blend), "--frames", f"1-{frames}", "--output", str(out / "shot.exr")
            command = [sys.executable, FARM, *words, "--workers", str(workers), "--threads", "1"]
            subprocess.run(command, check=True, capture_output=True, env=ONE_THREAD)
            report = json.loads((out / "shot.farm" / "report.json").read_text())
            clock[workers].append(report["seconds"])
            print(f"| {workers} | {report['seconds']:.1f} s | {report['processor']:.1f} s |", flush=True)
    print(f"two over one, by the clock: {sum(clock[1]) / sum(clock[2]):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["killed", "speed"])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--turns", type=int, default=2)
    options = parser.parse_args()
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if options.what == "killed":
        killed(folder, options.frames or 48, options.seed)
    else:
        speed(folder, options.frames or 8, options.turns)


if __name__ == "__main__":
    run(main)
