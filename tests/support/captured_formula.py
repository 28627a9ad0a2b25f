"""Captured splats of files against the published formula in float64: the tables of docs/notes/splats.md, "Files".

    python -m tests.support.captured_formula DIR [--only NAME ...] [--size 240x180] [--far]

Each file below DIR is drawn from three sides by both ways of blending. Linear light is compared as it is,
premultiplied; what is blended as trained is compared in display values. Of each way the table has the lowest PSNR; the
lowest one against the formula whose splats are ordered by depths in float32, as the renderer has them; how many pixels
still differ by more than LARGE, and in how many of these a splat's alpha in float64 lies so near to 1/255 that rounding
decides whether it shows; and the lowest PSNR without the latter.

--far: smaller and smaller pictures instead, at a tolerance of one pixel and at one that lets nodes draw the second
picture (notes: "Level of detail"): the lowest PSNR of the three sides, and the largest share of the splats that nodes
draw.
As if not antialiased: of splats that are, the formula leaves out what is too faint one by one, which nodes do not.
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
from pointsplat_addon.core.splat.captured import LEAST_ALPHA, bounds_of_scales, seen
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.captured import view_from_splats
from scripts.scenes import build, drawing
from scripts.scenes.cameras import camera
from tests.reference import captured as reference
from tests.support.splat_files import read_all

LARGE = 1e-3  # a difference that is looked into: a threshold changes a pixel by up to 1/255
NEAR_ALPHA = 1e-3  # of 1/255: relative error of an alpha in float32, whose exponent has rounded centres in it
DIRECTIONS = (0.6, -1.2, 1.6), (-1.5, -0.8, -0.5), (1.1, 1.3, -0.9)
FAR = 48, 32, 24, 16, 8  # sides of pictures
BY_NODES = 1.01  # pixels: a tolerance at which nodes are drawn


@dataclass(frozen=True)
class Shot:
    """One file from one side."""

    splats: CapturedSplats
    eye: Camera
    key: str

    def expected(self, rounded: bool = False) -> dict[str, np.ndarray]:
        """(H, W, 4) by way of blending: the formula, of light or display values. `rounded`: in the renderer's order."""
        projected = self.projected()
        if rounded:
            projected = replace(projected, depth=self.rounded_depth())
        found = reference.blend(projected, self.eye.window[2:])
        return {"LINEAR": found[..., [0, 1, 2, 6]], "TRAINED": found[..., 3:]}

    def projected(self) -> reference.Projected:
        """With linear colours, and then display values: (N, 6)."""
        shown = reference.project(self.splats, np.eye(4), self.eye, trained=True)
        return replace(shown, color=np.concatenate([reference.linear_from_display(shown.color), shown.color], axis=1))

    def rounded_depth(self) -> np.ndarray:
        """(N,) float32, less that of the origin, of those that `projected` has."""
        view = self.eye.view_from_world
        matrix = view_from_splats(view, self.splats.origin)
        largest = bounds_of_scales(self.splats)
        depth = np.full(len(self.splats), np.inf, np.float32)
        for everywhere in (True, False):
            rows, found = seen(self.splats, largest, matrix, self.eye, everywhere)
            depth[rows] = found
        exact = -((self.splats.position.astype(float) + self.splats.origin) @ view[2, :3] + view[2, 3])
        return depth[(exact > self.eye.nearest) & (exact < self.eye.far)]

    def drawn(self, blending: str, tolerance: float = 1.0) -> tuple[np.ndarray, int]:
        """(H, W, 4) of light or display values, and how many splats and nodes were drawn."""
        thing = build.captured(self.key, self.splats), build.moved()
        made = build.scene(thing, lights=(), world=World(), transparent=True)
        settings = Settings(use_shadows=False, captured_blending=blending, tolerance=tolerance)
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


