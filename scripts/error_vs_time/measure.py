"""Error against time: each technique over tolerance, samples, shadow resolution and lens, beside Cycles, EEVEE and VTK.

    python -m scripts.error_vs_time [--data DIR] [--only NAME ...] [--quick] [--docs docs] [--rows FILE.json]
        [--keep DIR] [--no-eevee]
    python -m scripts.error_vs_time --from docs/notes/error_vs_time.json

DIR (or the folder that POINTSPLAT_DATA names) holds meshes, and folders beside it what else there is
(scripts/error_vs_time/scenes.py): scenes of what is missing are left out; what DOCS has of scenes that are not drawn
stays. DOCS receives error_vs_time.json and, in images/, error_vs_time.png, error_vs_time_to_cycles.png (of the errors
against Cycles' converged pictures), error_vs_time_brief.png and cost_over_points.png; the tables in error_vs_time.md
are replaced. `--keep` takes Cycles' converged pictures from a folder, and leaves those there that it lacked. `--from`
makes tables and plots anew from rows. `--quick` draws small pictures of one scene and writes nothing but the rows that
`--rows` names. Needs bpy for all scenes but one, matplotlib for plots, and takes FLIP where the package flip-evaluator
is there (requirements/benchmark.txt).

Every scene is drawn in a process of its own, as are the other programs. Times are those of the processor in all
threads, from Blender's data to the finished picture, shaders compiled before: converting the scene, sampling, shadow
tables and drawing, with nothing kept from pictures before.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from unittest import mock

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.frame.report import report
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks import frame as bench_frame
from scripts.error_vs_time.curves import Row, Truths, errors, plot, plot_brief, plot_counts, written
from scripts.error_vs_time.programs import converged as converged_cycles
from scripts.error_vs_time.programs import theirs
from scripts.error_vs_time.scenes import KINDS, Subject, sphere_subject, subject
from scripts.error_vs_time.truths import TRUTH

ROOT = Path(__file__).resolve().parents[2]
SIZE = 256  # pixels
FRAMES = ("IMAGE_SPACE", "EWA", "PAINTER")  # techniques of which a picture of more samples is more frames
TECHNIQUES = (*FRAMES, "VISIBILITY")
TOLERANCES = (8.0, 4.0, 2.0, 1.0, 0.5)  # pixels
LENS_TOLERANCES = (4.0, 1.0)  # of samples through the lens
SAMPLES = (1, 4, 16, 64)
RESOLUTIONS = (64, 256, 4096)  # of shadows, beside the default
LONGEST = 4.0  # seconds: a picture that has taken longer gets no further samples, and finer ones are not drawn
TRUTH_MANY = 1024  # samples of the truth through a lens, and of strands
TRUTH_SHADOWS = 8192  # cells of its shadow tables
COUNTS = (10_000, 30_000, 100_000, 300_000, 1_000_000)  # points of the sphere
LIMIT = 3600  # seconds for one process


# ---------------------------------------------------------------------------- PointSplat


class ProcessorDevice(bench_frame.MeteredDevice):
    """Times passes by the processor's clock, in all threads, with the device finished before and after."""

    def start_timer(self) -> ProcessorWatch:
        return ProcessorWatch(self)


class ProcessorWatch:
    def __init__(self, device: ProcessorDevice) -> None:
        self._device = device
        device.finish()
        self._start = time.process_time()

    def stop(self) -> None:
        self._device.finish()
        self._elapsed = time.process_time() - self._start

    def milliseconds(self) -> float:
        return 1e3 * self._elapsed

    def release(self) -> None:
        pass


def pictures(
    renderer: Renderer,
    scene: Scene,
    camera: Camera,
    settings: Settings,
    samples: tuple[int, ...],
    lens: bool,
    longest: float = LONGEST,
) -> Iterator[tuple[np.ndarray, Row]]:
    """One picture after the first so many samples each, until `longest` seconds have passed, and its row. Nothing is
    kept from pictures before but shaders. Fewer samples are the first of the largest number."""
    renderer.release()
    renderer.store.clear()
    start = time.process_time()
    request = Request(camera, settings, frozenset({"combined"}), samples[-1])
    # What the processor does is else timed by the wall's clock, which other work on the machine disturbs.
    with mock.patch.object(time, "perf_counter", time.process_time):
        frame = Frame(renderer, scene, request, presented=lens)
    allocated = time.process_time() - start
    seconds, reading = allocated, 0.0
    try:
        while not frame.complete and (seconds < longest or frame.done == 0):
            frame.sample()
            if not (frame.done in samples or frame.complete):
                continue
            pixels = frame.pixels()["combined"]
            before = time.process_time()
            seconds = before - start - reading
            told = report(frame, seconds)
            passes = {entry["name"]: round(entry["ms"] / 1e3, 6) for entry in told["passes"]}
            prepare = max(allocated - passes.get("shadows", 0.0), 0.0)
            row = {"prepare": prepare, "passes": passes, "points": told["points"]["cut"], "bytes": told["bytes"]}
            yield pixels, {"samples": min(frame.done, samples[-1]), "seconds": seconds, **row}
            reading += time.process_time() - before
    finally:
        frame.release()


