"""Pictures a second of a viewport whose view orbits, on moderngl's device: what a user sees who turns a scan or a mesh.

    python -m scripts.benchmarks.viewport [--only NAME ...] [--size WxH] [--frames N] [--passes] [--picture FOLDER]
        [--still]

Hills of balls and of triangles under a sun with shadows, one lattice of few sub-samples, as host/viewport.py asks for
while the view moves. A frame is planned, drawn and finished on the device, and not read back. Without --passes nothing
waits between passes. --still: instead, what a view takes that stands still, until its first picture and its last one,
and with lattices of few sub-samples alone.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pointsplat_addon.core.numeric.lattice import FEW
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.beside_cycles.landscape import WIDE, ground, landscape
from scripts.benchmarks.frame import MeteredDevice, Stopwatch

SAMPLES = 16  # of a view that stands still
TURN = 0.03  # radians of the orbit from frame to frame
EYE, TARGET = np.array([34.0, -62.0, 34.0]), np.array([0.0, 2.0, -2.0])  # metres
FOCAL = 1 / np.tan(np.radians(25.0))  # distance of the picture over half its width
NEAR, FAR = 0.05, 500.0
LONGEST_WAIT = 60.0  # seconds for nodes to be built on their thread


def orbiting(angle: float, size: tuple[int, int]) -> Camera:
    """The camera that looks at the hills, turned about a vertical axis."""
    cos, sin = np.cos(angle), np.sin(angle)
    eye = TARGET + np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ (EYE - TARGET)
    back = (eye - TARGET) / np.linalg.norm(eye - TARGET)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(back, right), back
    view[:3, 3] = -view[:3, :3] @ eye
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = FOCAL, FOCAL * size[0] / size[1]
    clip[2, 2:] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
    clip[3, 2] = -1.0
    return Camera(view, clip, size, near=NEAR, far=FAR)


def balls(count: int) -> Geometry:
    """The hills of scripts/benchmarks/beside_cycles."""
    position, color, spacing = landscape(count)
    cloud = PointCloud(position, radii=np.full((count, 1), spacing / 2, np.float32), color=color)
    return Geometry(f"{count} balls", "Scan", cloud=cloud)


def triangles(count: int) -> Geometry:
    """Smooth hills of so many triangles, without boxes on them."""
    side = round((count / 2) ** 0.5)
    at = np.linspace(-WIDE / 2, WIDE / 2, side + 1)
    x, y = np.meshgrid(at, at)
    position = np.stack([x, y, ground(x, y)], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1)
    quads = corner + np.array([0, 1, side + 2, side + 1])
    rows = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)
    step = at[1] - at[0]
    slope_x = (ground(x + step, y) - ground(x - step, y)) / (2 * step)
    slope_y = (ground(x, y + step) - ground(x, y - step)) / (2 * step)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    name = f"{count} triangles"
    return Geometry(name, "Mesh", mesh=Mesh(name, "Mesh", position, rows, vertex_normal=normal))


SCENES: dict[str, Callable[[], Geometry]] = {
    "balls-1M": lambda: balls(1_000_000),
    "triangles-1M": lambda: triangles(1_000_000),
    "balls-10M": lambda: balls(10_000_000),
}


def scene(geometry: Geometry) -> Scene:
    """The geometry under a sun that casts shadows, Lambert's material, a black world."""
    table = replace(default_materials(), specular=np.zeros(1, np.float32))
    lights = (Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-0.32, 0.55, -0.77])),)
    return Scene((geometry,), Instances(np.zeros(1, np.int32), np.eye(4)[None]), table, lights, World())


class Processor(MeteredDevice):
    """Times passes by the processor's clock, which other processes do not change."""

    def start_timer(self):
        return Stopwatch(self, time.process_time)


