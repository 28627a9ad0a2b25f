"""Speed of core.sampling on one core, as ratios to sorting as many float32 values in the same run."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.surface import sampling


def wave(vertices: int) -> Mesh:
    """A square of about `vertices` vertices, twice as many triangles, and a wavy height."""
    n = max(2, round(vertices**0.5))
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    position = np.stack([x, y, 0.3 * np.sin(3 * x) * np.cos(4 * y)], -1).reshape(-1, 3).astype(np.float32)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.stack([i, i + n, i + 1, i + 1, i + n, i + n + 1], 1).reshape(-1, 3).astype(np.int32)
    return Mesh("bench", "wave", position, triangles)


def seconds(work: Callable[[], Any], repeats: int = 3) -> float:
    """Least time of a few runs: others on the machine can only add."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def run(quick: bool = False) -> list[dict[str, Any]]:
    """Rows of name, value, unit, target, note. `quick` uses a tenth of the size."""
    count = 100_000 if quick else 1_000_000
    dense, coarse = wave(count // 2), wave(1000)
    keys = np.random.default_rng(0).random(count, dtype=np.float32)
    sort = seconds(lambda: np.argsort(keys))
    fine = float(np.sqrt(sampling.measure(coarse).area / count))  # about `count` samples on large triangles
    one_each = 10.0  # larger than any triangle
    cases = {
        "VERTICES": (dense, one_each, "triangles, half as many samples"),
        "AREA, one sample for each triangle": (dense, one_each, "triangles and samples"),
        "AREA on large triangles": (coarse, fine, "samples"),
        "GRID on large triangles": (coarse, fine, "samples"),
    }

    rows = []
    for name, (mesh, spacing, what) in cases.items():
        method = name.split()[0].strip(",")

        def work(mesh: Mesh = mesh, spacing: float = spacing, method: str = method) -> None:
            ok = sampling.validate(mesh)[0]
            sampling.evaluate(mesh, sampling.sample(mesh, spacing, method, ok), ok=ok)

        rows.append(
            {
                "name": f"Sampling, {name}",
                "value": seconds(work) / sort,
                "unit": f"x argsort of {count} float32",
                "target": 6.0,  # half a second for a million triangles where the sort takes 85 ms
                "note": f"{count} {what}; validated, sampled and evaluated",
            }
        )
    return rows


if __name__ == "__main__":
    for row in run("--quick" in sys.argv):
        sys.stdout.write(f"{row['name']:50} {row['value']:6.2f} {row['unit']}; {row['note']}\n")
