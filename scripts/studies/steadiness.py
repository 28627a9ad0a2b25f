"""What dollies and orbits flicker beyond what moves: the table of docs/notes/techniques.md, "Steadiness".

    python -m scripts.studies.steadiness [--data DIR] [--only NAME ...] [--size 128] [--frames 7] [--pixels 0.7]
        [--lattices 8] [--every]

Each scene is drawn by the visibility buffer with 17 sub-samples a pixel, by a camera that nears it and by one that
turns about it, so many pixels a frame at most; and with `--lattices` times as many, as a truth. What a frame differs by
from its truth is the error of sampling; what that changes from frame to frame is flicker. Beside it stand what as many
independent samples of each pixel would flicker (the root of two times their error), what the truth itself changes, and
the flicker of four lattices. Jumps are the greatest changes of the error's mean over the picture and over a block of 8
by 8 pixels; the last column is what 4.5 standard deviations of independent samples are there.
DIR holds real meshes; scenes whose files are missing are left out. --every prints each frame's means.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np

from pointsplat_addon.core.numeric.lattice import MANY
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.prepare import hierarchies
from scripts.benchmarks.beside_cycles.landscape import landscape
from scripts.benchmarks.defocus import scan
from scripts.scenes import build, drawing
from scripts.scenes import steadiness as steady
from scripts.scenes.meshes import with_smooth_normals
from scripts.studies import technique_error

PLACES = 64  # of single samples, for the variance of one


@dataclass(frozen=True)
class Moves:
    """A scene, and from where it is seen: a direction, a distance to the origin, degrees across the picture."""

    scene: Scene
    direction: tuple[float, float, float]
    distance: float
    angle: float
    nodes: bool = False

    def cameras(self, size: int, frames: int, pixels: float) -> dict[str, list[Camera]]:
        lens = {"field_of_view": self.angle, "near": 1e-3 * self.distance, "far": 20 * self.distance}
        return {
            "dolly": steady.dolly(self.direction, self.distance, pixels, frames, size, **lens),
            "orbit": steady.orbit(self.direction, self.distance, pixels, frames, size, **lens),
        }


@contextmanager
def nodes_of_balls(drawn: bool) -> Iterator[None]:
    """Whether clouds of balls have nodes, whatever these cost."""
    least = 0 if drawn else 1 << 40
    with mock.patch.multiple(hierarchies, BALL_TREE_COST=least, BALLS_PER_PIXEL=least):
        yield


# ---------------------------------------------------------------------------- scenes


def lit(*things: tuple[Geometry, np.ndarray], **more) -> Scene:
    return build.scene(*things, lights=[build.sun(3.0, (0.45, 0.6, -0.8))], world=World(np.full(3, 0.1)),
                       transparent=True, **more)  # fmt: skip


def hills(data: Path) -> Moves:
    """A scan of a hundred thousand balls."""
    position, color, spacing = landscape(100_000)
    radii = np.full((len(position), 1), spacing / 2, np.float32)
    balls = build.points("steady hills", PointCloud(position, color=color, radii=radii))
    return Moves(lit((balls, np.eye(4))), (0.4, -0.75, 0.4), 85.0, 50.0)


def dragon(data: Path) -> Moves:
    mesh = scan(data / "dragon_vrip_res2.ply.gz")
    with np.errstate(invalid="ignore"):  # some vertices belong to no triangle
        mesh = with_smooth_normals(mesh.key, mesh.position.astype(np.float64), mesh.triangles.astype(int))
    return Moves(lit((build.mesh(mesh), build.moved((0, 0, -0.7)))), (0.5, -1.0, 0.4), 4.2, 35.0)


def maple(data: Path) -> Moves:
    of = technique_error.model(data / "japaneseMaple/japaneseMaple.obj")
    return Moves(of.scene, (0.5, -1.0, 0.45), 3.5, 35.0)


def fur(data: Path) -> Moves:
    """Two thousand hairs on a ball, thinner than pixels."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(2000, 3))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    bend = 0.25 * rng.normal(size=root.shape)
    step = np.linspace(0, 1, 6)[:, None]
    hairs = [r * (0.7 + 0.3 * step) + b * step**2 for r, b in zip(root, bend, strict=True)]
    return Moves(lit((build.strand_lines("steady fur", hairs, 0.002), np.eye(4))), (0.5, -1.0, 0.4), 4.0, 35.0)


