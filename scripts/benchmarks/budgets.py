"""How well `budget` TIME is kept: pictures of a viewport over the time that they may take.

    python -m scripts.benchmarks.budgets [--only NAME ...] [--scan FILE.ply[.gz] ...] [--volume FILE.nii.gz ...]
        [--write-docs]

Every scene of scripts/scenes/cases.py, and the files: scans of triangles, volumes of voxels. Of each, pictures of a
camera that stands still and of one that goes around, nearer and farther. What they may take is what five samples take
here, and half of what one takes, which only a coarser cut can keep; "no splats" is how much of the latter a picture
takes whose cut is as good as empty, which no cut changes. By the clock on the wall, and by the processor's, in all
threads, which other work on the machine leaves alone.

--write-docs replaces the table in docs/notes/budgets.md.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pointsplat_addon.core.lod.cut import Cut
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.volume import Medium, Volume
from pointsplat_addon.formats.volumes import dense
from pointsplat_addon.render.budget.pacing import COARSEST
from pointsplat_addon.render.budget.viewport import Moving
from pointsplat_addon.render.device.protocol import wait
from pointsplat_addon.render.frame import frame
from pointsplat_addon.render.plan.frame_plan import FramePlan
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.defocus import scan
from scripts.scenes import build, cameras, drawing
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES

DOCS = Path(__file__).resolve().parents[2] / "docs" / "notes" / "budgets.md"
BEGIN, END = "<!-- times -->\n", "<!-- end of times -->\n"
SIZE = 192  # pixels of the longer side
FIRST, COUNTED = 3, 20  # pictures that do not count, and those of which the median does
TURN, NEARER = 0.05, 0.2  # radians a picture; part of the distance by which it changes, to and fro
SAMPLES = 5.0  # that fit in the longer time, at the tolerance of the settings; and in the shorter one:
LESS = 0.5
FEW = 8  # splats of a picture without
MANY = 10_000  # splats, of scenes that are asked to keep that
MOST = 16  # samples of a viewport's picture
WARMED = (1.0, 4.0, 8.0, 16.0)  # times the tolerance: octrees of what is drawn then are there before


@dataclass(frozen=True)
class Kept:
    """Pictures of one scene, one budget and one way to move, over what they may take."""

    allowed: float  # milliseconds
    ratios: np.ndarray  # (COUNTED,)
    samples: float  # mean of what they had
    tolerance: float  # median, over that of the settings
    held: bool  # neither more samples nor coarser cuts could have helped

    @property
    def text(self) -> str:
        middle, worst = np.median(self.ratios), self.ratios.max()
        return f"{middle:.2f} ({worst:.2f})" + ("*" if self.held else "")


def around(case: Case, size: int = SIZE) -> Callable[[int], Camera]:
    """The case's camera, larger, at a picture of its way around the middle of what it sees."""
    longer = max(case.camera.resolution)
    width, height = (max(side * size // longer, 1) for side in case.camera.resolution)
    start = replace(case.camera, resolution=(width, height), region=None)
    places = case.scene.instances.world_from_object[:, :3, 3]
    places = places[np.isfinite(places).all(axis=1)]
    middle = np.median(places, axis=0) if len(places) else np.zeros(3)

    def at(step: int) -> Camera:
        turn, scale = step * TURN, 1 + NEARER * np.sin(step / 3)
        turned = np.eye(4)
        turned[:2, :2] = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        turned[2, 2] = scale
        turned[:3, 3] = middle - turned[:3, :3] @ middle
        # The scene is turned and grows before a camera that stands still: its own matrix stays one without a scale.
        view = start.view_from_world @ turned
        view[:3] /= scale
        return replace(start, view_from_world=view)

    return at


def kept(
    renderer: Renderer,
    case: Case,
    allowed: float,
    camera: Callable[[int], Camera],
    clock: Callable[[], float],
) -> Kept:
    """`allowed`: seconds."""
    settings = replace(case.settings, budget="TIME", time_budget=1000 * allowed)
    renderer.pacers = type(renderer.pacers)()
    times, samples, tolerances, held = [], [], [], []
    for step in range(FIRST + COUNTED):
        request = Request(camera(step), settings, frozenset({"combined"}), MOST, interactive=True)
        before = clock()
        keeper = Moving(renderer, case.scene, request, clock)
        frame = renderer.start(case.scene, keeper.request)
        keeper.sample(frame)
        done = frame.done
        frame.release()
        times.append(clock() - before)
        samples.append(done)
        tolerances.append(keeper.request.settings.tolerance / settings.tolerance)
        held.append((done >= MOST and tolerances[-1] <= 1) or (done == 1 and tolerances[-1] > 15))
    counted = slice(FIRST, None)
    return Kept(
        1000 * allowed, np.array(times[counted]) / allowed, float(np.mean(samples[counted])),
        float(np.median(tolerances[counted])), bool(np.mean(held[counted]) > 0.5),
    )  # fmt: skip


def alone(renderer: Renderer, case: Case, camera: Camera, clock: Callable[[], float]) -> tuple[float, float, int]:
    """Seconds before the first sample, and of a sample; splats."""
    found, splats = [], 0
    for _ in range(4):
        before = clock()
        request = Request(camera, case.settings, frozenset({"combined"}), 2, interactive=True)
        frame = renderer.start(case.scene, request)
        ready = clock()
        for _ in range(2):
            frame.sample()
            wait(renderer.device)
        found.append((ready - before, (clock() - ready) / 2))
        splats = frame.frame_plan.splats
        frame.release()
    once, each = np.median(found[1:], axis=0)
    return float(once), float(each), splats


def warmed(renderer: Renderer, case: Case, camera: Camera) -> None:
    """Wait for the octrees, which threads of their own build for viewports: no cut is coarser without them."""
    for coarser in WARMED:  # first at the settings' own: samples are only ever refined
        request = coarse(case, camera, coarser)
        for _ in range(2):  # octrees of meshes are begun when they are asked for again
            renderer.start(case.scene, request).release()
        while renderer.store.building:
            time.sleep(0.05)


def coarse(case: Case, camera: Camera, coarser: float) -> Request:
    """As TIME asks for cuts that are so much coarser."""
    settings = replace(case.settings, budget="TIME", tolerance=coarser * case.settings.tolerance)
    return Request(camera, settings, frozenset({"combined"}), 1, interactive=True, coarse=coarser > 1)


@contextmanager
def bare() -> Iterator[None]:
    """Pictures are planned as ever, and then drawn with FEW splats of each kind."""
    made = frame.make_frame_plan

    def without(*given: Any) -> FramePlan:
        frame_plan = made(*given)
        prepared = frame_plan.prepared
        few = replace(
            prepared,
            cut=_few(prepared.cut),
            translucent=replace(prepared.translucent, cut=_few(prepared.translucent.cut)),
            spheres=replace(prepared.spheres, cut=_few(prepared.spheres.cut)),
        )
        return replace(frame_plan, prepared=few)

    frame.make_frame_plan = without
    try:
        yield
    finally:
        frame.make_frame_plan = made


def _few(cut: Cut) -> Cut:
    count = np.minimum(cut.count[:1], FEW)
    return Cut(cut.instance[:1], cut.first[:1], count, points=int(count.sum()))


def least(renderer: Renderer, case: Case, camera: Camera, clock: Callable[[], float]) -> float:
    """Seconds of one sample at the coarsest tolerance with next to no splats: preparing, and passes over all pixels."""
    found = []
    with bare():
        for _ in range(7):
            before = clock()
            drawn = renderer.start(case.scene, coarse(case, camera, COARSEST))
            drawn.sample()
            wait(renderer.device)
            drawn.release()
            found.append(clock() - before)
            while renderer.store.building:
                time.sleep(0.05)
    return min(found)


def measured(renderer: Renderer, case: Case) -> list[Kept | float | None]:
    """By the processor's clock, then by the one on the wall: still and moving, with SAMPLES and with LESS, and what of
    the latter `least` takes; None where there are too few splats to leave out."""
    camera = around(case)
    warmed(renderer, case, camera(0))
    found: list[Kept | float | None] = []
    ways = (lambda step: camera(0), camera)
    for clock in (time.process_time, time.perf_counter):
        once, each, splats = alone(renderer, case, camera(0), clock)
        budgets = (once + SAMPLES * each, LESS * (once + each))
        found += [kept(renderer, case, budgets[0], way, clock) for way in ways]
        found += [kept(renderer, case, budgets[1], way, clock) if splats > MANY else None for way in ways]
        found.append(least(renderer, case, camera(0), clock) / budgets[1] if splats > MANY else None)
    return found


def scanned(path: Path) -> Case:
    mesh = Geometry(str(path), path.name, mesh=scan(path))
    return Case(
        build.scene((mesh, build.moved((0, 0, -0.7)))), cameras.camera((0.3, -3, 0.6), resolution=(SIZE, SIZE)),
        Settings(),
    )  # fmt: skip


def voxels(path: Path) -> Case:
    found = dense.read(path)
    value, empty, highest = dense.without_background(found.value, 0.05)
    index = np.argwhere(value != empty).astype(np.int32)
    density = (value[tuple(index.T)] / highest).astype(np.float32)
    volume = Volume(str(path), path.name, index, dense.centred(found, 2.0), {"density": density})
    table = build.materials(media=(Medium(density=20.0),))
    geometry = Geometry(str(path), path.name, volume=volume)
    return Case(
        build.scene((geometry, build.moved()), table=table), cameras.camera((0, -3.5, 0.5), resolution=(SIZE, SIZE)),
        Settings(),
    )  # fmt: skip


WAYS = ("5 samples{}: still", "5 samples{}: moving", "half of one{}: still", "half of one{}: moving", "no splats{}")
HEAD = ["scene", *(way.format(by) for by in ("", " by the wall") for way in WAYS)]


def shown(one: Kept | float | None) -> str:
    return "" if one is None else f"{one:.2f}" if isinstance(one, float) else one.text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[], help="names of scenes")
    parser.add_argument("--scan", nargs="+", type=Path, default=[])
    parser.add_argument("--volume", nargs="+", type=Path, default=[])
    parser.add_argument("--write-docs", action="store_true")
    given = parser.parse_args()
    cases = {name: make for name, make in CASES.items() if name != "empty"}
    cases |= {path.name: lambda path=path: scanned(path) for path in given.scan}
    cases |= {path.name: lambda path=path: voxels(path) for path in given.volume}
    table = [HEAD, ["---"] * len(HEAD)]
    for name, make in cases.items():
        if given.only and name not in given.only:
            continue
        renderer = drawing.opengl()
        renderer.store.clear()
        renderer.release()
        found = measured(renderer, make())
        table.append([name, *map(shown, found)])
        detail = ", ".join(
            f"{one.samples:.1f} at {one.tolerance:.2f} in {one.allowed:.0f} ms"
            for one in found
            if isinstance(one, Kept)
        )
        print(" | ".join(table[-1]), "|", detail, flush=True)
    text = "".join(f"| {' | '.join(cells)} |\n" for cells in table)
    if given.write_docs:
        before, rest = DOCS.read_text().split(BEGIN)
        DOCS.write_text(before + BEGIN + text + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
