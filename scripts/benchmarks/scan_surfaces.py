"""How well the shape Surface shows a mesh from which a scan was sampled, beside balls of the best radius.

    python -m scripts.benchmarks.scan_surfaces MESH.obj|MESH.ply[.gz] ... [--side 256] [--views 24] [--pictures DIR]

Points are random on the surface, with normally distributed noise of a third of the spacing. For each
spacing in pixels: the share of the silhouette, eroded by a pixel, that is covered in the worst view; the least
intersection over union; the PSNR against the mesh, of all views together, and that of balls of the best of RADII.
"""

import argparse
import gzip
from pathlib import Path

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud, coherent
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.surface.neighbourhoods.estimate import estimate_ellipses
from scripts.scenes import build, cameras
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SPACINGS = 2.0, 1.0, 0.5  # pixels
NOISE = 1 / 3  # spacings
RADII = 0.4, 0.55, 0.7, 0.9, 1.2  # of balls, in spacings
SWEEP = 4  # views that choose among them
SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
COMBINED = frozenset({"combined"})
FIT = 0.8  # of the picture's side, that the object's sphere spans


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and triangles (T, 3) of a file, scaled into the unit sphere."""
    if path.suffix == ".obj":
        lines = [line.split() for line in path.read_text(errors="replace").splitlines()]
        position = np.array([line[1:4] for line in lines if line[:1] == ["v"]], float)
        faces = [[int(word.split("/")[0]) for word in line[1:]] for line in lines if line[:1] == ["f"]]
        triangles = np.array([(f[0], f[i], f[i + 1]) for f in faces for i in range(1, len(f) - 1)])
        triangles = np.where(triangles > 0, triangles - 1, len(position) + triangles)
    else:
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        head, body = data.split(b"end_header\n", 1)
        counts = [int(line.split()[2]) for line in head.decode().splitlines() if line.startswith("element")]
        lines = body.split(b"\n")
        position = np.array([line.split()[:3] for line in lines[: counts[0]]], float)
        triangles = np.array([line.split()[1:4] for line in lines[counts[0] : sum(counts[:2])]], int)
    used = position[np.unique(triangles)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    position = (position - middle) / np.linalg.norm(used - middle, axis=1).max()
    return position, triangles


def surface_samples(
    position: np.ndarray, triangles: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random points of a surface, equally dense everywhere, and its unit normals there: (count, 3) float64 each."""
    corners = position[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    which = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = corners[which].transpose(1, 0, 2)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), across[which] / (2 * area[which])[:, None]


def sampled(position: np.ndarray, triangles: np.ndarray, spacing: float, seed: int = 0) -> np.ndarray:
    """Random points (N, 3) float32 of a surface, one to each square of the spacing, with noise."""
    rng = np.random.default_rng(seed)
    corners = position[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    points, _ = surface_samples(position, triangles, int(area.sum() / spacing**2), rng)
    return (points + NOISE * spacing * rng.normal(size=points.shape)).astype(np.float32)


def views(count: int, side: int) -> list:
    """Cameras on a sphere (Fibonacci), in parallel projection."""
    k = np.arange(count)
    z, turn = 1 - (2 * k + 1) / count, k * np.pi * (3 - np.sqrt(5))
    rim = np.sqrt(1 - z * z)
    return [
        cameras.camera(3 * at, (0, 0, 0), (side, side), parallel=2 / FIT)
        for at in np.stack([rim * np.cos(turn), rim * np.sin(turn), z], axis=1)
    ]


def surface_cloud(points: np.ndarray) -> PointCloud:
    """The points as Surface draws them."""
    found = estimate_ellipses(points)
    return coherent(PointCloud(points + found.offset, normal=found.normal, axis=found.axis, radii=found.radii))


def ball_cloud(points: np.ndarray, radius: float) -> PointCloud:
    return coherent(PointCloud(points, radii=np.full((len(points), 1), radius, np.float32)))


def pictures(thing, cameras: list) -> list[np.ndarray]:
    scene = build.scene((thing, np.eye(4)), lights=[build.sun()], transparent=True)
    return [render(Case(scene, camera, SETTINGS), COMBINED, 16).pixels["combined"] for camera in cameras]


def psnr(found: list[np.ndarray], truth: list[np.ndarray]) -> float:
    """In dB, of display values in [0, 1] over all pixels."""

    def shown(picture: np.ndarray) -> np.ndarray:
        return np.clip(picture[..., :3], 0, 1) ** (1 / 2.2)

    error = [np.mean((shown(a) - shown(b)) ** 2) for a, b in zip(found, truth, strict=True)]
    return float(-10 * np.log10(np.mean(error)))


def coverage(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Share of the eroded silhouette that is covered, and intersection over union."""
    inside = truth[..., 3] > 0.999
    eroded = inside.copy()
    for shift in np.ndindex(3, 3):
        eroded &= np.roll(inside, (shift[0] - 1, shift[1] - 1), axis=(0, 1))
    a, b = found[..., 3], truth[..., 3]
    return float(np.mean(a[eroded])), float(np.minimum(a, b).sum() / np.maximum(a, b).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--side", type=int, default=256)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args()
    looks = views(given.views, given.side)
    few = looks[:: max(1, len(looks) // SWEEP)]
    print("| mesh | spacing, px | points | covered, worst | IoU, worst | PSNR | balls, PSNR | radius | gain |")
    for path in given.meshes:
        position, triangles = read_mesh(path)
        name = path.name.split(".")[0]
        whole = Mesh(key=name, name=name, position=position.astype(np.float32), triangles=triangles.astype(np.int32))
        truth = pictures(build.mesh(whole, "POLYGONS"), looks)
        for pixels in SPACINGS:
            spacing = pixels * 2 / FIT / given.side
            points = sampled(position, triangles, spacing)
            found = pictures(build.points(f"{name} {pixels}", surface_cloud(points)), looks)
            covered, union = zip(*(coverage(a, b) for a, b in zip(found, truth, strict=True)), strict=True)
            true_few = truth[:: max(1, len(looks) // SWEEP)]
            swept = {}
            for radius in RADII:
                balls = build.points(f"{name} {pixels} {radius}", ball_cloud(points, radius * spacing))
                swept[radius] = psnr(pictures(balls, few), true_few)
            best = max(swept, key=swept.__getitem__)
            balls = pictures(build.points(f"{name} {pixels} best", ball_cloud(points, best * spacing)), looks)
            own, other = psnr(found, truth), psnr(balls, truth)
            print(
                f"| {name} | {pixels:g} | {len(points):,} | {100 * min(covered):.2f} % | {min(union):.4f} | "
                f"{own:.1f} | {other:.1f} | {best:g} | {own - other:+.1f} |",
                flush=True,
            )
            if given.pictures:
                row = np.concatenate([p[0][::-1] for p in (truth, found, balls)], axis=1)
                np.save(given.pictures / f"{name}_{pixels:g}.npy", row)


if __name__ == "__main__":
    main()
