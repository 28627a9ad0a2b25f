"""What a picture costs as points, instances, triangles or objects grow, from the same view, by the visibility buffer.

python -m scripts.benchmarks.scale [--data DIR] [--quick] [--shadows] [--only NAME] [--pictures FOLDER] [--plot FILE]

DIR/mesh/dragon_vrip_res2.ply.gz is Stanford's dragon; without --data the scene that it makes is left out.

Processor time of a further picture, from a moved camera, and the exponent a of cost ~ n^a over each pair of sizes. With
--plot, which needs matplotlib, curves with the exponent that fits all of their sizes best.
"""

from __future__ import annotations

import argparse
import gzip
import re
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import MaterialTable, default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.frame.report import report
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.frame import MeteredDevice, Stopwatch
from scripts.benchmarks.instances import look_at, save
from scripts.common import tower
from scripts.scenes.meshes import small_tower

SIZE = (640, 360)  # pixels
SAMPLES = 16
FOCAL = 2.0  # distance of the picture over half its height


class BusyDevice(MeteredDevice):
    """Times passes by the processor."""

    timed = True

    def start_timer(self):
        return Stopwatch(self, time.process_time)


class Measured:
    """Draws pictures of scenes."""

    def __init__(self, shadows: bool) -> None:
        self.device = BusyDevice()
        self.renderer = Renderer(self.device)
        self.settings = Settings(technique="VISIBILITY", use_shadows=shadows)

    def picture(self, scene: Scene, camera: Camera) -> dict[str, Any]:
        """Draws a picture until the device has finished it; processor seconds, by pass too, and its pixels."""
        request = Request(camera, self.settings, frozenset({"combined"}), SAMPLES)
        uploaded, start = self.device.uploaded, time.process_time()
        frame = self.renderer.start(scene, request)
        prepared = time.process_time() - start
        while frame.sample():
            pass
        self.device.finish()
        seconds = time.process_time() - start
        told, pixels = report(frame, seconds), frame.pixels()["combined"]
        frame.release()
        return {
            "seconds": seconds, "prepare": prepared, "image": pixels, "triangles": told["triangles"],
            "uploaded": self.device.uploaded - uploaded, "cut": told["points"]["cut"],
            "passes": {p["name"]: p["ms"] / 1e3 for p in told["passes"]},
        }  # fmt: skip


def camera(eye: npt.ArrayLike, target: npt.ArrayLike, near: float = 0.01, far: float = 1000.0) -> Camera:
    depth = -(far + near) / (far - near), -2 * far * near / (far - near)
    clip = np.array([[FOCAL * SIZE[1] / SIZE[0], 0, 0, 0], [0, FOCAL, 0, 0], [0, 0, *depth], [0, 0, -1.0, 0]])
    return Camera(look_at(np.asarray(eye, float), np.asarray(target, float)), clip, SIZE, near=near, far=far)


def lit(geometries: list[Geometry], instances: Instances, table: MaterialTable | None = None) -> Scene:
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-0.48, -0.6, -0.64]))
    table = default_materials() if table is None else table
    return Scene(tuple(geometries), instances, table, (sun,), World(np.array([0.25, 0.3, 0.4])))


def hills(count: int) -> PointCloud:
    """Balls on a wavy unit square."""
    rng = np.random.default_rng(0)
    x, y = rng.random((2, count)) - 0.5
    z = 0.06 * np.sin(2 * np.pi * x) * np.cos(4 * np.pi * y) + 0.02 * np.sin(10 * np.pi * x)
    position = np.stack([x, y, z], axis=1).astype(np.float32)
    return PointCloud(position, radii=np.full((count, 1), 0.8 / np.sqrt(count), np.float32),
                      color=(0.3 + 0.7 * rng.random((count, 3))).astype(np.float32))  # fmt: skip


def squares(side: int) -> np.ndarray:
    """Matrices (side^2, 4, 4) that fill the unit square with smaller ones."""
    x, y = (a.ravel() for a in np.meshgrid(*[(np.arange(side) + 0.5) / side - 0.5] * 2))
    matrix = np.tile(np.diag([1 / side, 1 / side, 1 / side, 1.0]), (side * side, 1, 1))
    matrix[:, 0, 3], matrix[:, 1, 3] = x, y
    return matrix


