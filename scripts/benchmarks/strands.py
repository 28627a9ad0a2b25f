"""Speed of strands, as ratios of processor time within one run.

python -m scripts.benchmarks.strands [--quick]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.hierarchy import row
from scripts.scenes import build, cameras, clouds

STRANDS, POINTS, CLOUD, RESOLUTION = 50_000, 16, 1_000_000, 1024
ON_SCREEN = 0.9  # of the picture's width that both scenes fill
TIMES = 3


def groom(strands: int, key: str, radius: float = 5e-4) -> Geometry:
    """A ball of hair that grows outward and curls: `strands` of POINTS points, about a unit in radius. Where that is 10
    cm, hair is a tenth of a millimetre thick at its root."""
    rng = np.random.default_rng(0)
    root = 0.7 * clouds.sphere_points(strands)
    outward = root / np.linalg.norm(root, axis=1, keepdims=True)
    t = np.linspace(0, 1, POINTS)
    phase = rng.uniform(0, 2 * np.pi, (strands, 1, 1)) + 5 * t[None, :, None]
    side = np.cross(outward, rng.normal(size=(strands, 3)))[:, None]
    curl = 0.03 * t[None, :, None] * (np.cos(phase) * side + np.sin(phase) * np.cross(outward[:, None], side))
    bend = 0.1 * t[None, :, None] ** 2 * np.array([0, 0, -1.0])
    position = root[:, None] + 0.3 * t[None, :, None] * outward[:, None] + curl + bend
    radii = np.tile(radius * (1 - 0.9 * t), strands).astype(np.float32)
    start = np.arange(strands + 1) * POINTS
    lines = Strands(key, key, position.reshape(-1, 3).astype(np.float32), start, radii)
    return Geometry(key, key, strands=lines, primitive="LINES")


def ball(points: int) -> Geometry:
    """A cloud of as many disks that cover the unit sphere."""
    cloud: PointCloud = clouds.sphere_cloud(points)
    return build.points(f"ball of {points}", cloud)


def cpu(renderer: Renderer, scene: Scene, request: Request) -> float:
    """Seconds of processor time, of all threads, for one picture."""
    before = time.process_time()
    renderer.render(scene, request)
    return time.process_time() - before


def ratio(renderer: Renderer, ours: Scene, theirs: Scene, request: Request) -> tuple[float, float, float]:
    """The medians of pictures drawn in turns, and their ratio; what is kept for further pictures is there before."""
    for scene in (ours, theirs):
        renderer.render(scene, request)
    pairs = [(cpu(renderer, ours, request), cpu(renderer, theirs, request)) for _ in range(TIMES)]
    a, b = np.median(np.array(pairs), axis=0)
    return float(a), float(b), float(a / b)


def run(quick: bool = False) -> list[dict]:
    """Rows of the benchmark's table."""
    part = 10 if quick else 1
    size = RESOLUTION // (3 if quick else 1)
    renderer = Renderer(OpenGLDevice())
    hair = groom(STRANDS // part, "groom")
    cloud = ball(CLOUD // part)
    rows = []
    for technique, samples, target in (("IMAGE_SPACE", 1, "<= 2"), ("IMAGE_SPACE", 16, "<= 2"), ("EWA", 16, "")):
        for name, distance in (("filling the picture", 2.2 / ON_SCREEN), ("an eighth of its width", 17.6 / ON_SCREEN)):
            camera = cameras.camera((0, -distance, 0.3), resolution=(size, size), field_of_view=53.13)
            settings = Settings(technique=technique, use_shadows=False, use_adaptive_sampling=False)
            request = Request(camera, settings, frozenset({"combined"}), samples)
            ours, theirs = (build.scene((geometry, build.moved())) for geometry in (hair, cloud))
            a, b, both = ratio(renderer, ours, theirs, request)
            note = f"{STRANDS // part} x {POINTS} points, {samples} samples; {a:.2f} s against {b:.2f} s"
            near = name == "filling the picture"
            title = f"groom / cloud of {CLOUD // part} points, {technique}, {name}"
            rows.append(row(title, both, "x", target if near else "", note))
    renderer.release()
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    for found in run(parser.parse_args().quick):
        print(found)
