"""What image space chooses between points and triangles, against all points and all triangles, as ratios of processor
time.

    python -m scripts.benchmarks.hybrid [--quick]

The three take turns, sample by sample, in one process; software renderers work on the process's own threads, so that
its processor time is what drawing cost, whatever else the machine does. The figures of the device are measured first.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import default_materials as materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.budget.calibrate import calibrate
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks import instances as bench_instances
from scripts.benchmarks.frame import row

SIZE = (512, 512)  # pixels
SETTINGS = Settings(technique="IMAGE_SPACE", use_shadows=False, use_adaptive_sampling=False)
KINDS = ("AUTO", "POINTS", "POLYGONS")
SAMPLES = 4  # of each picture
DENSE = 700  # rings and half the segments of the dense ball: a million triangles
LIMIT = "<= 1.1"  # of the cheaper one of all points and all triangles


def ball(rings: int) -> Mesh:
    """A ball with bumps: 2 rings (2 rings - 2) triangles."""
    polar, around = np.meshgrid(
        np.pi * np.arange(rings + 1) / rings, np.pi * np.arange(2 * rings) / rings, indexing="ij"
    )
    p = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1).reshape(-1, 3)
    p *= 1 + 0.06 * np.prod(np.sin(7 * p), axis=1, keepdims=True)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij"))
    at, right = 2 * rings * i, (j + 1) % (2 * rings)
    a, b, c, d = at + j, at + 2 * rings + j, at + 2 * rings + right, at + right
    triangles = np.concatenate([np.stack([a, b, c], 1)[i < rings - 1], np.stack([a, c, d], 1)[i > 0]])
    normal = p / np.linalg.norm(p, axis=1, keepdims=True)
    key = f"bench ball {rings}"
    return Mesh(key, key, p.astype(np.float32), triangles.astype(np.int32), vertex_normal=normal.astype(np.float32))


def plane(size: float, cells: int) -> Mesh:
    """A square of cells^2 pairs of triangles in XY."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-size, size, cells + 1)] * 2))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    low = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    quad = np.stack([low, low + 1, low + cells + 2, low + cells + 1], axis=1)
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)
    key = f"bench plane {size} {cells}"
    normal = np.tile(np.array([0, 0, 1], np.float32), (len(position), 1))
    return Mesh(key, key, position, triangles, vertex_normal=normal)


def camera(eye: tuple[float, float, float], target: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    near, far, focal = 0.01, 500.0, 1.8
    clip = np.array(
        [[focal, 0, 0, 0], [0, focal, 0, 0], [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
         [0, 0, -1.0, 0]]
    )  # fmt: skip
    view = bench_instances.look_at(np.array(eye, float), np.array(target, float))
    return Camera(view, clip, SIZE, near=near, far=far)


def scan(count: int) -> Geometry:
    """Points on a ball, as a scanner leaves them."""
    from pointsplat_addon.core.scene.cloud import PointCloud
    from scripts.benchmarks.frame import sphere

    position, color = sphere(count)
    radii = np.full((count, 1), 2.5 / np.sqrt(count), np.float32)
    return Geometry("bench scan", "Scan", cloud=PointCloud(position, normal=position, radii=radii, color=color))


def scene(*things: tuple[Geometry, np.ndarray]) -> Scene:
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-0.48, 0.6, -0.64]))
    geometries = tuple(geometry for geometry, _ in things)
    instances = Instances(np.arange(len(things), dtype=np.int32), np.stack([matrix for _, matrix in things]))
    return Scene(geometries, instances, materials(), (sun,), World(np.full(3, 0.3)))


def mesh(of: Mesh) -> Geometry:
    return Geometry(of.key, of.name, mesh=of)


def moved(x: float, y: float, z: float, scale: float = 1.0) -> np.ndarray:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