def points(side: int) -> tuple[Scene, Callable[[float], Camera]]:
    """A landscape of side^2 instances of a million balls."""
    cloud = Geometry("hills", "Hills", cloud=hills(1_000_000))
    scene = lit([cloud], Instances(np.zeros(side * side, np.int32), squares(side)))
    return scene, lambda moved: camera([0.1 + moved, -0.9, 0.35], [0, -0.05, 0])


def tower_materials() -> MaterialTable:
    table = default_materials()
    rows = np.zeros(len(tower.COLORS), int)
    return replace(
        table,
        **{name: getattr(table, name)[rows] for name in ("roughness", "metallic", "ior", "specular", "emission")},
        **{name: getattr(table, name)[rows] for name in ("alpha", "cull", "pass_index", "hash")},
        base_color=np.array(tower.COLORS, np.float32), names=("Wall", "Glass", "Lit", "Roof"), graphs=(None,) * 4,
    )  # fmt: skip


def city(side: int, street: bool) -> tuple[Scene, Callable[[float], Camera]]:
    """side^2 towers; the camera stands in a street in the middle, or sees all of them from above in the same way."""
    geometry, matrices = Geometry("tower", "Tower", mesh=small_tower("tower")), tower.grid(side)
    scene = lit([geometry], Instances(np.zeros(len(matrices), np.int32), matrices), tower_materials())
    if street:
        # Between two columns of towers.
        x = 0.0 if side % 2 == 0 else tower.SPACING / 2
        return scene, lambda moved: camera([x + 0.02 + moved, -0.5, 0.05], [x, 5.0, 0.4])
    extent = side * tower.SPACING
    return scene, lambda moved: camera(
        extent * np.array([0.3 + moved, -0.8, 0.6]), [0, 0, -0.05 * extent], 0.01 * extent, 10 * extent
    )


def blob(number: int, rings: int = 10) -> Mesh:
    """A bumpy ball of its own."""
    rng = np.random.default_rng(number)
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.arange(rings) / rings * 2 * np.pi, indexing="ij")
    radius = np.ones_like(theta)
    for k, (a, p) in enumerate(rng.random((3, 2)), 1):
        radius += 0.3 * a * np.sin(k * theta + p) * np.cos(k * phi)
    at = (
        np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1) * radius[..., None]
    )
    index = np.arange((rings + 1) * rings).reshape(rings + 1, rings)
    a, b, c, d = index[:-1], np.roll(index[:-1], -1, 1), index[1:], np.roll(index[1:], -1, 1)
    triangles = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    position = at.reshape(-1, 3).astype(np.float32)
    normal = (position / np.linalg.norm(position, axis=1, keepdims=True)).astype(np.float32)
    return Mesh(f"blob {number}", f"Blob {number}", position, triangles.astype(np.int32), vertex_normal=normal,
                materials=(0,), topology=f"blob {number}")  # fmt: skip


def objects(side: int) -> tuple[Scene, Callable[[float], Camera]]:
    """side^2 different meshes of 200 triangles on a square."""
    geometries = [Geometry(f"blob {n}", f"Blob {n}", mesh=blob(n)) for n in range(side * side)]
    matrices = squares(side) @ np.diag([0.3, 0.3, 0.3, 1.0])
    scene = lit(geometries, Instances(np.arange(side * side, dtype=np.int32), matrices))
    return scene, lambda moved: camera([0.1 + moved, -0.9, 0.35], [0, -0.05, 0])


