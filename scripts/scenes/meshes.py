"""Meshes of simple shapes: cubes, planes, spheres, a torus, Spot the cow, bumpy balls and small towers."""

from __future__ import annotations

import gzip
from functools import cache
from pathlib import Path

import numpy as np

from pointsplat_addon.core.scene.mesh import Mesh
from scripts.common.tower import tower
from scripts.scenes import meshes

SPOT = Path(__file__).resolve().parents[2] / "assets" / "spot" / "spot_triangulated.obj.gz"


def with_smooth_normals(key: str, position: np.ndarray, triangles: np.ndarray) -> Mesh:
    a, b, c = position[triangles].transpose(1, 0, 2)
    normal = np.zeros_like(position)
    np.add.at(normal, triangles, np.cross(b - a, c - a)[:, None])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Mesh(key, key, position.astype(np.float32), triangles.astype(np.int32), normal.astype(np.float32))


def torus() -> Mesh:
    """Radii 0.7 and 0.3: a silhouette with a hole, and parts that hide others."""
    count = 96, 48
    i, j = (a.ravel() for a in np.meshgrid(*map(np.arange, count), indexing="ij"))
    u, v = 2 * np.pi * i / count[0], 2 * np.pi * j / count[1]
    ring = 0.7 + 0.3 * np.cos(v)
    position = np.stack([ring * np.cos(u), ring * np.sin(u), 0.3 * np.sin(v)], axis=1)
    right, up = (i + 1) % count[0], (j + 1) % count[1]
    a, b, c, d = (x * count[1] + y for x, y in ((i, j), (right, j), (right, up), (i, up)))
    return with_smooth_normals("torus", position, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def spot() -> Mesh:
    lines = [line.split() for line in gzip.decompress(SPOT.read_bytes()).decode().splitlines()]
    position = np.array([line[1:4] for line in lines if line and line[0] == "v"], float)
    corners = [[c.partition("/")[0] for c in line[1:4]] for line in lines if line and line[0] == "f"]
    position = np.stack([position[:, 0], -position[:, 2], position[:, 1]], axis=1)
    position -= (position.min(0) + position.max(0)) / 2
    return with_smooth_normals("spot", position / np.linalg.norm(position, axis=1).max(), np.array(corners, int) - 1)


SHAPES = {"sphere": lambda: meshes.sphere_mesh("unit sphere", 64), "torus": torus, "spot": spot}


@cache
def shape(name: str) -> Mesh:
    return SHAPES[name]()


def bumpy(key: str, rings: int) -> Mesh:
    """A ball with bumps, whose triangles are as many as `rings` make them."""
    ball = meshes.sphere_mesh(key, rings)
    p = ball.position.astype(np.float64)
    p *= 1 + 0.06 * np.sin(7 * p[:, :1]) * np.sin(7 * p[:, 1:2]) * np.sin(7 * p[:, 2:])
    return with_smooth_normals(key, p, ball.triangles.astype(int))


def cube_mesh(key: str, size: float = 1.0) -> Mesh:
    """A cube from -size to size with flat normals, turned outwards."""
    corner = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32) * np.float32(size)
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]], np.int32)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return flat_mesh(key, corner, triangles)


def flat_mesh(key: str, position: np.ndarray, triangles: np.ndarray, **more) -> Mesh:
    """A mesh whose corners have the normals of their triangles."""
    with np.errstate(all="ignore"):
        a, b, c = position[triangles].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.nan_to_num(np.repeat(normal[:, None], 3, axis=1)).astype(np.float32)
    return Mesh(key, key, position, triangles.astype(np.int32), corner_normal=normal, **more)


def plane_mesh(key: str, size: float = 1.0, cells: int = 1) -> Mesh:
    """A square in XZ from -size to size that faces -Y, with its unit square as the UV map "UV"."""
    grid = np.linspace(0, 1, cells + 1)
    u, v = (a.ravel() for a in np.meshgrid(grid, grid))
    position = np.stack([(2 * u - 1) * size, np.zeros_like(u), (2 * v - 1) * size], axis=1).astype(np.float32)
    low = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    quad = np.stack([low, low + 1, low + cells + 2, low + cells + 1], axis=1)
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    uv = np.stack([u, v], axis=1).astype(np.float32)[triangles]
    return flat_mesh(key, position, triangles, uv={"UV": uv}, active_uv="UV")


def sphere_mesh(key: str, rings: int = 24) -> Mesh:
    """A unit sphere with smooth normals: its vertices."""
    polar, around = np.meshgrid(
        np.pi * np.arange(rings + 1) / rings, np.pi * np.arange(2 * rings) / rings, indexing="ij"
    )
    position = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    position = position.reshape(-1, 3).astype(np.float32)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij"))
    row, right = 2 * rings * i, (j + 1) % (2 * rings)
    a, b, c, d = row + j, row + 2 * rings + j, row + 2 * rings + right, row + right
    triangles = np.concatenate([np.stack([a, b, c], 1)[i > -1], np.stack([a, c, d], 1)[i > 0]])
    triangles = triangles[~np.isin(np.arange(len(triangles)), np.flatnonzero(i == rings - 1))]
    return Mesh(key, key, position, triangles.astype(np.int32), vertex_normal=position)


def small_tower(key: str) -> Mesh:
    """A tower of 4,000 triangles in four materials."""
    position, triangles, kind = tower(((4, 6), (3, 6), (2, 5)), 4000)
    return flat_mesh(key, position, triangles, material=kind, materials=(0, 1, 2, 3))
