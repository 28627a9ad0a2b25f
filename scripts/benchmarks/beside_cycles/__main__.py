"""PointSplat beside Cycles as a user has them: time, memory and error of whole processes.

    python -m scripts.benchmarks.beside_cycles --data DIR --folder WORK [--only SCENE ...] [--size WxH]
        [--techniques VISIBILITY AUTO ...] [--samples 16] [--cycles-samples 16 64 ...] [--truth 512] [--repeats 1]
        [--no-shader-cache] [--shading lambert|glow|own] [--no-shadows] [--sun-angle RADIANS] [--flat]
        [--set NAME=VALUE ...]

DIR holds real meshes, and beside it are folders of other data (`../points`, `../hair`): scenes whose files are missing
are left out. WORK keeps scenes, truths and pictures, for each version of Blender: --again makes them anew.

Each render has a process of its own, which opens a .blend file, renders it into an EXR file, moves the camera and
renders again (Cycles with persistent data). The time of the first picture is that from the start of the process to the
file written; programs take turns, and of several runs the median counts. A run of each program that is not counted
comes first: it leaves modules compiled, as those of an installed extension are, and the driver's shaders, except with
--no-shader-cache, which measures the very first picture on a machine. Errors are those against two independent pictures
of Cycles. `of Cycles` are shares of the first of --cycles-samples; where there are several of them, `equal` is
the time in which Cycles comes to the same error of colour. WORK/pictures has what was drawn beside the truth, and the
difference times 8. The table goes to stdout, all figures to --json.
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np

from scripts.benchmarks.__main__ import busy, machine, markdown
from scripts.benchmarks.beside_cycles import figures, pictures
from scripts.benchmarks.beside_cycles.processes import Program, rendered, scene_file
from scripts.benchmarks.beside_cycles.scenes import KINDS, add_look, look_of
from scripts.common.process import run
from scripts.render import assignment, size

HEAD = ["scene", "program", "first, s", "of Cycles", "processor, s", "second, s", "of Cycles", "MB", "of Cycles",
        "RMSE", "of alpha", "mean alpha", "of truth", "brightness", "equal, s"]  # fmt: skip
SEEDS = 101, 202  # of the truth's two pictures


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(), help="real meshes")
    parser.add_argument("--folder", type=Path, required=True, help="where scenes, truths and pictures are kept")
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS), metavar="SCENE")
    parser.add_argument("--size", type=size, metavar="WxH", help="default: each scene's own")
    parser.add_argument("--techniques", nargs="*", default=["VISIBILITY"], help="and BLENDER_WORKBENCH")
    parser.add_argument("--samples", type=int, default=16, help="of PointSplat")
    parser.add_argument("--cycles-samples", type=int, nargs="+", default=[16])
    parser.add_argument("--truth", type=int, default=512, help="samples of each of its two pictures; 0: no errors")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--no-shader-cache", action="store_true", help="as if no shader had ever been compiled")
    parser.add_argument("--set", type=assignment, action="append", default=[], metavar="NAME=VALUE",
                        help="number or name for scene.pointsplat")  # fmt: skip
    parser.add_argument("--again", action="store_true", help="make scenes and truths anew")
    parser.add_argument("--json", type=Path)
    add_look(parser)
    return parser.parse_args()


def value(text: str) -> bool | float | str:
    """What --set says, as Blender takes it."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return int(text) if text.lstrip("-").isdigit() else float(text)
    except ValueError:
        return text