def instances(data: Path) -> Moves:
    """A dozen clouds of thirty thousand balls, through nodes."""
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(30_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = (direction * (1 + 0.1 * np.sin(6 * direction[:, :1]) * np.sin(5 * direction[:, 1:2]))).astype(np.float32)
    color = (0.5 + 0.45 * np.sin(4 * direction + [0, 1, 2])).astype(np.float32)
    cloud = PointCloud(position, color=color, radii=np.full((len(position), 1), 0.012, np.float32))
    ball = build.points("steady cloud", cloud)
    things = [(ball, build.moved((2.2 * (i % 4) - 3.3, 2.6 * (i // 4) - 2.6, 0.3 * (i % 3)))) for i in range(12)]
    return Moves(lit(*things), (0.3, -1.0, 0.55), 17.0, 35.0, nodes=True)


SCENES: dict[str, tuple[Callable[[Path], Moves], str]] = {
    "hills": (hills, ""),
    "instances": (instances, ""),
    "dragon": (dragon, "dragon_vrip_res2.ply.gz"),
    "maple": (maple, "japaneseMaple"),
    "fur": (fur, ""),
}


# ---------------------------------------------------------------------------- figures


def measure(of: Moves, cameras: list[Camera], lattices: int, every: bool) -> tuple[steady.Steadiness, float]:
    """The figures of one lattice, and the flicker of four over that of one."""
    renderer = drawing.opengl()
    renderer.store.clear()
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
    with nodes_of_balls(False):
        truth = steady.frames(renderer, of.scene, cameras, settings, lattices * MANY.count)
        single = steady.variance(renderer, of.scene, cameras[0], settings, PLACES)
    with nodes_of_balls(of.nodes):
        renderer.store.clear()
        found = {n: steady.frames(renderer, of.scene, cameras, settings, n * MANY.count) for n in (1, 4)}
    if every:
        report(found[1], truth)
    one, four = (steady.steadiness(found[n], truth, single, n * MANY.count) for n in (1, 4))
    return one, four.flicker / one.flicker


def report(found: list[np.ndarray], truth: list[np.ndarray]) -> None:
    for k, (x, t) in enumerate(zip(found, truth, strict=True)):
        sys.stdout.write(f"  {k:2}: d {np.round((x - t).mean(axis=(0, 1)), 5)} t {np.round(t.mean(axis=(0, 1)), 5)}\n")


HEAD = ["scene", "camera", "flicker", "of independent samples", "of motion", "four lattices over one",
        "jump of the mean", "of a block", "independent"]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path())
    parser.add_argument("--only", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--frames", type=int, default=7)
    parser.add_argument("--pixels", type=float, default=0.7)
    parser.add_argument("--lattices", type=int, default=8)
    parser.add_argument("--every", action="store_true")
    options = parser.parse_args()
    sys.stdout.write(f"| {' | '.join(HEAD)} |\n{'|---' * len(HEAD)}|\n")
    for name in options.only:
        make, needed = SCENES[name]
        if needed and not (options.data / needed).exists():
            continue
        of = make(options.data)
        for move, cameras in of.cameras(options.size, options.frames, options.pixels).items():
            one, fall = measure(of, cameras, options.lattices, options.every)
            figures = [f"{v:.2f}" for v in (one.share(), one.flicker / one.own, fall)]
            jumps = [f"{one.mean:.4f}", f"{one.block:.3f}", f"{one.random_block:.3f}"]
            sys.stdout.write(f"| {' | '.join([name, move, f'{one.flicker:.4f}', *figures, *jumps])} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