def cases(quick: bool) -> dict[str, tuple[Callable[[], Scene], Camera]]:
    rings, count = (220, 100_000) if quick else (DENSE, 1_000_000)
    side = 6 if quick else 20
    dense = ball(rings)
    one = moved(0, 0, 0)
    return {
        "dense mesh, far": (lambda: scene((mesh(dense), one)), camera((6, -18, 6))),
        "dense mesh, whole": (lambda: scene((mesh(dense), one)), camera((1, -3.5, 1))),
        "dense mesh, near": (lambda: scene((mesh(dense), one)), camera((0.3, -1.25, 0.3), (0, 0, 0.2))),
        "field to the horizon": (lambda: scene((mesh(plane(20, rings)), one)), camera((0, -19.5, 1.2), (0, -10, 0))),
        "scan on two triangles": (
            lambda: scene((mesh(plane(3, 1)), moved(0, 0, -1)), (scan(count), one)), camera((1, -4, 1.5))
        ),
        f"towers, {side}x{side}": (
            lambda: bench_instances.scene(side, bench_instances.mesh()),
            bench_instances.camera(side, "above", 0.0, SIZE),
        ),
        "mixed": (
            lambda: scene(
                (mesh(plane(8, 2)), moved(0, 0, -1)), (mesh(dense), one), (mesh(ball(24)), moved(1.5, -1, -0.6, 0.4)),
                (scan(count // 4), moved(-2, 0.5, 0)),
            ),
            camera((1, -5, 1.5)),
        ),
    }  # fmt: skip


def as_kind(of: Scene, kind: str) -> Scene:
    """All meshes as `kind`."""
    return replace(of, geometries=tuple(g if g.mesh is None else replace(g, primitive=kind) for g in of.geometries))


def seconds(renderer: Renderer, of: Scene, view: Camera, turns: int) -> tuple[dict[str, float], dict[str, str]]:
    """Median processor seconds of a picture of each kind, preparing included, and what it draws."""
    request = Request(view, SETTINGS, frozenset({"combined"}), SAMPLES)
    scenes = {kind: as_kind(of, kind) for kind in KINDS}
    spent: dict[str, list[float]] = {kind: [] for kind in KINDS}
    drawn: dict[str, str] = {}
    for turn in range(turns + 1):
        for kind, one in scenes.items():
            start = time.process_time()
            report: dict[str, Any] = renderer.render(one, request).report
            if turn > 0:  # the first compiles, samples and uploads
                spent[kind].append(time.process_time() - start)
            drawn[kind] = f"{report['points']['cut']:,} + {report['triangles']:,}"
    return {kind: statistics.median(times) for kind, times in spent.items()}, drawn


def run(quick: bool = False) -> tuple[list[dict], dict]:
    """(rows of name, value, unit, target and note; tables of text by title)."""
    renderer = Renderer(OpenGLDevice())
    table = [["scene", "AUTO: points + triangles", "all points", "all triangles", "AUTO / points", "AUTO / triangles"]]
    rows = []
    try:
        costs = renderer.costs = calibrate(renderer, time.process_time)
        for name, (make, view) in cases(quick).items():
            renderer.store.clear()
            found, drawn = seconds(renderer, make(), view, 3 if quick else 5)
            by_points, by_triangles = (found["AUTO"] / found[kind] for kind in ("POINTS", "POLYGONS"))
            table.append([name, *(drawn[kind] for kind in KINDS), f"{by_points:.2f}", f"{by_triangles:.2f}"])
            note = f"points {by_points:.2f}, triangles {by_triangles:.2f}"
            rows.append(row(f"hybrid, {name}", max(by_points, by_triangles), "x", LIMIT, note))
            sys.stdout.write("  ".join(table[-1]) + "\n")
            sys.stdout.flush()
            renderer.kept.clear()
        figures = ", ".join(f"{name} {value:.3g}" for name, value in vars(costs).items())
        return rows, {f"Points or triangles, splats + triangles a sample ({figures} ns)": table}
    finally:
        renderer.release()
        renderer.device.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="smaller meshes")
    rows, tables = run(parser.parse_args().quick)
    for r in rows:
        sys.stdout.write(f"{r['name']:40} {r['value']:.2f} {r['unit']} {r['target']} {r['note']}\n")
    for title, lines in tables.items():
        sys.stdout.write(f"\n{title}\n")
        for line in lines:
            sys.stdout.write("  ".join(f"{cell:>22}" for cell in line) + "\n")


if __name__ == "__main__":
    main()
