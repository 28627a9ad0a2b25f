"""Captured splats of files against the published formula in float64: the tables of docs/notes/splats.md, "Files".

    python -m scripts.studies.captured_formula DIR [--only NAME ...] [--size 240x180] [--far]

Each file below DIR is drawn from three sides by both ways of blending. Linear light is compared as it is, premultiplied;
what is blended as trained is compared in display values. The table has the lowest PSNR of each way, and how many pixels
differ by more than LARGE. At these a splat's alpha in float64 lies so near to 1/255, or two splats that show so near to
one depth, that rounding decides: they are counted, and the PSNR of all other pixels follows.

--far: smaller and smaller pictures instead, of which nodes draw the second one (docs/notes/splats.md, "Level of detail").
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.settings import BLENDINGS, Settings
from pointsplat_addon.core.scene.valid.captured import valid_captured
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.captured import LEAST_ALPHA
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.formats.splats.gather import read_all
from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing
from scripts.scenes.cameras import camera
from tests.reference import captured as reference

LARGE = 1e-3  # a difference that is looked into: a threshold changes a pixel by up to 1/255
NEAR_ALPHA = 1e-3  # of 1/255: relative error of an alpha in float32, whose exponent has rounded centres in it
NEAR_DEPTH = 4e-7  # of the object's extent: a few roundings of float32
DIRECTIONS = (0.6, -1.2, 1.6), (-1.5, -0.8, -0.5), (1.1, 1.3, -0.9)
FAR = 160, 120, 96, 72, 56, 48, 40, 32, 24, 16  # sides of pictures


@dataclass(frozen=True)
class Seen:
    """One file from one side."""

    splats: CapturedSplats
    eye: Camera
    key: str

    def expected(self) -> dict[str, np.ndarray]:
        """(H, W, 4) by way of blending: the formula, of light or display values."""
        seen = self.projected()
        found = reference.blend(seen, self.eye.window[2:])
        return {"LINEAR": found[..., [0, 1, 2, 6]], "TRAINED": found[..., 3:]}

    def projected(self) -> reference.Projected:
        """With linear colours, and then display values: (N, 6)."""
        shown = reference.project(self.splats, np.eye(4), self.eye, trained=True)
        return replace(shown, color=np.concatenate([reference.linear_from_display(shown.color), shown.color], axis=1))

    def drawn(self, blending: str) -> tuple[np.ndarray, int]:
        """(H, W, 4) of light or display values, and how many splats and nodes were drawn."""
        thing = build.captured(self.key, self.splats), build.moved()
        made = build.scene(thing, lights=(), world=World(), transparent=True)
        settings = Settings(use_shadows=False, captured_blending=blending)
        result = drawing.opengl().render(made, Request(self.eye, settings, frozenset({"combined"}), 1))
        assert not [warning for warning in result.report["warnings"] if "blended" in warning]
        found = result.pixels["combined"].astype(np.float64)
        if blending == "TRAINED":
            alpha = found[..., 3:]
            straight = found[..., :3] / np.where(alpha > 0, alpha, 1)
            found = np.concatenate([reference.display_from_linear(straight) * alpha, alpha], axis=-1)
        return found, result.report["points"]["cut"]


def decode(data: bytes, _name: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))


def files(folder: Path) -> Iterator[Path]:
    """All files of splats below a folder; of streamed sets the one that names the others."""
    for path in sorted(folder.rglob("*")):
        if path.suffix in {".ply", ".spz", ".splat", ".ksplat", ".sog"} or path.name == "lod-meta.json":
            yield path


def views(path: Path, size: tuple[int, int], sides: int) -> Iterator[Seen]:
    """The file from some sides: most of it fills the picture."""
    with open_splats(path, decode) as reader:
        splats, _ = valid_captured(read_all(reader))
    centre = np.median(splats.position, axis=0) + splats.origin
    away = np.linalg.norm(splats.position + splats.origin - centre, axis=1) + splats.scale.max(axis=1)
    radius = float(np.percentile(away, 90))
    for number, direction in enumerate(DIRECTIONS[:sides]):
        at = centre + radius * np.array(direction)
        eye = camera(at, centre, resolution=size, field_of_view=50, near=0.05 * radius, far=1e3 * radius)
        yield Seen(splats, eye, f"{path} {number}")


def undecided(seen: Seen, pixels: np.ndarray) -> np.ndarray:
    """(K, 2) bool of pixels (K, 2), rows and columns: whether rounding decides a threshold, and an order, in each."""
    projected = seen.projected()
    extent = float(np.ptp(projected.depth)) + float(np.abs(projected.depth).min())
    found = np.zeros((len(pixels), 2), bool)
    for at, (row, column) in enumerate(pixels):
        v = np.array([column + 0.5, row + 0.5]) - projected.centre
        alpha = projected.opacity * np.exp(-0.5 * np.einsum("ni,nij,nj->n", v, projected.conic, v))
        found[at, 0] = bool((np.abs(alpha / LEAST_ALPHA - 1) < NEAR_ALPHA).any())
        depth = np.sort(projected.depth[alpha >= LEAST_ALPHA])
        found[at, 1] = bool((np.diff(depth) < NEAR_DEPTH * extent).any())
    return found


def near_row(path: Path, size: tuple[int, int]) -> str:
    """One file's row: splats; of each way of blending PSNR, pixels that differ, and PSNR of those that are decided."""
    cells: dict[str, list] = {blending: [] for blending in BLENDINGS}
    count = 0
    for seen in views(path, size, len(DIRECTIONS)):
        count, expected = len(seen.splats), seen.expected()
        for blending, formula in expected.items():
            found = seen.drawn(blending)[0]
            off = np.abs(found - formula).max(axis=-1)
            large = np.argwhere(off > LARGE)
            why = undecided(seen, large)
            decided = np.ones(off.shape, bool)
            decided[tuple(large[why.any(axis=1)].T)] = False
            rest = reference.psnr(found[decided], formula[decided])
            cells[blending].append((reference.psnr(found, formula), len(large), *why.sum(axis=0), rest, off.max()))
    said = []
    for rows in cells.values():
        decibels, large, threshold, order, rest, most = np.array(rows).T
        said.append(f"{decibels.min():.1f} | {large.sum():.0f} ({threshold.sum():.0f}, {order.sum():.0f}) | "
                    f"{rest.min():.1f} | {most.max():.4f}")  # fmt: skip
    return f"| {path.name} | {count} | {' | '.join(said)} |"