def swept(subject: Subject, tolerances: tuple[float, ...], samples: tuple[int, ...]) -> list[tuple[str, str, Settings]]:
    """(series, primitive, settings) of every picture."""
    plain = Settings(use_shadows=subject.shadows, use_adaptive_sampling=False)
    found = [
        ("tolerance", "POINTS", replace(plain, technique=technique, tolerance=tolerance))
        for tolerance in tolerances
        for technique in FRAMES
    ]
    found += [
        ("tolerance", "POINTS", replace(plain, technique="VISIBILITY", tolerance=tolerance, samples=count))
        for tolerance in tolerances
        for count in samples
    ]
    if subject.lens:
        found += [
            ("lens", "POINTS", replace(plain, technique=technique, tolerance=tolerance, dof_method="LENS_SAMPLES"))
            for tolerance in LENS_TOLERANCES
            for technique in FRAMES
        ]
    if subject.shadows:
        found += [
            ("shadows", "POINTS", replace(plain, technique="IMAGE_SPACE", shadow_resolution=resolution))
            for resolution in RESOLUTIONS
        ]
    # As a user has it, each number of samples a picture of its own: samples that agree are then left out.
    usual = replace(plain, use_adaptive_sampling=True)
    return found + [("defaults", "AUTO", replace(usual, samples=count)) for count in samples]


def converged(renderer: Renderer, subject: Subject, samples: int) -> np.ndarray:
    """The subject's triangles or strands, with shadows as fine as they get, through the lens."""
    settings = Settings("IMAGE_SPACE", use_shadows=subject.shadows, use_adaptive_sampling=False,
                        shadow_resolution=TRUTH_SHADOWS, dof_method="LENS_SAMPLES", tolerance=0.5)  # fmt: skip
    renderer.store.clear()
    request = Request(subject.camera, settings, frozenset({"combined"}), samples)
    return renderer.render(subject.drawn_as("LINES" if subject.strands else "POLYGONS"), request).pixels["combined"]