def dragon(folder: Path, splits: int) -> tuple[Scene, Callable[[float], Camera]]:
    """The dragon, with its triangles split into four so many times."""
    lines = gzip.decompress((folder / "dragon_vrip_res2.ply.gz").read_bytes()).decode().split("end_header\n")
    counts = {name: int(number) for _, name, number in re.findall(r"(element) (\w+) (\d+)", lines[0])}
    numbers = np.array(lines[1].split(), np.float64)
    vertices = 3 * counts["vertex"]
    position = numbers[:vertices].reshape(-1, 3)
    triangles = numbers[vertices:].reshape(-1, 4)[:, 1:].astype(np.int64)
    for _ in range(splits):
        a, b, c = triangles.T
        edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        code, at = np.unique(edges[:, 0] * len(position) + edges[:, 1], return_inverse=True)
        middle = (position[code // len(position)] + position[code % len(position)]) / 2
        ab, bc, ca = (at + len(position)).reshape(3, -1)
        position = np.concatenate([position, middle])
        triangles = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    mesh = Mesh(f"dragon {splits}", "Dragon", position.astype(np.float32), triangles.astype(np.int32), materials=(0,),
                topology=f"dragon {splits}")  # fmt: skip
    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    scene = lit([Geometry(f"dragon {splits}", "Dragon", mesh=mesh)], Instances(np.zeros(1, np.int32), upright[None]))
    return scene, lambda moved: camera([moved - 0.01, -0.35, 0.15], [-0.01, 0, 0.12], 0.01, 10.0)


Sizes = dict[int, Callable[[], tuple[Scene, Callable[[float], Camera]]]]


def cases(quick: bool, data: Path | None) -> dict[str, Sizes]:
    """Scenes by what grows, and by how many of it there are; of triangles only where there is a folder of data."""
    found: dict[str, Sizes] = {
        "points": {side * side * 1_000_000: lambda side=side: points(side) for side in (1, 3, 10)},
        "street": {side * side: lambda side=side: city(side, True) for side in (32, 100, 316, 1000)},
        "above": {side * side: lambda side=side: city(side, False) for side in (32, 100, 316, 1000)},
        "objects": {side * side: lambda side=side: objects(side) for side in (32, 100)},
    }
    if data is not None:
        meshes = data / "mesh"
        found["triangles"] = {202_520 * 4**n: lambda n=n: dragon(meshes, n) for n in (0, 1, 2, 3)}
    return {name: dict(list(sizes.items())[: 2 if quick else None]) for name, sizes in found.items()}


def plotted(curves: dict[str, list[tuple[int, float]]], path: Path) -> None:
    """Saves curves of sizes and seconds, with the exponent of each, fitted by least squares."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4.5), layout="constrained")
    for name, points in curves.items():
        count, seconds = np.array(points).T
        exponent = np.polyfit(np.log(count), np.log(seconds), 1)[0] if len(points) > 1 else 0.0
        axes.plot(count, seconds, marker="o", label=f"{name}: n^{exponent:.2f}")
    axes.set(xscale="log", yscale="log", xlabel="points, instances, objects or triangles", ylabel="processor seconds")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two sizes of each")
    parser.add_argument("--shadows", action="store_true")
    parser.add_argument("--only", action="append", metavar="NAME")
    parser.add_argument("--most", type=int, default=1 << 60, help="leave larger sizes out")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder with mesh/dragon_vrip_res2.ply.gz")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    parser.add_argument("--plot", type=Path, metavar="FILE")
    options = parser.parse_args()
    measured = Measured(options.shadows)
    curves: dict[str, list[tuple[int, float]]] = {}
    for name, sizes in cases(options.quick, options.data).items():
        if options.only and name not in options.only:
            continue
        before = None
        for count, make in sizes.items():
            if count > options.most:
                continue
            scene, view = make()
            first = measured.picture(scene, view(0.0))
            step = 0.001
            turns = [measured.picture(scene, view(step * i)) for i in (1, 2, 3)]
            found = min(turns, key=lambda turn: turn["seconds"])
            told = " ".join(f"{k} {v:.3f}" for k, v in found["passes"].items())
            grown = (
                "" if before is None else f"a {np.log(found['seconds'] / before[1]) / np.log(count / before[0]):.2f}"
            )
            sys.stdout.write(
                f"{name:10} {count:10} first {first['seconds']:.2f} further {found['seconds']:.3f} {grown} "
                f"prepare {found['prepare']:.3f} triangles {found['triangles']} cut {found['cut']} "
                f"uploaded {found['uploaded'] / 1e6:.1f} MB: {told}\n"
            )
            sys.stdout.flush()
            before = count, found["seconds"]
            curves.setdefault(name, []).append(before)
            if options.pictures is not None:
                save(options.pictures / f"{name}_{count}.png", first["image"])
    if options.plot is not None:
        plotted(curves, options.plot)
    measured.renderer.release()
    measured.device.release()


if __name__ == "__main__":
    main()
