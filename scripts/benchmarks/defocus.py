"""What depth of field costs: SPLAT from a pinhole to a wide lens, and against samples through the lens at equal error.

python -m scripts.benchmarks.defocus [--quick] [--scan FILE.ply[.gz]]

A plane of 262,144 points, and a scan: the vertices of FILE, with their triangles; without it a bumpy ball of as many
points. Times are of the processor, all threads, within one run.
"""

from __future__ import annotations

import argparse
import gzip
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pointsplat_addon.core.scene.camera import Aperture, Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.hierarchy import row
from scripts.scenes import build, cameras, clouds

SIDE = 512  # points of the plane, along each side
SIZE = 512  # pixels
APERTURES = (0.0, 0.005, 0.01, 0.03, 0.1, 0.2)  # radius of the lens
ON_PLANE, BEFORE = 3.5, 2.0  # distance of focus: in the middle of the plane, and before all of the scan
SAMPLES, TIMES = 16, 3
REFERENCE = 1024  # samples through the lens
NUMBERS = (8, 16, 32, 64, 128, 256)  # of samples through the lens, among which the one of equal error lies
EYE, TARGET = (0.0, -3.2, 1.6), (0.0, -0.2, 0.0)


def plane(side: int) -> PointCloud:
    """A chequered plane, each point a little lighter or darker."""
    u = (np.arange(side) + 0.5) / side * 4 - 2
    x, y = (a.ravel() for a in np.meshgrid(u, u))
    light = (np.floor(4 * x) + np.floor(4 * y)) % 2
    shade = 0.8 + 0.4 * np.random.default_rng(0).random(len(x))
    color = np.where(light[:, None] > 0, [0.8, 0.75, 0.6], [0.1, 0.15, 0.3]) * shade[:, None]
    return PointCloud(
        np.stack([x, y, 0 * x], axis=1).astype(np.float32),
        normal=np.tile(np.array([0, 0, 1], np.float32), (len(x), 1)),
        radii=np.full((len(x), 1), 2 / side * np.sqrt(2), np.float32),
        color=np.clip(color, 0, 1).astype(np.float32),
    )


def bumpy(count: int) -> PointCloud:
    """Instead of a scan."""
    normal = clouds.sphere_points(count)
    height = 1 + 0.1 * np.sin(9 * normal).prod(axis=1, keepdims=True)
    radii = np.full((count, 1), 2.2 / np.sqrt(count), np.float32)
    return PointCloud((normal * height).astype(np.float32), normal=normal.astype(np.float32), radii=radii)


def scan(path: Path) -> Mesh:
    """An ASCII PLY of triangles, one unit high, standing on its lowest point in the middle of the plane."""
    with (gzip.open if path.suffix == ".gz" else open)(path, "rt") as file:
        lines = file.read().split("\n")
    header = lines.index("end_header")
    counts = {words[1]: int(words[2]) for line in lines[:header] if (words := line.split())[:1] == ["element"]}
    rows = lines[header + 1 :]
    vertices = np.loadtxt(rows[: counts["vertex"]])[:, :3]
    faces = np.loadtxt(rows[counts["vertex"] : counts["vertex"] + counts["face"]], dtype=np.int32)[:, 1:4]
    vertices = vertices[:, [0, 2, 1]] * [1, -1, 1]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]) * (1.4 / (high[2] - low[2]))
    key = f"scan {path.name}"
    return Mesh(key, key, vertices.astype(np.float32), faces)


def camera(size: int, radius: float, focus: float) -> Camera:
    of = cameras.camera(EYE, TARGET, (size, size), field_of_view=58.0)
    return replace(of, aperture=Aperture(radius, focus) if radius > 0 else None)


def cpu(renderer: Renderer, scene: Scene, request: Request, times: int = TIMES) -> float:
    """Median seconds of processor time; what is kept for further pictures is there before."""
    renderer.render(scene, request)
    found = []
    for _ in range(times):
        before = time.process_time()
        renderer.render(scene, request)
        found.append(time.process_time() - before)
    return float(np.median(found))


def growth(renderer: Renderer, name: str, scene: Scene, focus: float, size: int) -> Iterator[dict]:
    """Time over that without a lens."""
    settings = Settings(use_shadows=False)
    passes = frozenset({"combined"})
    requests = {a: Request(camera(size, a, focus), settings, passes, SAMPLES) for a in APERTURES}
    none = cpu(renderer, scene, requests[0.0])
    for radius in APERTURES[1:]:
        spent = cpu(renderer, scene, requests[radius])
        title = f"depth of field / none, {name}, aperture {radius}"
        yield row(
            title, spent / none, "x", "<= 1.3", f"{SAMPLES} samples, {size} x {size}; {spent:.2f} s, {none:.2f} s"
        )