def ours(
    renderer: Renderer,
    name: str,
    subject: Subject,
    tolerances: tuple[float, ...] = TOLERANCES,
    samples: tuple[int, ...] = SAMPLES,
    truth_samples: int = TRUTH,
    cycles: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[Truths, list[Row]]:
    """The truths, of which `cycles` may be one, and PointSplat's rows."""
    many = max(truth_samples, TRUTH_MANY) if subject.lens or subject.strands else truth_samples
    truths = Truths(converged(renderer, subject, many) if subject.truth is None else subject.truth(), cycles)
    rows: list[Row] = []
    too_long = set()  # techniques that no finer tolerances follow; with a tolerance: that no more samples follow
    for series, primitive, settings in swept(subject, tolerances, samples):
        tried = {settings.technique, (settings.technique, settings.tolerance)}
        if series == "tolerance" and tried & too_long:
            continue
        whole = (
            series == "defaults" or settings.technique == "VISIBILITY"
        )  # each number of samples is a picture of its own
        counts = (settings.samples,) if whole else samples
        scene = subject.drawn_as(primitive)
        # Compiles shaders, which software renderers do anew for other sizes of textures; those of tiles that get no
        # more samples are first used after five
        few = 6 if settings.use_adaptive_sampling else 2
        _ = list(pictures(renderer, scene, subject.camera, settings, (min(few, counts[-1]),), subject.lens))
        longest = math.inf if series == "defaults" else LONGEST
        for pixels, row in pictures(renderer, scene, subject.camera, settings, counts, subject.lens, longest):
            if series == "tolerance" and row["seconds"] > LONGEST:
                few = (settings.samples if whole else row["samples"]) == samples[0]
                too_long.add(settings.technique if few else (settings.technique, settings.tolerance))
            row |= {"seconds": row["seconds"] + subject.converted, "prepare": row["prepare"] + subject.converted}
            if whole:
                row["samples"] = settings.samples
            rows.append({"scene": name, "program": "PointSplat", "series": series, **described(subject, settings),
                         **row, **errors(pixels, truths)})  # fmt: skip
    return truths, rows


def described(subject: Subject, settings: Settings) -> Row:
    return {
        "technique": settings.technique,
        "tolerance": settings.tolerance,
        "shadow_resolution": settings.shadow_resolution if subject.shadows else None,
        "dof_method": settings.dof_method if subject.lens else None,
    }


def counted(renderer: Renderer, counts: tuple[int, ...], size: int) -> list[Row]:
    """Cost of one sample over the number of points, all of which are drawn: not even a hierarchy is built at so fine a
    tolerance."""
    rows = []
    for count in counts:
        drawn = sphere_subject(count, size)
        for technique in TECHNIQUES:
            settings = Settings(technique, samples=1, tolerance=0.05, use_shadows=False, use_adaptive_sampling=False)
            for _ in range(2):  # the first compiles shaders
                [(_, row)] = pictures(renderer, drawn.scene, drawn.camera, settings, (1,), False)
            rows.append({"scene": "counts", "program": "PointSplat", "series": "count", **described(drawn, settings),
                         **row, "rmse": None, "psnr": None, "flip": None})  # fmt: skip
    return rows


# ---------------------------------------------------------------------------- processes


def work(what: str, name: str, arguments: argparse.Namespace) -> None:
    """In a process of its own: the rows of one scene, of PointSplat or of other programs."""
    folder: Path = arguments.worker_folder
    kept = folder / "own.npy", *(folder / f"cycles_{i}.npy" for i in (1, 2))
    cycles = (np.load(kept[1]), np.load(kept[2])) if kept[1].exists() else None
    rows: list[Row] = []
    if what == "converged":
        if cycles is None:
            for path, pixels in zip(kept[1:], converged_cycles(name, SIZE, arguments.data, folder) or (), strict=False):
                np.save(path, pixels)
    elif what == "ours":
        renderer = Renderer(ProcessorDevice())
        drawn = subject(name, SIZE, arguments.data, folder)
        found, rows = ours(renderer, name, drawn, tuple(arguments.tolerances), tuple(arguments.samples), cycles=cycles)
        np.save(kept[0], found.own)
        if KINDS[name].build is None:
            rows += counted(renderer, COUNTS, SIZE)
    else:
        rows = theirs(name, Truths(np.load(kept[0]), cycles), SIZE, arguments.data, folder, COUNTS, what == "eevee")
    (folder / f"{what}.json").write_text(json.dumps(rows), encoding="utf-8")


def in_processes(names: list[str], arguments: argparse.Namespace) -> tuple[list[Row], list[str]]:
    """Measures scenes, each program in a process of its own.

    Returns all rows and the names of the scenes that failed. The rows of a scene replace those of it that
    `arguments.rows` holds; where one of its programs failed, the old rows stay.
    """
    failed: list[str] = []
    rows: list[Row] = json.loads(arguments.rows.read_text(encoding="utf-8")) if arguments.rows.exists() else []
    for name in names:
        with kept_folder(arguments.keep, name) as folder:
            drawn_again = (name,) if KINDS[name].build else (name, "counts")
            kept = () if arguments.eevee else ("EEVEE",)
            others = [row for row in rows if row["scene"] not in drawn_again or row["program"] in kept]
            found: list[Row] = []
            for what in ("converged", "ours", "theirs", *(("eevee",) if KINDS[name].eevee and arguments.eevee else ())):
                command = [sys.executable, "-m", "scripts.error_vs_time", "--worker", what, name]
                command += ["--worker-folder", folder]
                command += ["--data", str(arguments.data), "--tolerances", *map(str, arguments.tolerances)]
                command += ["--samples", *map(str, arguments.samples)]
                start = time.perf_counter()
                try:
                    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, cwd=ROOT)
                    told = [] if done.returncode == 0 else done.stderr.splitlines()[-3:]
                except subprocess.TimeoutExpired:
                    told = [f"took longer than {LIMIT} s"]
                result = Path(folder, f"{what}.json")
                found += json.loads(result.read_text(encoding="utf-8")) if result.exists() else []
                failed += [name] if told else []
                said = "; ".join(told) if told else f"{time.perf_counter() - start:.0f} s"
                sys.stderr.write(f"{name}, {what}: {said}\n")
        rows = rows if name in failed else others + found
        order = ("counts", *KINDS)
        rows.sort(key=lambda row: (order.index(row["scene"]), row["program"] != "PointSplat", row["program"]))
        save(rows, arguments.rows)
    return rows, list(dict.fromkeys(failed))


