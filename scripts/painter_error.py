"""Error of each technique on a textured plane against its polygons, over the tolerance, at equal numbers of points.

python scripts/painter_error.py [--plot OUT.png]

Opaque disks are the painter's splats with rims as hard as numbers allow: ellipses, painted back to front.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from pointsplat_addon.core import expressions as ex
from pointsplat_addon.core import painter
from pointsplat_addon.core.kernel import POWER
from pointsplat_addon.core.materials import MaterialGraph
from pointsplat_addon.core.scene import Camera, Light, Scene, Settings, World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.frame import Renderer, Request
from pointsplat_addon.render.prepare import STORE
from scripts.compare import displayed, eroded
from tests.render import scenes

TOLERANCES = (0.5, 1.0, 2.0, 4.0, 8.0)  # pixels
TECHNIQUES = ("IMAGE_SPACE", "EWA", "PAINTER", "disks")
VIEWS = {"facing": (0.0, -4.0, 0.0), "oblique": (1.2, -3.2, 1.0)}
HARD = 1.03  # SUPPORT of disks
SIZE = 256  # pixels
RULED = (3, 5, 10, 20, 30, 50)  # of the plot's axis
TRUTH = 64  # samples of the polygons


@dataclass(frozen=True)
class Errors:
    """Of one picture. RMSE in steps of 8 bits of sRGB; alpha over that of the polygons; share of what lies behind that
    is seen within, in the mean and in the worst pixel, in the same steps."""

    points: int
    rmse: float
    alpha: float
    leak: float
    worst: float


def texture() -> ex.Image:
    """Waves, a checkerboard and squares of random values, in the three channels."""
    side = 256
    y, x = np.mgrid[0:side, 0:side] / side
    waves = 0.5 + 0.4 * np.sin(2 * np.pi * (10 * x + 3 * y))
    checker = (np.floor(16 * x) + np.floor(16 * y)) % 2 * 0.8 + 0.1
    squares = np.kron(np.random.default_rng(1).random((32, 32)), np.ones((8, 8)))
    return ex.Image(np.stack([waves, checker, squares, np.ones_like(x)], axis=-1).astype(np.float32))


def plane(primitive: str, eye: tuple[float, float, float]) -> tuple[Scene, Camera]:
    graph = MaterialGraph(base_color=ex.Color(ex.ImageTexture(ex.UV(), texture())))
    direction = np.array([0.2, 0.9, -0.3])
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), direction / np.linalg.norm(direction))
    scene = scenes.scene(
        (scenes.mesh(scenes.plane_mesh("errors of a plane", cells=8), primitive), scenes.moved()),
        lights=[sun],
        world=World(np.full(3, 0.2)),
        table=scenes.materials(graphs=(graph,), specular=[0]),
        transparent=True,
    )
    return scene, scenes.camera(eye, resolution=(SIZE, SIZE))


def picture(
    renderer: Renderer, primitive: str, view: str, technique: str, tolerance: float, samples: int
) -> tuple[np.ndarray, int]:
    """(SIZE, SIZE, 4), and how many points it was drawn of."""
    STORE.clear()
    renderer.release()
    support = HARD if technique == "disks" else painter.SUPPORT
    depth = math.log(2) / (1 - 1 / support) ** POWER
    settings = Settings("PAINTER" if technique == "disks" else technique, use_shadows=False)
    settings = replace(settings, tolerance=tolerance, use_adaptive_sampling=False)
    scene, camera = plane(primitive, VIEWS[view])
    with mock.patch.multiple(painter, SUPPORT=support, DEPTH=depth):
        result = renderer.render(scene, Request(camera, settings, frozenset({"combined"}), samples))
    return result.pixels["combined"], result.report["points"]["cut"]


def errors(found: np.ndarray, truth: np.ndarray, points: int) -> Errors:
    inside = eroded(eroded(eroded(truth[..., 3] > 0.9999)))
    rmse = float(np.sqrt(((displayed(found) - displayed(truth)) ** 2).mean()))
    through = 255 * (1 - found[..., 3][inside])
    return Errors(
        points,
        255 * rmse,
        float(found[..., 3].sum() / truth[..., 3].sum()),
        float(through.mean()),
        float(through.max()),
    )


def measure(renderer: Renderer, view: str, samples: int) -> dict[str, list[Errors]]:
    """By technique, for each tolerance."""
    truth, _ = picture(renderer, "POLYGONS", view, "IMAGE_SPACE", 1.0, TRUTH)
    return {
        technique: [
            errors(found, truth, points)
            for found, points in (
                picture(renderer, "POINTS", view, technique, tolerance, samples) for tolerance in TOLERANCES
            )
        ]
        for technique in TECHNIQUES
    }


def show(title: str, found: dict[str, list[Errors]]) -> None:
    """A table for docs/techniques.md."""
    print(f"\n{title}\n\n| tolerance | points | {' | '.join(TECHNIQUES)} | alpha | leak, worst |")
    print("|---" * (len(TECHNIQUES) + 4) + "|")
    for i, tolerance in enumerate(TOLERANCES):
        row, of = [f"{found[name][i].rmse:.2f}" for name in TECHNIQUES], found["PAINTER"][i]
        print(f"| {tolerance:g} | {of.points} | {' | '.join(row)} | {of.alpha:.4f} | {of.leak:.2f}, {of.worst:.1f} |")


def plot(found: dict[str, dict[str, list[Errors]]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(found), figsize=(4.2 * len(found), 3.6), sharey=True, layout="constrained")
    for axis, (title, curves) in zip(np.ravel(axes), found.items(), strict=True):
        for name, curve in curves.items():
            style = "--" if name == "disks" else "-"
            label = "opaque disks" if name == "disks" else name
            axis.loglog(TOLERANCES, [e.rmse for e in curve], style, marker="o", markersize=3, label=label)
        axis.set(
            title=title, xlabel="tolerance (pixels)", xticks=TOLERANCES, xticklabels=[f"{t:g}" for t in TOLERANCES]
        )
        axis.set(yticks=RULED, yticklabels=RULED)
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    np.ravel(axes)[0].set_ylabel("RMSE (1/255 of sRGB)")
    np.ravel(axes)[0].legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--plot", help="a picture of the curves")
    arguments = parser.parse_args()
    renderer, found = Renderer(OpenGLDevice()), {}
    for samples in (16, 1):
        for view in VIEWS:
            title = f"{view}, {samples} sample{'s' if samples > 1 else ''} a pixel"
            found[title] = measure(renderer, view, samples)
            show(title, found[title])
    if arguments.plot:
        plot(found, arguments.plot)


if __name__ == "__main__":
    main()