def without_levels(renderer: Renderer, name: str, scene: Scene, focus: float, size: int) -> Iterator[dict]:
    """Time with the widest lens where nodes may not be larger than a pixel, over that without a lens."""
    passes, settings, widest = frozenset({"combined"}), Settings(use_shadows=False), APERTURES[-1]
    none, wide = (Request(camera(size, radius, focus), settings, passes, SAMPLES) for radius in (0.0, widest))
    spent = cpu(renderer, scene, replace(wide, node=1e-9), 1)
    title = f"the same without level of detail, {name}, aperture {widest}"
    yield row(title, spent / cpu(renderer, scene, none), "x", "> 5", f"{spent:.2f} s")


def against_samples(
    renderer: Renderer, name: str, scene: Scene, focus: float, size: int, reference: int
) -> Iterator[dict]:
    """Time of as many samples through the lens as have the error of SPLAT, over SPLAT's."""
    passes = frozenset({"combined"})
    splat = Settings(use_shadows=False)
    lens = replace(splat, dof_method="LENS_SAMPLES")

    def picture(radius: float, settings: Settings, samples: int) -> np.ndarray:
        request = Request(camera(size, radius, focus), settings, passes, samples)
        return renderer.render(scene, request).pixels["combined"][..., :3]

    for radius in APERTURES[:2:-1]:
        exact = picture(radius, lens, reference)
        errors = [float(np.sqrt(((picture(radius, lens, n) - exact) ** 2).mean())) for n in NUMBERS]
        times = [cpu(renderer, scene, Request(camera(size, radius, focus), lens, passes, n), 1) for n in NUMBERS]
        best, note = 0.0, ""
        for samples in (1, 4, SAMPLES, 64):
            error = float(np.sqrt(((picture(radius, splat, samples) - exact) ** 2).mean()))
            spent = cpu(renderer, scene, Request(camera(size, radius, focus), splat, passes, samples), 1)
            # More than the largest number count as that.
            equal = float(np.exp(np.interp(-np.log(error), -np.log(np.maximum(errors, 1e-9)), np.log(times))))
            if equal / spent > best:
                best, note = (
                    equal / spent,
                    f"{samples} samples: RMSE {error:.4f} in {spent:.2f} s; lens samples {equal:.2f} s",
                )
        title = f"lens samples / splats at equal error, {name}, aperture {radius}"
        yield row(title, best, "x", ">= 10" if radius == APERTURES[-1] else "", note)


def things(quick: bool, path: Path | None) -> dict[str, tuple[Scene, float]]:
    """Scenes and their distances of focus."""
    side = SIDE // 4 if quick else SIDE
    of = build.points(f"plane of {side * side} points", plane(side))
    body = build.mesh(scan(path), "POINTS") if path else build.points("bumpy ball", bumpy(side * side))
    lights = (build.sun(2.5, (0.4, 0.5, -0.8)),)
    lift = build.moved((0, 0, -1.0), 1.8) if path else build.moved((0, 0, 0.1), 1.2)
    return {
        of.name: (build.scene((of, build.moved()), lights=()), ON_PLANE),
        path.stem.split(".")[0] if path else "bumpy ball": (build.scene((body, lift), lights=lights), BEFORE),
    }


def rows(quick: bool, path: Path | None) -> Iterator[dict]:
    """Rows of the benchmark's table, those that take longest last."""
    renderer = Renderer(OpenGLDevice())
    both = things(quick, path).items()
    size = SIZE // (4 if quick else 1)
    for name, (scene, focus) in both:
        yield from growth(renderer, name, scene, focus, size)
    for name, (scene, focus) in both:
        reference = 64 if quick else REFERENCE
        yield from against_samples(renderer, name, scene, focus, SIZE // (4 if quick else 2), reference)
    for name, (scene, focus) in both:
        yield from without_levels(renderer, name, scene, focus, size)
    renderer.release()


def run(quick: bool = False, path: Path | None = None) -> list[dict]:
    """Rows of the benchmark's table."""
    return list(rows(quick, path))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--scan", type=Path)
    given = parser.parse_args()
    for line in rows(given.quick, given.scan):
        print(line, flush=True)
