"""What reading LAZ files takes, and importing them as an object, beside laspy; ratios within one run.

    python -m scripts.benchmarks.scan_import TILE.laz ... [--repeats 3]

Each measure is taken in a fresh process, in turn with the others: by the clock and of processors, best of all repeats.
Memory is the most that the process has had, beyond what it had before (Linux), over the bytes of the object's
attributes. A survey of 10 million points: see `survey`.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

MARK = "RESULT "  # begins the line of the worker's answer, among Blender's own lines
CHUNK = 1 << 20  # points of laspy's chunks


def resident(which: str) -> int:
    """Bytes of this process: VmRSS now, VmHWM at most."""
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines() if ":" in line)
    return 1024 * int(lines[which].split()[0])


def measured(work: Callable[[], Any]) -> dict[str, Any]:
    before, clock, processor = resident("VmRSS"), time.monotonic(), time.process_time()
    kept = work()
    return {
        "clock": time.monotonic() - clock,
        "processor": time.process_time() - processor,
        "memory": resident("VmHWM") - before,
        "kept": kept,
    }


def laspy_chunks(paths: list[Path]) -> None:
    """laspy's chunk iterator, in one process and thread; nothing is kept."""
    import laspy

    for path in paths:
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
            for points in file.chunk_iterator(CHUNK):
                assert len(points)


def own_chunks(paths: list[Path], threads: bool) -> None:
    """All columns of our reader, in chunks; nothing is kept."""
    from pointsplat_addon.formats.points.lidar.las import LasReader

    for path in paths:
        with LasReader(path, threads=threads) as reader:
            for chunk in reader.chunks(None, CHUNK):
                assert len(chunk["position"])


def laspy_arrays(paths: list[Path]) -> int:
    """All points as NumPy arrays by laspy, coordinates in float64, as `laspy.read` chooses its decoder; their bytes."""
    import laspy

    parts: dict[str, list[np.ndarray]] = {}
    for path in paths:
        las = laspy.read(path)
        parts.setdefault("xyz", []).append(las.xyz)
        for name in las.point_format.dimension_names:
            if name not in ("X", "Y", "Z"):
                parts.setdefault(name, []).append(np.array(las[name]))
    arrays = {name: np.concatenate(parts.pop(name)) for name in list(parts)}
    return sum(array.nbytes for array in arrays.values())


def imported(paths: list[Path]) -> int:
    """An object by the operator; bytes of its attributes."""
    import bpy

    folder = paths[0].parent
    files = [{"name": path.name} for path in paths]
    assert all(path.parent == folder for path in paths), "files are in one folder"
    result = bpy.ops.pointsplat.import_points(filepath=str(paths[0]), directory=str(folder) + os.sep, files=files)
    assert result == {"FINISHED"}, result
    points = bpy.context.object.data
    sizes = {"FLOAT_VECTOR": 12, "FLOAT": 4, "INT": 4, "INT8": 1, "BYTE_COLOR": 4, "FLOAT_COLOR": 16, "BOOLEAN": 1}
    return sum(sizes[one.data_type] * len(points.points) for one in points.attributes)


def worker(kind: str, paths: list[Path]) -> None:
    import laspy  # noqa: F401 - that what it takes is not counted

    work = {
        "laspy, chunks": lambda: laspy_chunks(paths),
        "chunks, one thread": lambda: own_chunks(paths, threads=False),
        "chunks": lambda: own_chunks(paths, threads=True),
        "laspy, arrays": lambda: laspy_arrays(paths),
        "import": lambda: imported(paths),
    }[kind]
    if kind == "import":
        import bpy

        import pointsplat_addon

        bpy.ops.wm.read_factory_settings(use_empty=True)
        pointsplat_addon.register()
    print(MARK + json.dumps(measured(work)), flush=True)


KINDS = "laspy, chunks", "chunks, one thread", "chunks", "laspy, arrays", "import"
BESIDE = {"chunks, one thread": "laspy, chunks", "chunks": "laspy, chunks", "import": "laspy, arrays"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tiles", nargs="+", type=lambda text: Path(text).resolve())
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        worker(given.worker, given.tiles)
        return
    found: dict[str, list[dict[str, Any]]] = {kind: [] for kind in given.kinds}
    for _ in range(given.repeats):
        for kind in given.kinds:
            command = [sys.executable, "-m", "scripts.benchmarks.scan_import", *map(str, given.tiles)]
            done = subprocess.run([*command, "--worker", kind], check=True, capture_output=True, text=True)
            [line] = [line for line in done.stdout.splitlines() if line.startswith(MARK)]
            found[kind].append(json.loads(line.removeprefix(MARK)))
    print("| what | clock, s | processor, s | ratio | of processor | memory, GB | kept, GB | memory over kept |")
    for kind, runs in found.items():
        best = {key: min(run[key] or 0 for run in runs) for key in runs[0]}
        beside = found.get(BESIDE.get(kind, kind), runs)
        ratios = [best[key] / min(run[key] for run in beside) for key in ("clock", "processor")]
        over = f"{best['memory'] / best['kept']:.2f}" if best["kept"] else ""
        print(
            f"| {kind} | {best['clock']:.2f} | {best['processor']:.2f} | {ratios[0]:.2f} | {ratios[1]:.2f} | "
            f"{best['memory'] / 1e9:.2f} | {best['kept'] / 1e9:.2f} | {over} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
