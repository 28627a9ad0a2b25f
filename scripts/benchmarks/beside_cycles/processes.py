"""Fresh processes that render, for scripts/benchmarks/beside_cycles, and what they took."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from scripts.benchmarks.beside_cycles.worker import MARK
from scripts.common.process import environment

ROOT = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Program:
    """What renders: CYCLES, BLENDER_WORKBENCH or a technique of PointSplat's; its samples."""

    name: str
    samples: int

    def title(self) -> str:
        return f"{self.name.removeprefix('BLENDER_').capitalize().replace('_', ' ')}, {self.samples}"


def rendered(
    file: Path,
    program: Program,
    outputs: list[Path],
    seed: int = 0,
    settings: dict | None = None,
    limit: float = 3600,
    *,
    bytecode: Path,
    shader_cache: bool = True,
    size: tuple[int, int] | None = None,
) -> dict:
    """What rendering a .blend file into EXR files took, the process being born for it; {"failed": why} if it did not.

    seconds, processor: of the clock and of all threads, from the start of the process to the first file written;
    second, second_processor: between the first and the second; peak, second_peak: bytes of memory (not the GPU's)
    until the first and the second; stages: seconds of the clock; reports: of PointSplat, for each picture.
    `bytecode` and `shader_cache` say what earlier processes have left (scripts/common/process.py). size: in pixels, if
    not the file's.
    """
    asked = {"file": str(file), "program": program.name, "samples": program.samples, "seed": seed,
             "settings": settings or {}, "outputs": [str(path) for path in outputs], "size": size}  # fmt: skip
    for path in outputs:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
    command = [sys.executable, "-m", "scripts.benchmarks.beside_cycles.worker", json.dumps(asked)]
    start = time.monotonic()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, cwd=ROOT,
                              env=environment(bytecode, shader_cache))  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"took longer than {limit:g} s"}
    answer = next((line for line in done.stdout.splitlines() if line.startswith(MARK)), None)
    if done.returncode or answer is None or not all(path.exists() for path in outputs):
        told = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        return {"failed": " ".join(told[-3:]) or f"exit status {done.returncode}"}
    found = json.loads(answer.removeprefix(MARK))
    states = found["states"]
    clocks = [start, *(state["clock"] for state in states.values())]
    first = states["picture 1"]
    result = {
        "seconds": first["clock"] - start,
        "processor": first["processor"],
        "peak": first["peak"],
        "stages": {name: b - a for name, a, b in zip(states, clocks, clocks[1:], strict=False)},
        "reports": found["reports"],
    }
    if second := states.get("picture 2"):
        result |= {"second": second["clock"] - first["clock"], "second_peak": second["peak"],
                   "second_processor": second["processor"] - first["processor"]}  # fmt: skip
    return result


def scene_file(path: Path, arguments: list[str]) -> None:
    """Make a .blend file by scripts/benchmarks/beside_cycles/scenes.py. RuntimeError: why it was not made."""
    command = [sys.executable, "-m", "scripts.benchmarks.beside_cycles.scenes", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    if done.returncode or not path.exists():
        raise RuntimeError(done.stderr.strip() or done.stdout.strip())