def kept_folder(keep: Path | None, name: str) -> AbstractContextManager[str]:
    """A scene's own in `keep`, or one that goes when it was used."""
    if keep is None:
        return tempfile.TemporaryDirectory()
    folder = keep.absolute() / name.replace(", ", "-").replace(" ", "-")
    folder.mkdir(parents=True, exist_ok=True)
    for rows in folder.glob("*.json"):  # of a run before
        rows.unlink()
    return nullcontext(str(folder))


def quick(size: int = 64, count: int = 3000) -> list[Row]:
    """The sphere, of few points, at two tolerances."""
    device = ProcessorDevice()
    renderer = Renderer(device)
    try:
        _, rows = ours(renderer, "sphere of points", sphere_subject(count, size), (4.0, 1.0), (1, 4))
        return rows + counted(renderer, (count, 4 * count), size)
    finally:
        renderer.release()
        device.release()


def rounded(value: object) -> object:
    """Floats of six digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value


def save(rows: list[Row], path: Path | None) -> None:
    """One row a line."""
    if path is not None:
        lines = ",\n".join(json.dumps(rounded(row), separators=(",", ":")) for row in rows)
        path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def main() -> int:
    """Run what the command line asks for. Returns the exit status: 1 where a scene failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("POINTSPLAT_DATA", "")), help="real meshes")
    parser.add_argument("--only", nargs="+", choices=KINDS, help="names of scenes")
    parser.add_argument("--tolerances", type=float, nargs="+", default=TOLERANCES, help="in pixels, coarse ones first")
    parser.add_argument("--samples", type=int, nargs="+", default=SAMPLES, help="of PointSplat, few first")
    parser.add_argument("--quick", action="store_true", help="does it run at all?")
    parser.add_argument("--no-eevee", dest="eevee", action="store_false", help="which takes long without a GPU")
    parser.add_argument(
        "--docs", type=Path, help="where the page is that is written to; by default docs/notes, or, with ROWS, none is"
    )
    parser.add_argument("--rows", type=Path, help="where the rows go; by default into DOCS")
    parser.add_argument(
        "--keep", type=Path, help="where Cycles' converged pictures are kept; remove them to change scenes"
    )
    parser.add_argument("--from", dest="known", type=Path, help="rows that were measured before: draws them again")
    parser.add_argument("--worker", nargs=2, metavar=("WHAT", "NAME"), help=argparse.SUPPRESS)
    parser.add_argument("--worker-folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        what, name = arguments.worker
        work(what, name, arguments)
        return 0
    if arguments.quick:
        save(quick(), arguments.rows)
        return 0
    failed: list[str] = []
    docs: Path | None = arguments.docs
    if docs is None and (arguments.rows is None or arguments.known):
        docs = ROOT / "docs" / "notes"
    if docs is not None:
        arguments.rows = arguments.rows or docs / "error_vs_time.json"
    if arguments.known:
        rows = json.loads(arguments.known.read_text(encoding="utf-8"))
    else:
        there = [name for name, kind in KINDS.items() if not kind.needs or (arguments.data / kind.needs).exists()]
        rows, failed = in_processes([name for name in there if not arguments.only or name in arguments.only], arguments)
    if failed:
        sys.stderr.write(f"failed, so that their rows are those of before: {', '.join(failed)}\n")
    if docs is None:
        return 1 if failed else 0
    page = docs / "error_vs_time.md"
    page.write_text(written(page.read_text(encoding="utf-8"), rows), encoding="utf-8")
    if find_spec("matplotlib"):
        images = docs / "images"
        plot(rows, images / "error_vs_time.png")
        plot(rows, images / "error_vs_time_to_cycles.png", "to_cycles")
        plot_brief(rows, images / "error_vs_time_brief.png")
        plot_counts(rows, images / "cost_over_points.png")
    else:
        sys.stderr.write(f"no plot without matplotlib: --from {arguments.rows} where it is installed\n")
    return 1 if failed else 0
