"""A cloud of smoke under one light, seen by a camera that moves: what the first frame costs and what the later ones do.

python -m scripts.benchmarks.translucent [--quick]
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.kernel import EVEN_SPACING
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.hierarchy import row

COUNT = 624_614  # points
SIZE = (600, 500)  # pixels
TURN = np.radians(1.0)  # of the camera from frame to frame
DEPTH = 4.0  # optical depth through the middle of the cloud


def smoke(count: int) -> PointCloud:
    """Balls that fill a unit ball evenly, of the spacing that `count` of them have."""
    rng = np.random.default_rng(0)
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = (direction * np.cbrt(rng.random((count, 1)))).astype(np.float32)
    volume = 4 / 3 * np.pi / count
    radius = 2 * EVEN_SPACING * np.cbrt(volume)
    share = DEPTH / 2 * volume / (4 / 3 * np.pi * radius**3)
    return PointCloud(
        position, radii=np.full((count, 1), radius, np.float32), extinction=np.full(count, share, np.float32)
    )


def scene(count: int) -> Scene:
    geometry = Geometry(f"smoke {count}", "Smoke", cloud=smoke(count))
    lamp = Light("POINT", np.full(3, 30.0), np.array([2.0, -2.0, 2.0]), np.array([0.0, 0.0, -1.0]), radius=0.05)
    return Scene((geometry,), Instances(np.zeros(1, np.int32), np.eye(4)[None]), default_materials(), (lamp,), World())


def camera(angle: float) -> Camera:
    cos, sin = np.cos(angle), np.sin(angle)
    view = np.array([[cos, 0, -sin, 0], [0, 1, 0, 0], [sin, 0, cos, -4], [0, 0, 0, 1.0]])
    near, far, focal = 0.1, 100.0, 2.5
    depth = -(far + near) / (far - near), -2 * far * near / (far - near)
    clip = np.array([[focal, 0, 0, 0], [0, focal * SIZE[0] / SIZE[1], 0, 0], [0, 0, *depth], [0, 0, -1.0, 0]])
    return Camera(view, clip, SIZE, near=near, far=far)


def frames(
    smoke_scene: Scene, settings: Settings, count: int, interactive: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of frames whose camera turns, the first with nothing kept; and what of them went into shadow tables."""
    device = OpenGLDevice()
    renderer = Renderer(device)

    def draw(what: Scene, angle: float) -> dict:
        request = Request(camera(angle), settings, frozenset({"combined"}), 1, interactive=interactive)
        return renderer.render(what, request).report

    # Shaders are compiled once in the life of a device, whatever is drawn: by another, smaller cloud.
    draw(scene(100), 0.0)
    times, tables = [], []
    for number in range(count):
        start = time.perf_counter()
        report = draw(smoke_scene, number * TURN)
        times.append(time.perf_counter() - start)
        tables.append(sum(p["ms"] for p in report["passes"] if p["name"] == "shadows") / 1e3)
    renderer.release()
    device.release()
    return np.array(times), np.array(tables)


def run(quick: bool = False) -> list[dict]:
    """Rows of name, value, unit, target and note. `quick` takes a tenth of the points."""
    count = COUNT // (10 if quick else 1)
    cloud = scene(count)
    what = f"{count:,} points of smoke, one light, {SIZE[0]}x{SIZE[1]}"
    found = []
    for name, interactive, target in (("viewport", True, ">= 3"), ("final picture", False, "")):
        times, tables = frames(cloud, Settings(), 8, interactive)
        bare, _ = frames(cloud, Settings(use_shadows=False), 8, interactive)
        later = float(np.median(times[1:]))
        spread = f"{1e3 * times[1:].min():.0f} to {1e3 * times[1:].max():.0f}"
        note = f"{1e3 * times[0]:.0f} ms against {1e3 * later:.0f} ms (median of {len(times) - 1}, {spread})"
        built = f"{1e3 * tables[0]:.0f} ms, then at most {1e3 * tables[1:].max():.2f} ms"
        found += [
            row(f"{what}, {name}, first frame / later ones", times[0] / later, "x", target, note),
            row(f"{name}, shadow tables, later frames / first", tables[1:].max() / tables[0], "x", "< 0.01", built),
            row(f"{name}, later frames, with shadows / without", later / float(np.median(bare[1:])), "x", "", ""),
        ]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the points")
    for entry in run(parser.parse_args().quick):
        sys.stdout.write("{name:70} {value:8.2f} {unit:4} {target:8} {note}\n".format(**entry))


if __name__ == "__main__":
    main()