def views(path: Path, size: tuple[int, int], sides: int) -> Iterator[Shot]:
    """The file from some sides: most of it fills the picture."""
    with open_splats(path, decode) as reader:
        splats, _ = valid_captured(read_all(reader))
    centre = np.median(splats.position, axis=0) + splats.origin
    away = np.linalg.norm(splats.position + splats.origin - centre, axis=1) + splats.scale.max(axis=1)
    radius = float(np.percentile(away, 90))
    for number, direction in enumerate(DIRECTIONS[:sides]):
        at = centre + radius * np.array(direction)
        eye = camera(at, centre, resolution=size, field_of_view=50, near=0.05 * radius, far=1e3 * radius)
        yield Shot(splats, eye, f"{path} {number}")


def undecided(shot: Shot, pixels: np.ndarray) -> np.ndarray:
    """(K,) bool of pixels (K, 2), rows and columns: whether rounding decides if some splat shows in each."""
    projected, found = shot.projected(), np.zeros(len(pixels), bool)
    for at, (row, column) in enumerate(pixels):
        v = np.array([column + 0.5, row + 0.5]) - projected.centre
        alpha = projected.opacity * np.exp(-0.5 * np.einsum("ni,nij,nj->n", v, projected.conic, v))
        found[at] = bool((np.abs(alpha / LEAST_ALPHA - 1) < NEAR_ALPHA).any())
    return found


def near_row(path: Path, size: tuple[int, int]) -> str:
    """One file's row: splats, and of each way of blending what the module says."""
    cells: dict[str, list] = {blending: [] for blending in BLENDINGS}
    count = 0
    for shot in views(path, size, len(DIRECTIONS)):
        count, expected, ordered = len(shot.splats), shot.expected(), shot.expected(rounded=True)
        for blending, formula in ordered.items():
            found = shot.drawn(blending)[0]
            off = np.abs(found - formula).max(axis=-1)
            large = np.argwhere(off > LARGE)
            threshold = undecided(shot, large)
            rest = np.ones(off.shape, bool)
            rest[tuple(large[threshold].T)] = False
            cells[blending].append((
                reference.psnr(found, expected[blending]), reference.psnr(found, formula), len(large), threshold.sum(),
                reference.psnr(found[rest], formula[rest]),
            ))  # fmt: skip
    said = []
    for rows in cells.values():
        decibels, in_order, large, threshold, rest = np.array(rows).T
        said.append(f"{decibels.min():.1f} | {in_order.min():.1f} | {threshold.sum():.0f} of {large.sum():.0f} | "
                    f"{rest.min():.1f}")  # fmt: skip
    return f"| {path.name} | {count} | {' | '.join(said)} |"


def far_rows(path: Path) -> Iterator[str]:
    """Of pictures of each size: the lowest PSNR of all splats, and where nodes draw, their share and PSNR."""
    for side in FAR:
        exact, shares, found = [], [0.0], []
        for shot in views(path, (side, side), len(DIRECTIONS)):
            shot = replace(shot, key=f"{shot.key} far", splats=replace(shot.splats, antialiased=False))
            expected = shot.expected()
            exact.append([reference.psnr(shot.drawn(blending)[0], expected[blending]) for blending in BLENDINGS])
            for blending in BLENDINGS:
                shot.drawn(blending, BY_NODES)
            pictures = [shot.drawn(blending, BY_NODES) for blending in BLENDINGS]
            if pictures[0][1] < len(shot.splats):
                shares.append(pictures[0][1] / len(shot.splats))
                found.append(
                    [
                        reference.psnr(picture, expected[blending])
                        for (picture, _), blending in zip(pictures, BLENDINGS, strict=True)
                    ]
                )
        cells = [f"{value:.1f}" for value in np.min(exact, axis=0)]
        cells += [f"{100 * max(shares):.0f} %", *(f"{value:.1f}" for value in np.min(found, axis=0))] if found else []
        yield f"| {path.name} | {side} | {' | '.join(cells)} |"


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
