"""What bounds how well the shape Surface shows a mesh: the truth put in the place of what it estimates.

    python -m scripts.benchmarks.scan_bounds MESH.obj|MESH.ply[.gz] ... [--side 320] [--views 24] [--spacings 2 1]

Samples, views and measures are those of `scan_surfaces`. Elements keep their sizes, while their centres move to the
nearest place on the mesh, their normals become those of the mesh there, or both; last, balls become disks, too. It
needs SciPy.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.mesh import Mesh
from scripts.scenes import build

from .scan_surfaces import FIT, coverage, pictures, psnr, read_mesh, sampled, surface_cloud, surface_samples, views

DENSE = 1_500_000  # samples of the mesh among which the nearest is looked for


def true_places(points: np.ndarray, position: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest places on a mesh to points (N, 3), and its unit normals there, (N, 3) float32 each."""
    places, normals = surface_samples(position, triangles, DENSE, np.random.default_rng(1))
    _, nearest = cKDTree(places).query(points)
    return places[nearest].astype(np.float32), normals[nearest].astype(np.float32)


def turned(cloud: PointCloud, normal: np.ndarray) -> PointCloud:
    """The cloud with normals (N, 3): its axes are turned into the new planes; where a normal is zero, it has a ball."""
    assert cloud.axis is not None
    helper = np.eye(3, dtype=np.float32)[np.abs(normal).argmin(axis=1)]
    axis = cloud.axis - np.einsum("nc,nc->n", cloud.axis, normal)[:, None] * normal
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    across = np.cross(normal, helper)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    axis = np.where(length > 1e-3, axis / np.maximum(length, 1e-30), across)
    axis[~normal.any(axis=1)] = 0
    return replace(cloud, normal=normal, axis=axis.astype(np.float32))


def with_truths(cloud: PointCloud, position: np.ndarray, triangles: np.ndarray) -> dict[str, PointCloud]:
    """The cloud as estimated, and with truths in it, by what they are."""
    assert cloud.normal is not None
    place, normal = true_places(cloud.position, position, triangles)
    disks = np.where(cloud.normal.any(axis=1)[:, None], normal, 0).astype(np.float32)
    return {
        "as estimated": cloud,
        "centres": replace(cloud, position=place),
        "normals": turned(cloud, disks),
        "centres, normals": replace(turned(cloud, disks), position=place),
        "centres, normals, no balls": replace(turned(cloud, normal), position=place),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--side", type=int, default=320)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--spacings", type=float, nargs="+", default=[2.0, 1.0])
    given = parser.parse_args()
    looks = views(given.views, given.side)
    print("| mesh | spacing, px | true | covered, worst | IoU, worst | PSNR |")
    for path in given.meshes:
        position, triangles = read_mesh(path)
        name = path.name.split(".")[0]
        whole = Mesh(key=name, name=name, position=position.astype(np.float32), triangles=triangles.astype(np.int32))
        truth = pictures(build.mesh(whole, "POLYGONS"), looks)
        for pixels in given.spacings:
            points = sampled(position, triangles, pixels * 2 / FIT / given.side)
            for which, cloud in with_truths(surface_cloud(points), position, triangles).items():
                found = pictures(build.points(f"{name} {pixels} {which}", cloud), looks)
                covered, union = zip(*(coverage(a, b) for a, b in zip(found, truth, strict=True)), strict=True)
                print(
                    f"| {name} | {pixels:g} | {which} | {100 * min(covered):.2f} % | {min(union):.4f} | "
                    f"{psnr(found, truth):.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
