"""Errors of shadow tables over their resolution: smoke against its exact integral, the edge of an opaque plane.

python -m scripts.studies.shadow_convergence --output shadow_convergence.png [--quick]

Left: a normal density, DEVIATION wide and of optical depth DEPTH through its middle, at 1,000 points behind it, as
voxels and as fine dust. Right: an opaque half plane of disks, within NEAR of its edge.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.shadow import builder
from pointsplat_addon.core.splat.kernel import EVEN_SPACING
from scripts.common.shadow_truth import transmittance

RESOLUTIONS = (16, 32, 64, 128, 256, 512, 1024, 2048)
DEVIATION, DEPTH = 0.4, 3.0
VOXELS, HALF = 128, 1.6  # along a side; half a side
GRAINS, GRAIN = 3_000_000, 0.001  # splats of dust; their radius
SPACING, NEAR = 0.002, 0.1  # of disks
DOWN = np.array([0.0, 0.0, -1.0])
LIGHTS = {
    "sun": Light("SUN", np.ones(3), np.zeros(3), DOWN),
    "lamp outside": Light("POINT", np.ones(3), np.array([0.1, 0.2, 3.0]), DOWN),
    "lamp inside": Light("POINT", np.ones(3), np.array([0.1, 0.2, 0.3]), DOWN),
}
PEAK = DEPTH / (DEVIATION * math.sqrt(2 * math.pi))  # extinction in the middle


def balls(position: np.ndarray, radius: float, mass: np.ndarray) -> PointCloud:
    """Splats of one radius and the optical mass (N,) each."""
    share = mass / (4 / 3 * np.pi * radius**3)
    count = len(position)
    return PointCloud(position.astype(np.float32), radii=np.full((count, 1), radius, np.float32),
                      extinction=np.broadcast_to(share, count).astype(np.float32))  # fmt: skip


def voxels(count: int) -> PointCloud:
    step = 2 * HALF / count
    x = (np.arange(count) + 0.5) * step - HALF
    position = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    density = PEAK * np.exp(-(position**2).sum(axis=1) / (2 * DEVIATION**2))
    return balls(position, 2 * EVEN_SPACING * step, density * step**3)


def dust(count: int) -> PointCloud:
    position = np.random.default_rng(0).normal(0, DEVIATION, (count, 3))
    return balls(position, GRAIN, np.array([DEPTH * 2 * np.pi * DEVIATION**2 / count]))


def exact_depth(light: Light, points: np.ndarray) -> np.ndarray:
    """(N,) the normal density's integral from the light to points (N, 3)."""
    if light.kind == "SUN":
        way = np.broadcast_to(light.direction, points.shape)
        begin = np.full(len(points), -np.inf)
    else:
        way = points - light.position
        way = way / np.linalg.norm(way, axis=1, keepdims=True)
        begin = (light.position * way).sum(axis=1)
    end = (points * way).sum(axis=1)
    aside = (points**2).sum(axis=1) - end**2
    erf = np.vectorize(math.erf, otypes=[float])
    scale = DEVIATION * math.sqrt(2)
    along = PEAK * scale * math.sqrt(math.pi) / 2 * (erf(end / scale) - erf(begin / scale))
    return along * np.exp(-aside / (2 * DEVIATION**2))


def smoke_error(cloud: PointCloud, light: Light, resolution: int) -> float:
    """Root mean square error of T at points behind the smoke."""
    x = np.random.default_rng(1).uniform(-0.8, 0.8, (1000, 2))
    points = np.c_[x, np.full(len(x), -1.7)]
    table = builder.build_table(light, [builder.casters(cloud, np.eye(4))], resolution)
    error = transmittance(table, points) - np.exp(-exact_depth(light, points))
    return float(np.sqrt((error**2).mean()))


def edge_error(light: Light, resolution: int, spacing: float) -> float:
    """Mean error of T within NEAR of the shadow of the edge x = 0 of a plane of 1 by 2 in z = 0."""
    x, y = (np.arange(round(1 / spacing)) + 0.5) * spacing, (np.arange(round(2 / spacing)) + 0.5) * spacing - 1
    position = np.stack(np.meshgrid(x, y, [0.0]), axis=-1).reshape(-1, 3).astype(np.float32)
    normal = np.broadcast_to(-DOWN.astype(np.float32), position.shape).copy()
    radii = np.full((len(position), 1), spacing * math.sqrt(2 / math.pi), np.float32)
    plane = PointCloud(position, normal=normal, radii=radii)
    table = builder.build_table(light, [builder.casters(plane, np.eye(4))], resolution)
    rng = np.random.default_rng(2)
    crossing = np.c_[rng.uniform(-NEAR, NEAR, 4000), rng.uniform(-0.5, 0.5, 4000), np.zeros(4000)]
    way = np.broadcast_to(DOWN, crossing.shape) if light.kind == "SUN" else crossing - light.position
    points = crossing + way * (0.5 / -way[:, 2:])
    return float(np.abs(transmittance(table, points) - (crossing[:, 0] < 0)).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", required=True)
    parser.add_argument("--quick", action="store_true", help="an eighth of the voxels and grains")
    arguments = parser.parse_args()
    cloud = voxels(VOXELS // 2 if arguments.quick else VOXELS)
    fine = dust(GRAINS // 8 if arguments.quick else GRAINS)
    left = {f"voxels, {n}": [smoke_error(cloud, light, r) for r in RESOLUTIONS] for n, light in LIGHTS.items()}
    left["fine dust, sun"] = [smoke_error(fine, LIGHTS["sun"], r) for r in RESOLUTIONS]
    spacing = SPACING * (2 if arguments.quick else 1)
    names = {"sun": "sun", "lamp": "lamp outside"}
    right = {n: [edge_error(LIGHTS[light], r, spacing) for r in RESOLUTIONS] for n, light in names.items()}
    for name, errors in (left | right).items():
        print(f"{name:20}", *(f"{e:.5f}" for e in errors))
    plot(left, right, arguments.output)


def plot(left: dict[str, list[float]], right: dict[str, list[float]], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(8.6, 3.3), sharey=True, layout="constrained")
    titles = ("Smoke: RMS error of T behind it", "Edge of an opaque plane: mean error of T")
    for axis, curves, title in zip(axes, (left, right), titles, strict=True):
        for name, errors in curves.items():
            axis.loglog(RESOLUTIONS, errors, "--" if "dust" in name else "-", marker="o", markersize=3, label=name)
        axis.set(title=title, xlabel="cells per half turn, or across what casts")
        axis.set(xticks=RESOLUTIONS, xticklabels=[str(r) for r in RESOLUTIONS])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7, loc=(0.22, 0.69) if axis is axes[0] else "upper right")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