class Orbit:
    """Draws frames of a view that moves."""

    def __init__(self, renderer: Renderer, device: MeteredDevice, shown: Scene, size: tuple[int, int]) -> None:
        self._renderer, self._device, self._shown, self._size = renderer, device, shown, size
        self._steps = 0

    def frame(self) -> dict[str, float]:
        """Draws the next one; seconds by the clock and of the processor, and of each pass where they are timed."""
        request = Request(
            orbiting(TURN * self._steps, self._size), Settings(), frozenset({"combined"}), FEW.count, interactive=True
        )
        self._steps += 1
        start, busy = time.perf_counter(), time.process_time()
        frame = self._renderer.start(self._shown, request)
        planned = time.process_time()
        while frame.sample():
            pass
        self._device.finish()
        found = {"wall": time.perf_counter() - start, "processor": time.process_time() - busy, "plan": planned - busy}
        if self._device.timed:
            frame.clock.settle()
            found |= {name: 1e-3 * ms for name, ms in frame.clock.spent.items()}
        self.picture, self.primitives = frame.color, frame.frame_plan.splats + frame.frame_plan.triangles
        self.shown = self._device.read(self.picture) if self._steps == 1 else self.shown
        frame.release()
        return found

    def refine(self) -> float:
        """Draws until nodes stand for what is small, where they are built; returns the seconds."""
        start, before = time.perf_counter(), None
        self.frame()
        while time.perf_counter() - start < LONGEST_WAIT:
            self.frame()
            if before is not None and self.primitives < before:
                break
            before = self.primitives
        return time.perf_counter() - start


def still(renderer: Renderer, device: MeteredDevice, shown: Scene, size: tuple[int, int]) -> str:
    """What a view takes of the processor that stands still, once it has been drawn."""
    request = Request(orbiting(0.0, size), Settings(), frozenset({"combined"}), SAMPLES, interactive=True)

    def drawn(request: Request) -> tuple[Frame, float]:
        began = time.process_time()
        frame = renderer.start(shown, request)
        while frame.sample():
            pass
        device.finish()
        return frame, time.process_time() - began

    found = []
    for _ in range(2):  # the first time shaders are compiled
        first, of_first = drawn(replace(request, first=True))
        first.keep_shown()
        last, of_last = drawn(replace(request, following=True))
        first.release()
        last.release()
        few, of_few = drawn(request)
        few.release()
        found = [of_first, of_first + of_last, of_few]
    return "first picture {:.2f} s, last {:.2f} s; by lattices of few {:.2f} s of the processor\n".format(*found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--size", default="640x360", help="pixels")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--passes", action="store_true", help="finish the device after each pass, and time it")
    parser.add_argument("--picture", type=Path, help="folder for the first frame of each scene, NumPy files")
    parser.add_argument("--still", action="store_true", help="measure views that stand still")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    device = Processor()
    device.timed = options.passes
    renderer = Renderer(device)
    for name in options.only:
        if options.still:
            sys.stdout.write(f"{name}: {still(renderer, device, scene(SCENES[name]()), (width, height))}")
            continue
        orbit = Orbit(renderer, device, scene(SCENES[name]()), (width, height))
        first = orbit.frame()
        waited = orbit.refine() if name == "balls-10M" else 0.0
        orbit.frame()
        times = [orbit.frame() for _ in range(options.frames)]
        medians = {key: float(np.median([each.get(key, 0.0) for each in times])) for key in times[0]}
        sys.stdout.write(
            f"{name}: {1 / medians['wall']:.1f} frames a second, {1e3 * medians['wall']:.0f} ms a frame, "
            f"{1e3 * medians['processor']:.0f} of the processor, {orbit.primitives} drawn; first {first['wall']:.2f} s"
            + (f", nodes after {waited:.1f} s\n" if waited else "\n")
        )
        if options.passes:
            parts = {key: value for key, value in medians.items() if key not in ("wall", "processor")}
            parts["the rest"] = medians["processor"] - sum(parts.values())
            sys.stdout.write("  " + ", ".join(f"{key} {1e3 * value:.0f}" for key, value in parts.items()) + "\n")
        if options.picture:
            np.save(options.picture / f"{name}.npy", orbit.shown)
    renderer.release()
    device.release()


if __name__ == "__main__":
    main()
