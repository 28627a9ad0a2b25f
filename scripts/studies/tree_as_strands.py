"""A tree's branches and leaves as strands, beside its polygons: vertices, PSNR by the size of leaves, processor time.

    python -m scripts.studies.tree_as_strands [--strip OUT.png] [--time]

The Japanese maple of assets/, in plain colours and shaded flat (its leaves are closed and
thin, so that normals of their vertices lie in the leaf), under a sun and a weak world. What no strand
was found for stays polygons in both pictures. Leaves are as long in pixels as the median leaf seen face on from the
eye's distance; the tree fills the picture, whose size follows from that. PSNR is of sRGB values over black, of the
picture and of the pixels that either tree covers. The strip has polygons, lines, and GAIN times their difference.
"""

from __future__ import annotations

import argparse
import gzip
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from pointsplat_addon.core.numeric.segments import offsets, ranges
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.strand.fit.from_mesh import fit_strands
from pointsplat_addon.core.strand.fit.graph import connected_parts
from pointsplat_addon.core.strand.fit.result import FittedStrands
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import displayed, psnr
from scripts.scenes import build, cameras, meshes

ROOT = Path(__file__).resolve().parents[2]
TREE = ROOT / "assets" / "japanese_maple" / "japaneseMaple.obj.gz"
COLORS = [[0.22, 0.15, 0.1], [0.45, 0.08, 0.05]]  # of the trunk, and of the twigs with their leaves
LEAVES = (2.4, 4.3, 8.0)  # pixels
FILLED = 0.95  # of the picture's width, by the tree
SAMPLES = 16
ANGLE = 30.0  # degrees of the view
GAIN = 4.0
MANY, FIELD = 10, 512  # trees, and the side of their picture in pixels, that are timed
TIMES = 5


@dataclass(frozen=True, eq=False)
class Tree:
    """Triangles of a file, in its units."""

    position: np.ndarray  # (V, 3) float64
    triangles: np.ndarray  # (T, 3) int64
    material: np.ndarray  # (T,) int64

    @property
    def middle(self) -> np.ndarray:
        return (self.position.min(axis=0) + self.position.max(axis=0)) / 2


@dataclass(frozen=True)
class Row:
    """One comparison."""

    leaf: float  # pixels
    size: int  # pixels
    shadows: bool
    psnr: float  # dB
    where: float  # dB, where the tree is
    area: float  # alpha of the lines over that of the polygons


@cache
def maple() -> Tree:
    """The tree; y is up in its file, z here."""
    places, corners, objects = [], [], -1
    with gzip.open(TREE, "rt") as lines:
        for line in lines:
            kind, *rest = line.split()
            if kind == "v":
                places.append(rest)
            elif kind == "o":
                objects += 1
            elif kind == "f":
                face = [corner.split("/")[0] for corner in rest]
                corners += [[face[0], face[k], face[k + 1], objects] for k in range(1, len(face) - 1)]
    index = np.array(corners, np.int64)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    position, triangles = np.array(places, float) @ turn.T, index[:, :3] - 1
    return Tree(position, triangles, index[:, 3])


def mesh(key: str, tree: Tree, kept: np.ndarray) -> list[Geometry]:
    """The triangles that are `kept` (T,), those of each material for itself."""
    found = []
    for material in np.unique(tree.material[kept]):
        rows = kept & (tree.material == material)
        used, triangles = np.unique(tree.triangles[rows], return_inverse=True)
        name = f"{key} {material}"
        position = (tree.position[used] - tree.middle).astype(np.float32)
        one = meshes.flat_mesh(name, position, triangles.reshape(-1, 3), materials=(int(material),))
        found.append(Geometry(name, name, mesh=one, primitive="POLYGONS"))
    return found


def strands(key: str, tree: Tree, found: FittedStrands, kept: np.ndarray) -> list[Geometry]:
    """The strands that are `kept` (S,), those of each kind and material for themselves."""
    result = []
    for ribbon in (False, True):
        for material in range(len(COLORS)):
            rows = np.flatnonzero((found.ribbon == ribbon) & (tree.material[found.triangle] == material) & kept)
            count = np.diff(found.start)[rows]
            if len(rows) == 0:
                continue
            start = offsets(count)
            points = ranges(found.start[rows], count)
            name = f"{key} {material} {'ribbons' if ribbon else 'tubes'}"
            lines = Strands(
                name, name, (found.position[points] - tree.middle).astype(np.float32), start,
                found.radius[points].astype(np.float32), materials=(material,),
                normal=found.normal[points].astype(np.float32) if ribbon else None,
            )  # fmt: skip
            result.append(Geometry(name, name, strands=lines, primitive="LINES"))
    return result


def vertices(tree: Tree, found: FittedStrands) -> tuple[int, int]:
    """How many points of strands and vertices of polygons the tree takes as lines, and how many vertices it has."""
    return len(found.position) + len(np.unique(tree.triangles[found.remaining])), len(np.unique(tree.triangles))


def leaf_length(tree: Tree) -> float:
    """The longest distance of two corners of the median leaf: the parts with the commonest number of triangles."""
    _, part, count = np.unique(
        connected_parts(tree.triangles, len(tree.position))[tree.triangles[:, 0]],
        return_inverse=True,
        return_counts=True,
    )
    many = np.bincount(count)
    size = int((many * np.arange(len(many))).argmax())
    rows = np.flatnonzero(count[part] == size)
    corners = tree.position[tree.triangles[rows[np.argsort(part[rows], kind="stable")]]].reshape(-1, size * 3, 3)
    apart = corners[:, :, None] - corners[:, None]
    return float(np.median(np.sqrt(np.einsum("nijk,nijk->nij", apart, apart).max(axis=(1, 2)))))