def measure(name: str, options: argparse.Namespace) -> list[dict]:
    """A row for each program that renders the scene."""
    look = look_of(options)
    wide, high = options.size or KINDS[name].size
    folder = options.folder.resolve() / f"blender-{version('bpy')}"
    title = f"{name}{look.suffix()}-{wide}x{high}"
    file = folder / "scenes" / f"{title}.blend"
    if options.again or not file.exists():
        given = ["--shading", look.shading, "--sun-angle", str(look.sun_angle)]
        given += ["--flat"] * look.flat + ["--no-shadows"] * (not look.shadows)
        scene_file(
            file, [name, str(file), "--data", str(options.data.resolve()), "--size", str(wide), str(high), *given]
        )
    truth = [known(folder, file, title, seed, options) for seed in SEEDS] if options.truth else []

    programs = [Program("CYCLES", count) for count in options.cycles_samples]
    programs += [Program(technique, options.samples) for technique in options.techniques]
    runs: dict[Program, list[dict]] = {program: [] for program in programs}
    settings = {key: value(text) for key, text in options.set}
    for turn in range(1 + options.repeats):
        for program in programs:
            outputs = [folder / "pictures" / f"{title}-{program.name}-{program.samples}-{i}.exr" for i in (1, 2)]
            given = settings if program.name not in ("CYCLES", "BLENDER_WORKBENCH") else None
            before = {"bytecode": folder / "bytecode", "shader_cache": not options.no_shader_cache}
            found = rendered(file, program, outputs, 0, given, **before)
            if turn:
                runs[program].append(found)
    rows = []
    for program in programs:
        row = {"scene": name, "look": look.suffix(), "size": [wide, high], "program": program.name,
               "samples": program.samples, **figures.median(runs[program])}  # fmt: skip
        if truth and "failed" not in row:
            output = folder / "pictures" / f"{title}-{program.name}-{program.samples}-1.exr"
            picture = pictures.read(output)
            row |= figures.errors(picture, *truth)
            pictures.beside(picture, (truth[0] + truth[1]) / 2, output.with_name(output.stem[:-2] + ".png"))
        rows.append(row)
    return figures.with_shares(rows)


def known(folder: Path, file: Path, title: str, seed: int, options: argparse.Namespace) -> np.ndarray:
    """One of the truth's pictures, rendered if it is not kept. RuntimeError: it could not be."""
    path = folder / "truths" / f"{title}-{options.truth}-{seed}.exr"
    if options.again or not path.exists():
        found = rendered(file, Program("CYCLES", options.truth), [path], seed, bytecode=folder / "bytecode")
        if "failed" in found:
            raise RuntimeError(found["failed"])
    return pictures.read(path)


def cells(row: dict) -> list[str]:
    program = Program(row["program"], row["samples"]).title()
    drawn = row.get("reports", [{}])[0].get("technique", {}).get("name", row["program"])
    program += f" (by {drawn.replace('_', ' ').lower()})" if drawn != row["program"] else ""
    scene = row["scene"] + row["look"]
    if "failed" in row:
        return [scene, program, f"failed: {row['failed'][-120:]}", *[""] * (len(HEAD) - 3)]
    share = {key: f"{part:.2f}" for key, part in row.get("of_cycles", {}).items()}
    text = [scene, program, f"{row['seconds']:.2f}", share.get("seconds", ""), f"{row['processor']:.2f}"]
    text += [f"{row['second']:.2f}", share.get("second", ""), f"{row['peak'] / 1e6:.0f}", share.get("peak", "")]
    if "rmse" not in row:
        return text + [""] * (len(HEAD) - len(text))
    text += [f"{row['rmse']:.4f}", f"{row['rmse_alpha']:.4f}", f"{row['alpha']:.4f}", f"{row['true_alpha']:.4f}"]
    equal = row.get("equal")
    return [*text, f"{row['brightness']:.4f}", "" if equal is None else f"{equal:.2f}"]


def main() -> int:
    options = arguments()
    begun = f"{machine()}; {busy()} at the start"
    rows, failed = [], False
    for name in options.only:
        needed = options.data / KINDS[name].needs
        if KINDS[name].needs and not needed.exists():
            sys.stderr.write(f"{name}: left out, for there is no {needed}\n")
            continue
        try:
            rows += measure(name, options)
        except RuntimeError as error:
            sys.stderr.write(f"{name}: {error}\n")
            failed = True
            continue
        sys.stderr.write(f"{name}: done\n")
        if options.json:
            options.json.parent.mkdir(parents=True, exist_ok=True)
            found = {"machine": begun, "truth": options.truth, "rows": rows}
            options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(f"{begun}\n\n{markdown([HEAD, *map(cells, rows)])}\n")
    return 1 if failed or any("failed" in row for row in rows) else 0


if __name__ == "__main__":
    run(main)
