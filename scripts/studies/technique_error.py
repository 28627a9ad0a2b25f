"""Error of each technique against the same scene's polygons, over the tolerance: a table, a plot, pictures.

    python -m scripts.studies.technique_error [--data DIR] [--plot OUT.png] [--pictures OUT.jpg] [--only NAME ...]

A plane with a picture on it, facing and oblique, and Spot (assets/spot). DIR holds japaneseMaple/japaneseMaple.obj, a
tree of thin leaves, and pedestrianRailing1/pedestrianRailing1.obj, thin bars: without it they are left out. Everything
is drawn as points, also what AUTO would draw as triangles. Opaque disks are the painter's splats with rims as hard as
numbers allow: ellipses, painted back to front.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from PIL import Image

from pointsplat_addon.core.material import image
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat import painter
from pointsplat_addon.core.splat.kernel import POWER
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import displayed, eroded
from scripts.scenes import build, cameras, meshes

ROOT = Path(__file__).resolve().parents[2]
TOLERANCES = (0.5, 1.0, 2.0, 4.0, 8.0)  # pixels
TECHNIQUES = ("IMAGE_SPACE", "EWA", "PAINTER", "VISIBILITY")
SAMPLES = (16, 1)
VIEWS = {"plane, facing": (0.0, -4.0, 0.0), "plane, oblique": (1.2, -3.2, 1.0)}
EYE = np.array([0.5, -1.0, 0.45])  # of models, from their middle
ANGLE = 35.0  # degrees of the models' view
HARD = 1.03  # SUPPORT of disks
SIZE = 256  # pixels
RULED = (2, 3, 5, 10, 20, 30, 50)  # of the plot's axis
TRUTH = 64  # samples of the polygons
SHOWN = 1.0, 16  # tolerance and samples of the pictures
BORDER = 6  # rows about what is shown
GAIN = 3.0  # of their differences


@dataclass(frozen=True)
class Errors:
    """Of one picture. RMSE in steps of 8 bits of sRGB, of all and of what lies within the silhouette; alpha over that
    of the polygons; share of what lies behind that is seen within, in the mean and in the worst pixel, in the same
    steps; seconds of processor time, the choice of points left out."""

    points: int
    rmse: float
    interior: float
    alpha: float
    leak: float
    worst: float
    seconds: float = 0.0


@dataclass(frozen=True)
class Subject:
    """What is drawn, and from where."""

    scene: Scene
    camera: Camera

    def drawn_as(self, primitive: str) -> Scene:
        geometries = tuple(replace(geometry, primitive=primitive) for geometry in self.scene.geometries)
        return replace(self.scene, geometries=geometries)


def texture() -> image.Image:
    """Waves, a checkerboard and squares of random values, in the three channels."""
    side = 256
    y, x = np.mgrid[0:side, 0:side] / side
    waves = 0.5 + 0.4 * np.sin(2 * np.pi * (10 * x + 3 * y))
    checker = (np.floor(16 * x) + np.floor(16 * y)) % 2 * 0.8 + 0.1
    squares = np.kron(np.random.default_rng(1).random((32, 32)), np.ones((8, 8)))
    return image.Image(np.stack([waves, checker, squares, np.ones_like(x)], axis=-1).astype(np.float32))


def plane(eye: tuple[float, float, float]) -> Subject:
    graph = MaterialGraph(base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), texture())))
    direction = np.array([0.2, 0.9, -0.3])
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), direction / np.linalg.norm(direction))
    scene = build.scene(
        (build.mesh(meshes.plane_mesh("errors of a plane", cells=8)), build.moved()),
        lights=[sun],
        world=World(np.full(3, 0.2)),
        table=build.materials(graphs=(graph,), specular=[0]),
        transparent=True,
    )
    return Subject(scene, cameras.camera(eye, resolution=(SIZE, SIZE)))


def model(path: Path, picture: Path | None = None) -> Subject:
    """A file that Blender reads, with its own materials, or with one whose base colour is a picture."""
    import bpy

    import pointsplat_addon

    pointsplat_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    from pointsplat_addon.host.sync import Synchronizer
    from scripts.studies import gallery

    _ = gallery.read(path) if picture is None else gallery.load(path, picture)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    eye = EYE / np.linalg.norm(EYE) * 1.05 / math.sin(math.radians(ANGLE) / 2)
    camera = cameras.camera(eye, resolution=(SIZE, SIZE), field_of_view=ANGLE)
    scene = Synchronizer().scene(depsgraph)
    sun = build.sun(3.0, camera.view_from_world[:3, :3].T @ (0.45, -0.5, -1.0))
    return Subject(replace(scene, lights=(sun,), world=World(np.full(3, 0.2)), transparent=True), camera)


def subjects(data: Path | None) -> dict[str, Callable[[], Subject]]:
    """By name."""
    spot = ROOT / "assets" / "spot"
    found: dict[str, Callable[[], Subject]] = {name: lambda eye=eye: plane(eye) for name, eye in VIEWS.items()}
    found["Spot"] = lambda: model(spot / "spot_triangulated.obj.gz", spot / "spot_texture.png")
    if data is not None:
        for name, folder in (("maple", "japaneseMaple"), ("railing", "pedestrianRailing1")):
            found[name] = lambda folder=folder: model(data / folder / f"{folder}.obj")
    return found


def picture(
    renderer: Renderer, subject: Subject, primitive: str, technique: str, tolerance: float, samples: int
) -> tuple[np.ndarray, int, float]:
    """(SIZE, SIZE, 4), how many points it was drawn of, seconds of processor time. Points that are finer than this
    tolerance asks for, from before, are used: see Store."""
    renderer.release()
    support = HARD if technique == "disks" else painter.SUPPORT
    depth = math.log(2) / (1 - 1 / support) ** POWER
    settings = Settings("PAINTER" if technique == "disks" else technique, use_shadows=False)
    settings = replace(settings, tolerance=tolerance, use_adaptive_sampling=False)
    scene = subject.drawn_as(primitive)
    prepare(
        scene, subject.camera, settings, samples, renderer.store
    )  # what is drawn is timed, not the choice of points
    with mock.patch.multiple(painter, SUPPORT=support, DEPTH=depth):
        before = time.process_time()
        result = renderer.render(scene, Request(subject.camera, settings, frozenset({"combined"}), samples))
        seconds = time.process_time() - before
    return result.pixels["combined"], result.report["points"]["cut"], seconds


def errors(found: np.ndarray, truth: np.ndarray, points: int, seconds: float = 0.0) -> Errors:
    interior = eroded(truth[..., 3] > 0.9999)
    inside = eroded(eroded(interior))
    squared = (displayed(found) - displayed(truth)) ** 2
    through = 255 * (1 - found[..., 3][inside])
    return Errors(
        points,
        255 * float(np.sqrt(squared.mean())),
        255 * float(np.sqrt(squared[interior].mean())) if interior.any() else math.nan,
        float(found[..., 3].sum() / truth[..., 3].sum()),
        float(through.mean()) if inside.any() else math.nan,
        float(through.max(initial=0.0)),
        seconds,
    )


@dataclass(frozen=True)
class Curves:
    """Of one subject."""

    errors: dict[tuple[str, int, float], Errors]  # by technique, samples and tolerance
    pictures: dict[str, np.ndarray]  # as SHOWN, and "polygons"

    def of(self, technique: str, samples: int) -> list[Errors]:
        return [self.errors[technique, samples, tolerance] for tolerance in TOLERANCES]


def measure(renderer: Renderer, subject: Subject, techniques: tuple[str, ...]) -> Curves:
    renderer.store.clear()
    truth, _, _ = picture(renderer, subject, "POLYGONS", "IMAGE_SPACE", 1.0, TRUTH)
    found, shown = {}, {"polygons": truth}
    # Points are only ever refined, hence coarse ones first; these are drawn twice, for the first time compiles shaders.
    for tolerance in (max(TOLERANCES), *sorted(TOLERANCES, reverse=True)):
        renderer.store.clear()
        for technique in techniques:
            for samples in SAMPLES:
                drawn, points, seconds = picture(renderer, subject, "POINTS", technique, tolerance, samples)
                found[technique, samples, tolerance] = errors(drawn, truth, points, seconds)
                if (tolerance, samples) == SHOWN:
                    shown[technique] = drawn
    return Curves(found, shown)


def header() -> str:
    tolerances = " | ".join(f"{tolerance:g}" for tolerance in TOLERANCES)
    names = f"| scene, samples | technique | {tolerances} | alpha at 0.5, 1, 4 | time at 0.5, 1, 4 |"
    return f"{names}\n" + "|---" * (len(TOLERANCES) + 4) + "|"


def rows(name: str, curves: Curves, techniques: tuple[str, ...]) -> list[str]:
    """Of the table in docs/notes/techniques.md: RMSE and, within the silhouette, RMSE."""
    lines = []
    for samples in SAMPLES:
        base = curves.of("IMAGE_SPACE", samples)
        picked = [TOLERANCES.index(tolerance) for tolerance in (0.5, 1.0, 4.0)]
        for technique in techniques:
            curve = curves.of(technique, samples)
            cells = [f"{e.rmse:.1f} ({e.interior:.1f})".replace(" (nan)", "") for e in curve]
            alpha = ", ".join(f"{curve[i].alpha:.3f}" for i in picked)
            spent = ", ".join(f"{curve[i].seconds / base[i].seconds:.1f}" for i in picked)
            lines.append(f"| {name}, {samples} | {technique} | {' | '.join(cells)} | {alpha} | {spent} |")
    return lines


def beside(name: str, curves: Curves) -> list[str]:
    """What is not in the table."""
    lines = []
    for samples in SAMPLES:
        for i, tolerance in enumerate(TOLERANCES):
            every = {technique: curves.of(technique, samples)[i] for technique in TECHNIQUES}
            points = ", ".join(f"{e.points}" for e in every.values())
            seconds = ", ".join(f"{e.seconds:.2f}" for e in every.values())
            of = every["PAINTER"]
            lines.append(f"{name}, {samples} samples, tolerance {tolerance:g}: {points} points; {seconds} s; painter's "
                         f"alpha {of.alpha:.4f}, leak {of.leak:.2f}, at most {of.worst:.1f}")  # fmt: skip
    return lines


def plot(found: dict[str, Curves], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shape = len(SAMPLES), len(found)
    figure, axes = pyplot.subplots(
        *shape, figsize=(2.7 * shape[1], 2.9 * shape[0]), sharey=True, squeeze=False, layout="constrained"
    )
    for (row, column), axis in np.ndenumerate(axes):
        name, samples = list(found)[column], SAMPLES[row]
        for technique in dict.fromkeys(technique for technique, _, _ in found[name].errors):
            curve, style = found[name].of(technique, samples), "--" if technique == "disks" else "-"
            label = "opaque disks" if technique == "disks" else technique
            axis.loglog(TOLERANCES, [e.rmse for e in curve], style, marker="o", markersize=3, label=label)
        axis.set(title=f"{name}, {samples} sample{'s' if samples > 1 else ''}", xticks=TOLERANCES,
                 xticklabels=[f"{t:g}" for t in TOLERANCES], yticks=RULED, yticklabels=RULED)  # fmt: skip
        axis.minorticks_off()
        axis.grid(alpha=0.3)
        if row == shape[0] - 1:
            axis.set_xlabel("tolerance (pixels)")
        if column == 0:
            axis.set_ylabel("RMSE (1/255 of sRGB)")
    axes[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=100)


def sheet(found: dict[str, Curves]) -> np.ndarray:
    """Polygons and each technique; below, how far these differ from polygons, times GAIN. Rows with nothing are left
    out."""
    lines = []
    for curves in found.values():
        rows = np.flatnonzero(curves.pictures["polygons"][..., 3].any(axis=1))
        rows = slice(max(rows[0] - BORDER, 0), rows[-1] + BORDER + 1)
        truth = displayed(curves.pictures["polygons"][rows])
        drawn = [displayed(curves.pictures[technique][rows]) for technique in TECHNIQUES]
        differences = [np.clip(GAIN * np.abs(picture - truth), 0, 1) for picture in drawn]
        lines.append(np.concatenate([truth, *drawn], axis=1)[::-1])
        lines.append(np.concatenate([np.zeros_like(truth), *differences], axis=1)[::-1])
    return (255 * np.concatenate(lines) + 0.5).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="where the tree and the railing are")
    parser.add_argument("--plot", help="a picture of the curves")
    parser.add_argument("--pictures", help="polygons, each technique, and the differences below")
    parser.add_argument("--only", nargs="+", help="names of scenes")
    arguments = parser.parse_args()
    found, table, notes = {}, [header()], []
    renderer = Renderer(OpenGLDevice())
    for name, make in subjects(arguments.data).items():
        if arguments.only and name not in arguments.only:
            continue
        techniques = (*TECHNIQUES, "disks") if name in VIEWS else TECHNIQUES
        found[name] = measure(renderer, make(), techniques)
        table += rows(name, found[name], techniques)
        notes += beside(name, found[name])
        sys.stderr.write(f"{name}: done\n")
    sys.stdout.write("\n".join([*table, "", *notes]) + "\n")
    if arguments.plot:
        plot(found, arguments.plot)
    if arguments.pictures:
        Image.fromarray(sheet(found)).save(arguments.pictures, quality=72)


if __name__ == "__main__":
    from scripts.common.process import run

    run(main)
