"""Speed and memory of translucent shadow tables, as ratios within one run.

python -m scripts.benchmarks.shadow [--quick]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.shadow import builder
from pointsplat_addon.core.splat.kernel import EVEN_SPACING
from scripts.common.shadow_truth import optical_depth

DOWN = np.array([0.0, 0.0, -1.0])
LAMP = Light("POINT", np.ones(3), np.array([0.1, 0.2, 3.0]), DOWN)
INSIDE = Light("POINT", np.ones(3), np.array([0.1, 0.2, 0.3]), DOWN)
RESOLUTION = 1024


def smoke(count: int, ray: bool = False, colored: bool = False) -> builder.Casters:
    """Balls in random order in a cube of side 2, or on one ray of the lamp, as large as voxels of the cube."""
    rng = np.random.default_rng(0)
    position = np.empty((count, 3), np.float32)
    for part in np.array_split(position, max(count // 100_000, 1)):
        cube = rng.uniform(-1, 1, part.shape)
        part[:] = LAMP.position + (3 + cube[:, :1]) * [0.0, 0.1, -1.0] if ray else cube
    radius = np.full(count, 2 * EVEN_SPACING * 2 / np.cbrt(count), np.float32)
    mass = np.full((count, 3) if colored else count, 8 / count, np.float32)
    return builder.Casters("VOLUME", np.zeros(3), position, radius=radius, mass=mass)


def seconds(call: Callable[[], object]) -> float:
    """Processor time: all that is timed here runs in one thread."""
    start = time.process_time()
    call()
    return time.process_time() - start


def row(name: str, value: float, unit: str, target: str, note: str = "") -> dict:
    return {"name": name, "value": float(value), "unit": unit, "target": target, "note": note}


def against_sort(count: int, light: Light, name: str, times: int) -> list[dict]:
    """Building, and sorting as many random 64-bit keys as the table has entries, in turn."""
    batch = smoke(count)
    table = builder.build_table(light, [batch], RESOLUTION)
    keys = np.random.default_rng(0).integers(0, 2**62, table.entries).astype(np.uint64)
    pairs = [
        (seconds(lambda: builder.build_table(light, [batch], RESOLUTION)), seconds(lambda: keys.argsort(kind="stable")))
        for _ in range(times)
    ]
    ours, theirs = np.min(pairs, axis=0)
    note = f"{count / 1e6:g} M points, {table.entries / count:.2f} entries each; {ours:.2f} s against {theirs:.2f} s"
    return [
        row(f"shadow table, {name} / argsort of its entries", ours / theirs, "x", "< 3", note),
        row(f"shadow table, {name}", table.nbytes / table.entries, "B/entry", "<= 12", f"{len(table.levels)} levels"),
    ]


def growth(count: int, times: int) -> dict:
    """Twice the points against once, over as many points each time, in turn."""
    few, many = smoke(count // 2), smoke(count)
    pairs = [
        (
            seconds(lambda: [builder.build_table(LAMP, [few], RESOLUTION) for _ in range(2)]),
            seconds(lambda: builder.build_table(LAMP, [many], RESOLUTION)),
        )
        for _ in range(times)
    ]
    low, high = np.min(pairs, axis=0)
    note = f"{count / 2e6:g} and {count / 1e6:g} M; {low / 2:.2f} and {high:.2f} s"
    return row("shadow table, twice the points", 2 * high / low, "x", "<= 2.2", note)


def one_ray(count: int, times: int) -> dict:
    """All points on one ray of the lamp against a cube, in turn."""
    line, cube = smoke(count, ray=True), smoke(count)
    pairs = [
        (
            seconds(lambda: builder.build_table(LAMP, [line], RESOLUTION)),
            seconds(lambda: builder.build_table(LAMP, [cube], RESOLUTION)),
        )
        for _ in range(times)
    ]
    ray, uniform = np.min(pairs, axis=0)
    return row("shadow table, all on one ray / uniform", ray / uniform, "x", "<= 1.2", f"{count / 1e6:g} M points")


def colored(count: int) -> dict:
    table = builder.build_table(LAMP, [smoke(count, colored=True)], RESOLUTION)
    return row("shadow table, colored", table.nbytes / table.entries, "B/entry", "<= 20")


def many(count: int) -> dict:
    """More points than float32 has integers: the table holds all their mass."""
    table = builder.build_table(LAMP, [smoke(count)], RESOLUTION)
    behind = LAMP.position + 2 * (np.random.default_rng(0).uniform(-0.3, 0.3, (1000, 3)) - LAMP.position)
    # The chord through the cube, whose extinction is 1.
    ray = (behind - LAMP.position) / np.linalg.norm(behind - LAMP.position, axis=1, keepdims=True)
    near, far = (np.sort([(side - LAMP.position) / ray for side in (-1, 1)], axis=0)[k] for k in (0, 1))
    chord = far.min(axis=1) - near.max(axis=1)
    depth = optical_depth(table, behind)
    note = f"{count} points, {table.entries} entries"
    return row("shadow table, mean depth of many points", depth.mean() / chord.mean(), "x", "<= 1.005", note)


def run(quick: bool = False) -> list[dict]:
    """Rows of name, value, unit, target and note. `quick` takes seconds and an eighth of the points."""
    count = 1_840_000 // (8 if quick else 1)
    rows = [
        *against_sort(count, LAMP, "lamp outside", 3),
        *against_sort(count, INSIDE, "lamp inside", 3),
        growth(2 * count, 3),
        one_ray(count, 3),
        colored(count),
    ]
    return rows if quick else [*rows, many(2**24 + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="an eighth of the points")
    options = parser.parse_args()
    for entry in run(options.quick):
        sys.stdout.write("{name:52} {value:8.3f} {unit:8} {target:8} {note}\n".format(**entry))


if __name__ == "__main__":
    main()