def far_rows(path: Path) -> Iterator[str]:
    """The largest picture that nodes draw, and the smaller ones down to a tenth of the splats."""
    for side in FAR:
        (seen,) = views(path, (side, side), 1)
        seen = replace(seen, key=f"{path} far")
        shares, found = [], []
        expected = seen.expected()
        for blending in BLENDINGS:
            seen.drawn(blending)
            picture, count = seen.drawn(blending)
            shares.append(count / len(seen.splats))
            found.append(reference.psnr(picture, expected[blending]))
        if shares[0] < 1:
            yield f"| {path.name} | {side} | {100 * shares[0]:.0f} % | {found[0]:.1f} | {found[1]:.1f} |"
        if shares[0] < 0.1:
            return


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="a folder of files of captured splats")
    parser.add_argument("--only", nargs="*", default=[], help="parts of the names of those that are drawn")
    parser.add_argument("--size", default="240x180")
    parser.add_argument("--far", action="store_true")
    given = parser.parse_args(arguments)
    width, height = map(int, given.size.split("x"))
    for path in files(given.data):
        if given.only and not any(name in path.name for name in given.only):
            continue
        try:
            for row in far_rows(path) if given.far else [near_row(path, (width, height))]:
                print(row, flush=True)
        except PointFileError as error:
            print(f"| {path.name} | {error} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