def seen(tree: Tree, leaf: float) -> Camera:
    """A camera that the tree fills, with leaves of so many pixels."""
    width = float(np.ptp(tree.position, axis=0).max())
    size = round(leaf * width / (FILLED * leaf_length(tree)))
    away = width / FILLED / 2 / np.tan(np.radians(ANGLE) / 2)
    eye = away * np.array([0.25, -1, 0.2]) / np.linalg.norm([0.25, -1, 0.2])
    return cameras.camera(eye, resolution=(size, size), field_of_view=ANGLE, near=0.01 * away, far=3 * away)


def placed(geometries: list[Geometry], matrices: list[np.ndarray]) -> Scene:
    return build.scene(
        *((geometry, matrix) for matrix in matrices for geometry in geometries),
        lights=[build.sun(3.0)],
        table=build.materials(len(COLORS), base_color=COLORS, roughness=[0.8] * len(COLORS)),
        transparent=True,
    )


def pair(tree: Tree, found: FittedStrands, only: int | None = None) -> tuple[list[Geometry], list[Geometry]]:
    """The tree as polygons and as lines; of one material alone, if there is one."""
    every = np.ones(len(tree.triangles), bool) if only is None else tree.material == only
    key = f"maple {only}"
    lines = strands(key, tree, found, every[found.triangle])
    return mesh(key, tree, every), lines + mesh(f"{key} rest", tree, every & found.remaining)


def compared(
    renderer: Renderer, tree: Tree, found: FittedStrands, leaf: float, shadows: bool, only: int | None = None
) -> tuple[Row, np.ndarray, np.ndarray]:
    """The row, and both pictures (H, W, 4): polygons, lines."""
    camera = seen(tree, leaf)
    settings = Settings(use_shadows=shadows, use_adaptive_sampling=False)
    request = Request(camera, settings, frozenset({"combined"}), SAMPLES)
    truth, picture = (
        renderer.render(placed(geometries, [np.eye(4)]), request).pixels["combined"]
        for geometries in pair(tree, found, only)
    )
    a, b = picture[..., 3], truth[..., 3]
    everywhere = np.ones(a.shape, bool)
    row = Row(leaf, camera.resolution[0], shadows, psnr(picture, truth, everywhere),
              psnr(picture, truth, (a > 0) | (b > 0)), float(a.sum() / b.sum()))  # fmt: skip
    return row, truth, picture


def strip(truth: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """(H, 3 W, 3) uint8: polygons, lines, and their difference on middle grey."""
    a, b = displayed(truth), displayed(picture)
    both = np.concatenate([a, b, np.clip(0.5 + GAIN * (b - a), 0, 1)], axis=1)
    return np.round(255 * both[::-1]).astype(np.uint8)


def timed(renderer: Renderer, tree: Tree, found: FittedStrands, samples: int, away: float = 1.0) -> tuple[float, float]:
    """Seconds of processor time of MANY trees as polygons and as lines, in turns, the eye moved each time; they fill
    the picture, or 1 / `away` of its width."""
    width = float(np.ptp(tree.position, axis=0).max())
    matrices = []
    for k in range(MANY):
        turn = np.eye(4)
        c, s = np.cos(2.4 * k), np.sin(2.4 * k)
        turn[:2, :2] = [[c, -s], [s, c]]
        turn[:3, 3] = width * np.array([0.55 * (k % 5 - 2), 0.9 * (k // 5), 0])
        matrices.append(turn)
    both = [placed(geometries, matrices) for geometries in pair(tree, found)]
    spent = np.zeros((TIMES + 1, 2))
    for turn in range(TIMES + 1):
        eye = width * away * np.array([0.02 * turn, -3.6, 0.7])
        camera = cameras.camera(
            eye, resolution=(FIELD, FIELD), field_of_view=45, near=0.01 * width, far=20 * away * width
        )
        settings = Settings(use_shadows=False, use_adaptive_sampling=False)
        for k, scene in enumerate(both):
            before = time.process_time()
            renderer.render(scene, Request(camera, settings, frozenset({"combined"}), samples))
            spent[turn, k] = time.process_time() - before
    polygons, lines = np.median(spent[1:], axis=0)
    return float(polygons), float(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strip", type=Path, help="writes polygons, lines and their difference, at the largest leaves")
    parser.add_argument("--time", action="store_true", help=f"compares {MANY} trees' processor time instead")
    options = parser.parse_args()
    tree = maple()
    found = fit_strands(tree.position, tree.triangles)
    ours, all_of_it = vertices(tree, found)
    print(f"{ours} of {all_of_it} vertices, {ours / all_of_it:.1%}; {len(found)} strands of {found.parts} parts")
    renderer = Renderer(OpenGLDevice())
    if options.time:
        for away in (1.0, 4.0):
            for samples in (1, 8):
                polygons, lines = timed(renderer, tree, found, samples, away)
                both = f"{polygons:.2f} s, as lines {lines:.2f} s, {polygons / lines:.2f} times as fast"
                print(f"{1 / away:.2f} of the picture's width, {samples} samples: {both}")
        return
    for leaf in LEAVES:
        for shadows in (False, True):
            row, truth, picture = compared(renderer, tree, found, leaf, shadows)
            print(row)
    if options.strip:
        from PIL import Image

        Image.fromarray(strip(truth, picture)).save(options.strip)
    renderer.release()


if __name__ == "__main__":
    main()
