"""Scenes with indirect light: pictures by PointSplat and by Cycles, their difference, and a table of errors.

    python -m scripts.studies.indirect --data DIR --folder WORK [--only NAMES] [--size 320x180] [--truth 512]
        [--bounces 3] [--settings NAME=VALUE ...]

WORK keeps what was drawn: Cycles' pictures that are there are not drawn again. Files with the ending .png are
PointSplat's, Cycles', and four times their difference about grey. The table goes to stdout.
"""

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from scripts.benchmarks.beside_cycles import figures, pictures
from scripts.benchmarks.beside_cycles.processes import ROOT, Program, rendered
from scripts.common.images import displayed
from scripts.render import size
from scripts.studies.indirect.names import NAMES

SEEDS = 101, 202
GAIN = 4.0


def drawn(
    file: Path, program: Program, seed: int, folder: Path, settings: dict, again: bool = False
) -> tuple[np.ndarray, dict]:
    """(H, W, 4) and what drawing it took, in a process of its own, if it is not there. RuntimeError: it was not."""
    path = folder / f"{file.stem}-{program.name}-{program.samples}-{seed}.exr"
    found: dict = {}
    if again or not path.exists():
        found = rendered(file, program, [path], seed, settings, bytecode=folder / "bytecode")
        if "failed" in found:
            raise RuntimeError(f"{file.stem}: {found['failed']}")
    return pictures.read(path), found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--only", default=",".join(NAMES))
    parser.add_argument("--size", type=size, default=(320, 180), metavar="WxH")
    parser.add_argument("--truth", type=int, default=512, help="samples of Cycles, in two pictures")
    parser.add_argument("--bounces", type=int, default=3)
    parser.add_argument("--settings", nargs="*", default=[])
    options = parser.parse_args()
    folder, (wide, high) = options.folder.resolve(), options.size
    folder.mkdir(parents=True, exist_ok=True)
    settings = {"use_indirect": True, "bounces": options.bounces} | {
        name: ast.literal_eval(value) for name, value in (one.split("=", 1) for one in options.settings)
    }
    sys.stdout.write("| scene | mean | RMSE | without | mean over Cycles' | seconds |\n|---|---|---|---|---|---|\n")
    for name in options.only.split(","):
        of_bounces = "" if options.bounces == 3 else f"-{options.bounces}"
        file = folder / f"{name}-{wide}x{high}{of_bounces}.blend"
        if not file.exists():
            module, data = "scripts.studies.indirect.scenes", str(options.data.resolve())
            command = [sys.executable, "-m", module, name, str(file), "--data", data, "--size", f"{wide}x{high}"]
            command += ["--bounces", str(options.bounces)]
            subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
        try:
            truth = [drawn(file, Program("CYCLES", options.truth // 2), seed, folder, {})[0][..., :3] for seed in SEEDS]
            own, took = drawn(file, Program("AUTO", 16), 0, folder, settings, again=True)
            plain, _ = drawn(file, Program("AUTO", 16), 1, folder, {"use_indirect": False})
        except RuntimeError as problem:
            sys.stdout.write(f"| {name} | {problem} |\n")
            continue
        mean = (truth[0].astype(float) + truth[1]) / 2
        exposure = 0.3 / mean.mean()
        errors = [exposure * figures.rmse(x[..., :3], *truth) for x in (own, plain)]
        ratio = own[..., :3].mean(dtype=float) / mean.mean()
        seconds = f"{took['seconds']:.2f}"
        figures_of = (f"{mean.mean():.3f}", *(f"{error:.4f}" for error in errors), f"{ratio:.3f}", seconds)
        sys.stdout.write(f"| {' | '.join((name, *figures_of))} |\n")
        sys.stdout.flush()
        shown = [displayed(np.dstack([exposure * x[..., :3], np.ones(x.shape[:2])])) for x in (own, mean)]
        sheet = [*shown, np.clip(0.5 + GAIN * (shown[0] - shown[1]), 0, 1)]
        Image.fromarray((255 * np.concatenate(sheet, axis=1)[::-1] + 0.5).astype(np.uint8)).save(
            folder / f"{file.stem}.png"
        )


if __name__ == "__main__":
    main()
