"""Speed of the back-to-front order, as ratios within one run.

python -m scripts.benchmarks.order [--quick]
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from pointsplat_addon.core.lod import depth_order
from pointsplat_addon.core.lod.cut import cut_of_all_points
from pointsplat_addon.core.scene.cloud import PointCloud
from scripts.benchmarks.hierarchy import row, seconds


def depths(count: int) -> dict[str, np.ndarray]:
    """Depths (count,) float32 of several shapes."""
    rng = np.random.default_rng(0)
    return {
        "uniform": rng.random(count, np.float32),
        "one slice": np.full(count, 2, np.float32),
        "sorted": np.linspace(0, 1, count, dtype=np.float32),
        "1 to 1e9": np.exp(rng.uniform(-10.4, 10.4, count)).astype(np.float32),
    }


def against_argsort(count: int, times: int) -> list[dict]:
    """The bucket sort with slices for one table and for two, and a stable argsort of as many uniform depths."""
    found = []
    for name, depth in depths(count).items():
        extent = max(float(np.ptp(depth)), 1.0)
        for tables, slices in ((1, 1500), (2, 1e7)):
            # Alternating, so that a change of the machine's load meets both.
            pairs = [
                (
                    seconds(lambda depth=depth, s=slices, e=extent: depth_order.back_to_front(depth, e / s), 1),
                    seconds(lambda depth=depth: np.argsort(depth, kind="stable"), 1),
                )
                for _ in range(times)
            ]
            ours, theirs = np.min(pairs, axis=0)
            note = f"{count / 1e6:g} M depths, {name}; {1e3 * ours:.0f} ms against {1e3 * theirs:.0f} ms"
            target = "<= 1" if name in ("uniform", "1 to 1e9") else ""
            found.append(row(f"{tables}-table sort / argsort float32", ours / theirs, "x", target, note))
    return found


def growth(count: int, times: int) -> dict:
    few, many = (np.random.default_rng(0).random(n, np.float32) for n in (count, 2 * count))
    pairs = [
        (
            seconds(lambda: depth_order.back_to_front(few, 1e-7), 1),
            seconds(lambda: depth_order.back_to_front(many, 1e-7), 1),
        )
        for _ in range(times)
    ]
    low, high = np.min(pairs, axis=0)
    return row("sort of twice as many", high / low, "x", "", f"{count / 1e6:g} M and {2 * count / 1e6:g} M")


def whole_cut(count: int, times: int) -> dict:
    """From positions to an order, and the same argsort: projection and bounds included."""
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        rng.random((count, 3), np.float32),
        radii=np.full((count, 1), 1e-3, np.float32),
        extinction=np.ones(count, np.float32),
    )
    one, world = np.zeros(1, int), np.eye(4)[None]
    cut, depth = cut_of_all_points(np.array([count]), one), rng.random(count, np.float32)
    pairs = [
        (
            seconds(lambda: depth_order.sort_cut(cut, {0: cloud}, one, world, np.eye(4)), 1),
            seconds(lambda: np.argsort(depth, kind="stable"), 1),
        )
        for _ in range(times)
    ]
    ours, theirs = np.min(pairs, axis=0)
    return row("order of a cut / argsort float32", ours / theirs, "x", "<= 1", f"{count / 1e6:g} M points")


def run(quick: bool = False) -> list[dict]:
    """Rows of name, value, unit, target and note. `quick` takes an eighth of the points."""
    count = 1_840_000 // (8 if quick else 1)
    return [*against_argsort(count, 5), growth(count, 5), whole_cut(count, 5)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="an eighth of the points")
    for entry in run(parser.parse_args().quick):
        sys.stdout.write("{name:40} {value:8.2f} {unit:8} {target:8} {note}\n".format(**entry))


if __name__ == "__main__":
    main()
