"""Light through clouds of splats: media, cards and crowns of leaves, and their mean transmittance in float64."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportCallIssue=false
# Attributes may be None by type; what is tested here has those that are asked for.
from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from pointsplat_addon.core.lod import hierarchy
from pointsplat_addon.core.lod.nodes import optics
from pointsplat_addon.core.numeric import vectors
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat import ellipsoids
from pointsplat_addon.core.splat.kernel import EVEN_SPACING, SUPPORT, kernel
from scripts.scenes import build
from scripts.scenes.build import moved, points
from scripts.scenes.clouds import leaves


def projected(cloud: PointCloud, direction: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 2) and covariances (N, 2, 2) of splats in the plane across a direction."""
    d = np.array(direction) / np.linalg.norm(direction)
    u = np.cross(d, [0.3, 0.5, 0.8])
    u /= np.linalg.norm(u)
    plane = np.stack([u, np.cross(d, u)])
    normal, axis, radii = ellipsoids.splat_frames(cloud, slice(None))
    halves = np.stack([axis, np.cross(normal.T, axis.T).T, normal]) * radii[:, None] / 2
    flat = np.einsum("xi,kin->nkx", plane, halves)
    covariance = np.einsum("nkx,nky->nxy", flat, flat) + 1e-12 * radii.max() ** 2 * np.eye(2)
    return cloud.position.astype(np.float64) @ plane.T, covariance


def mean_transmittance(
    cloud: PointCloud, half: float, direction: tuple[float, float, float], pixels: int = 96, hard: bool = False
) -> float:
    """Over the square about the origin with this half side: exp(-tau) of all splats.
    `hard`: opaque over their ellipses instead."""
    place, covariance = projected(cloud, direction)
    determinant, conic = np.linalg.det(covariance), np.linalg.inv(covariance)
    if hard:
        middle = np.full(len(cloud), optics.OPAQUE_DEPTH)
    elif cloud.extinction is not None:
        volume = 4 / 3 * np.pi * np.prod(ellipsoids.splat_frames(cloud, slice(None))[2], axis=0)
        middle = cloud.extinction * volume / (2 * np.pi * np.sqrt(determinant))
    else:
        # The mass is the depth times the seen area, which is that of the projected ellipse.
        middle = -2 * np.log1p(-np.minimum(cloud.opacity.astype(np.float64), 1 - 1e-16))
    step, tau = 2 * half / pixels, np.zeros(pixels * pixels)
    reach = (2 if hard else np.sqrt(SUPPORT)) * np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    spans, home = np.ceil(reach / step).astype(int) + 1, np.floor((place + half) / step).astype(int)
    for span in np.unique(spans):
        rows = np.flatnonzero(spans == span)
        window = np.stack(np.meshgrid(*[np.arange(-span, span + 1)] * 2), axis=-1).reshape(-1, 2)
        for some in np.array_split(rows, 1 + len(rows) * len(window) // 500_000):
            cell = home[some, None] + window
            x = (cell + 0.5) * step - half - place[some, None]
            q = np.einsum("nwx,nxy,nwy->nw", x, conic[some], x)
            seen = (q <= (4 if hard else SUPPORT)) & ((cell >= 0) & (cell < pixels)).all(axis=-1)
            depth = middle[some, None] * (np.ones_like(q) if hard else kernel(q))
            tau += np.bincount((cell[..., 1] * pixels + cell[..., 0])[seen], depth[seen], pixels * pixels)
    return float(np.exp(-tau).mean())


def levels(built: hierarchy.Hierarchy, least: int) -> Iterator[np.ndarray]:
    """Cuts of at least this many splats: each level of the tree, and the leaves above it; rows of `splats`."""
    tree = built.tree
    for first, last in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        leaves = np.flatnonzero(tree.child_count[:first] == 0)
        nodes = np.concatenate([leaves, np.arange(first, last)])
        if len(nodes) >= least:
            yield np.where(tree.point_count[nodes] > 1, len(built.cloud) + nodes, tree.first_point[nodes])


def voxel_ball(diameter: int, fraction: float = 1.0) -> np.ndarray:
    """Centres (N, 3) of the voxels in a ball, or of a random part of them."""
    line = np.arange(diameter) - (diameter - 1) / 2
    p = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    p = p[(p**2).sum(axis=1) <= diameter**2 / 4]
    return p[np.random.default_rng(0).random(len(p)) < fraction].astype(np.float32)


def medium(position: np.ndarray, extinction: float | np.ndarray, **attributes: np.ndarray) -> PointCloud:
    """Voxels of edge 1 and true extinction, as balls."""
    radius = 2 * EVEN_SPACING
    share = np.float32(1 / (4 / 3 * np.pi * radius**3)) * np.float32(extinction)
    own = np.broadcast_to(share, (len(position), *np.shape(share)[1:])).astype(np.float32).copy()
    return PointCloud(position, radii=np.full((len(position), 1), radius, np.float32), extinction=own, **attributes)


def cards(count: int, alpha: float, side: float, samples: int, seed: int = 0) -> PointCloud:
    """Square cards in all directions in the unit ball, each of samples^2 disks that overlap and add up to alpha."""
    rng = np.random.default_rng(seed)
    middle = rng.standard_normal((count, 3))
    middle *= np.cbrt(rng.random((count, 1))) / np.linalg.norm(middle, axis=1, keepdims=True)
    normal = rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    u, v = vectors.basis(normal.T)
    line = ((np.arange(samples) + 0.5) / samples - 0.5) * side
    x, y = (g.reshape(-1, 1) for g in np.meshgrid(line, line))
    position = (middle[:, None] + u.T[:, None] * x + v.T[:, None] * y).reshape(-1, 3)
    n, radius = len(position), 1.3 / np.sqrt(2) * side / samples
    depth = -np.log(1 - alpha) * (side / samples) ** 2 / (np.pi * radius**2)
    return PointCloud(
        position.astype(np.float32), normal=np.repeat(normal, samples**2, axis=0).astype(np.float32),
        radii=np.full((n, 1), radius, np.float32), opacity=np.full(n, -np.expm1(-depth), np.float32),
    )  # fmt: skip


def crown(count, depth):
    return build.scene((points(f"crown {count} {depth}", leaves(count, depth)), moved()), lights=(), transparent=True)


def voxels(
    across: float,
    thick: float,
    cells: int,
    extinction: float | np.ndarray = 1.0,
    seen: Callable[[np.ndarray], np.ndarray] | None = None,
    **more,
) -> PointCloud:
    """A slab about the origin, `thick` along y and `across` along x and z, of `cells` voxels through it."""
    edge = thick / cells
    side = (np.arange(round(across / edge)) + 0.5) * edge - across / 2
    depth = (np.arange(cells) + 0.5) * edge - thick / 2
    position = np.stack(np.meshgrid(side, depth, side, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    if seen is not None:
        position = position[seen(position)]
    count, radius = len(position), 2 * EVEN_SPACING * edge
    share = edge**3 / (4 / 3 * np.pi * radius**3)
    strength = np.broadcast_to(np.asarray(extinction, np.float32) * share, (count, *np.shape(extinction)))
    black = np.zeros((count, 3), np.float32)
    given = {name: np.broadcast_to(np.float32(value), (count, 3)) for name, value in more.items()}
    if "emission" in given:
        given["emission"] = given["emission"] * np.float32(share)
    radii = np.full((count, 1), radius, np.float32)
    return PointCloud(position, radii=radii, extinction=strength.astype(np.float32), **{"color": black, **given})
