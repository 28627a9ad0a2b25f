"""Speed and memory of the point-octree and of cuts, as ratios within one run.

python -m scripts.benchmarks.hierarchy [--quick]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pointsplat_addon.core.lod import cut, hierarchy, node_table, quantisation
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud


def surface(count: int) -> PointCloud:
    """Disks on a bumpy sphere in random order, with normal, radius and colour; made in pieces, to leave no peak."""
    rng = np.random.default_rng(0)
    arrays = {name: np.empty((count, width), np.float32)
              for name, width in (("position", 3), ("normal", 3), ("radii", 1), ("color", 3))}  # fmt: skip
    arrays["radii"][:] = 1.4 * np.sqrt(4 / count)
    for i in range(0, count, 100_000):
        n = rng.standard_normal((len(arrays["position"][i : i + 100_000]), 3))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        arrays["normal"][i : i + 100_000] = n
        arrays["position"][i : i + 100_000] = n * (1 + 0.1 * np.sin(9 * n[:, :1]) * np.cos(7 * n[:, 1:2]))
        arrays["color"][i : i + 100_000] = np.abs(n)
    return PointCloud(**arrays)


def seconds(call: Callable[[], object], times: int) -> float:
    """Processor time of the fastest of several calls: all that is timed here runs in one thread."""
    best = np.inf
    for _ in range(times):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def row(name: str, value: float, unit: str, target: str, note: str = "") -> dict:
    return {"name": name, "value": float(value), "unit": unit, "target": target, "note": note}


def build_against_kd_tree(count: int, times: int) -> dict:
    from scipy.spatial import cKDTree

    cloud = surface(count)
    # Alternating, so that a change of the machine's load meets both.
    pairs = [(seconds(lambda: hierarchy.build(cloud), 1), seconds(lambda: cKDTree(cloud.position), 1))
             for _ in range(times)]  # fmt: skip
    ours, theirs = np.min(pairs, axis=0)
    note = f"{count / 1e6:g} M points with normal, radius, colour; {ours:.2f} s against {theirs:.2f} s"
    return row("build / scipy cKDTree", ours / theirs, "x", "<= 2", note)


def growth_of_cost(small: int, large: int, times: int) -> dict:
    """Alternating, over as many points each time, so that a busy machine meets both alike."""
    few, many = surface(small), surface(large)
    hierarchy.build(many)  # the machine's first touch of memory is not counted
    costs = [
        (
            seconds(lambda: [hierarchy.build(few) for _ in range(large // small)], 1),
            seconds(lambda: hierarchy.build(many), 1),
        )
        for _ in range(times)
    ]
    low, high = 1e9 * np.min(costs, axis=0) / large
    note = f"{low:.0f} ns at {small / 1e6:g} M, {high:.0f} ns at {large / 1e6:g} M points"
    return row("build, cost per point growth", high / low, "x", "< 1.5", note)


def packed_size(count: int) -> dict:
    built = hierarchy.build(surface(count))
    note = f"{len(built) / count:.3f} nodes per point; {built.nbytes / count:.0f} B unpacked"
    return row("packed, nodes and order included", quantisation.pack(built).nbytes / count, "B/point", "<= 46", note)


def peak_resident() -> int:
    """High-water mark of this process, bytes (Linux)."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def print_peak(count: int) -> None:
    """What a child process does for `memory`: the growth of the high-water mark while building."""
    hierarchy.build(surface(1000))
    cloud = surface(count)
    before = peak_resident()
    built = hierarchy.build(cloud)
    sys.stdout.write(f"{(peak_resident() - before) / len(built.cloud)} {cloud.nbytes / count}\n")


def memory(count: int) -> list[dict]:
    if not Path("/proc/self/status").exists():
        return []
    out = subprocess.run(
        [sys.executable, "-m", "scripts.benchmarks.hierarchy", "--peak", str(count)],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).resolve().parents[2],
    )
    growth, given = (float(x) for x in out.stdout.split())
    note = f"{count / 1e6:g} M points, result included"
    return [
        row("build, resident peak over the input", growth, "B/point", "< 250", note),
        row("build, resident peak with the input", growth + given, "B/point", "< 250", note),
    ]


def perspective(size: int) -> Camera:
    clip = np.diag([2.0, 2.0, -1.001, 0.0])
    clip[2, 3], clip[3, 2] = -0.2, -1.0
    return Camera(np.eye(4), clip, (size, size), near=0.1, far=1000.0)


def cut_against_sort(count: int, times: int) -> dict:
    """A cut of about a quarter as many nodes as there are points, and an argsort of as many random numbers."""
    built = hierarchy.build(surface(count))
    forest, view = node_table.node_table({0: built}), np.eye(4)[None].copy()
    view[0, 2, 3] = -4
    # A tolerance of four times the points' diameter leaves few points and many nodes.
    tolerance = 4 * 2 * float(built.cloud.radii[0, 0]) / 4 * 1024  # type: ignore[index]
    camera, geometry = perspective(1024), np.zeros(1, int)
    found = cut.select_cut(forest, geometry, view, camera, tolerance)
    keys = np.random.default_rng(0).random(max(found.nodes, 1))
    ours = seconds(lambda: cut.select_cut(forest, geometry, view, camera, tolerance), times)
    theirs = seconds(keys.argsort, times)
    note = f"{found.nodes} nodes, {found.points} points, {len(found.first)} ranges; {1e3 * ours:.0f} ms"
    return row("cut / argsort of as many as its nodes", ours / theirs, "x", "< 2", note)


def run(quick: bool = False) -> list[dict]:
    """Rows of name, value, unit, target and note. `quick` takes seconds and an eighth of the points."""
    part = 8 if quick else 1
    return [
        build_against_kd_tree(4_000_000 // part, 3),
        growth_of_cost(500_000 // part, 8_000_000 // part, 3),
        packed_size(4_000_000 // part),
        *memory(4_000_000 // part),
        cut_against_sort(4_000_000 // part, 5),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="an eighth of the points")
    parser.add_argument("--peak", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.peak:
        print_peak(options.peak)
        return
    for entry in run(options.quick):
        sys.stdout.write("{name:40} {value:8.2f} {unit:8} {target:8} {note}\n".format(**entry))


if __name__ == "__main__":
    main()
