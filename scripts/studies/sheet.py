"""A sheet of scenes as drawn by PointSplat and by Cycles, and figures of how they differ.

    python -m scripts.studies.sheet FILE.blend ... --output SHEET.jpg --folder WORK
        [--samples 16] [--cycles-samples 256] [--size 256x192] [--columns 5]

Rows of three pictures, one above the other: PointSplat by AUTO, Cycles without bounces, and four times their difference
about grey, of displayed values. WORK keeps what was drawn: pictures that are there are not drawn again. The table goes
to stdout (scripts/common/images.py).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from scripts.benchmarks.beside_cycles import pictures
from scripts.benchmarks.beside_cycles.processes import Program, rendered
from scripts.common.images import compare, displayed
from scripts.common.process import run
from scripts.render import size

GAIN = 4.0
GAP = 4  # pixels between scenes
CYCLES = {"max_bounces": 0, "use_adaptive_sampling": False, "use_denoising": False}


def drawn(file: Path, program: Program, settings: dict, options: argparse.Namespace) -> np.ndarray:
    """(H, W, 4), drawn in a process of its own if it is not there. RuntimeError: it could not be."""
    wide, high = options.size
    path = options.folder / f"{file.stem}-{program.name}-{program.samples}-{wide}x{high}.exr"
    if not path.exists():
        found = rendered(file, program, [path], 1, settings, bytecode=options.folder / "bytecode", size=options.size)
        if "failed" in found:
            raise RuntimeError(f"{file}: {found['failed']}")
    return pictures.read(path)


def column(own: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(3 H, W, 3) displayed, top row first."""
    shown, true = displayed(own), displayed(truth)
    return np.concatenate([part[::-1] for part in (shown, true, np.clip(0.5 + GAIN * (shown - true), 0, 1))])


def table_row(name: str, own: np.ndarray, truth: np.ndarray) -> str:
    found = compare(own, truth)
    brightness = own[..., :3].mean(dtype=float) / truth[..., :3].mean(dtype=float)
    return f"| {name} | {found['iou']:.4f} | {found['thickening']:.4f} | {found['psnr']:.1f} dB | {brightness:.3f} |\n"


def sheet(columns: list[np.ndarray], across: int) -> np.ndarray:
    """All columns, `across` of them beside one another, the rest below."""
    blank = np.ones_like(columns[0])
    columns = columns + [blank] * (-len(columns) % across)
    side, below = np.ones((len(blank), GAP, 3)), np.ones((GAP, across * (blank.shape[1] + GAP) - GAP, 3))
    rows: list[np.ndarray] = []
    for start in range(0, len(columns), across):
        row = [part for one in columns[start : start + across] for part in (one, side)][:-1]
        rows += [np.hstack(row), below]
    return np.vstack(rows[:-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--cycles-samples", type=int, default=256)
    parser.add_argument("--size", type=size, default=(256, 192), metavar="WxH")
    parser.add_argument("--columns", type=int, default=5)
    options = parser.parse_args()
    options.folder = options.folder.resolve()
    options.folder.mkdir(parents=True, exist_ok=True)
    sys.stdout.write("| scene | IoU | alpha | PSNR | brightness |\n|---|---|---|---|---|\n")
    columns = []
    for file in options.files:
        own = drawn(file.resolve(), Program("AUTO", options.samples), {}, options)
        truth = drawn(file.resolve(), Program("CYCLES", options.cycles_samples), CYCLES, options)
        columns.append(column(own, truth))
        sys.stdout.write(table_row(file.stem, own, truth))
    pixels = (255 * sheet(columns, min(options.columns, len(columns))) + 0.5).astype(np.uint8)
    Image.fromarray(pixels).save(options.output, quality=90)


if __name__ == "__main__":
    run(main)
