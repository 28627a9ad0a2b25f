"""What rays see of captured splats, in float64: each hides 1 - o exp(-q / 2) of what lies behind it, q the least
squared Mahalanobis distance along the ray, and shows its colour of degree 0."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.numeric.rotations import rotation_matrices
from pointsplat_addon.core.scene.captured import CapturedSplats

DEGREE_0 = 0.28209479177387814
MOST_ALPHA, LEAST_ALPHA = 0.99, 1 / 255


def rays_through(
    splats: CapturedSplats, eye: np.ndarray, directions: np.ndarray, world: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance (R, 3), before an even world, and what is left of this (R,), along rays from an eye (3,) in unit
    directions (R, 3)."""
    turn = rotation_matrices(splats.rotation.T.astype(float)).transpose(2, 1, 0)  # rows: own axes
    own = turn / np.maximum(splats.scale.astype(float), 1e-9)[:, :, None]
    to = np.einsum("nij,nj->ni", own, splats.position.astype(float) + splats.origin - eye)
    srgb = np.maximum(0.5 + DEGREE_0 * splats.base.astype(float), 0)
    color = np.where(srgb < 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    square = (to * to).sum(axis=1)
    radiance, left = np.zeros((len(directions), 3)), np.ones(len(directions))
    for row, direction in enumerate(directions):
        along = own @ direction
        slope, speed = (to * along).sum(axis=1), (along * along).sum(axis=1)
        t, q = slope / speed, square - slope * slope / speed
        alpha = np.minimum(splats.opacity * np.exp(-0.5 * np.maximum(q, 0)), MOST_ALPHA)
        seen = np.flatnonzero((t > 0) & (alpha >= LEAST_ALPHA))
        seen = seen[np.argsort(t[seen])]
        passed = np.append(1.0, np.cumprod(1 - alpha[seen]))
        radiance[row] = ((passed[:-1] * alpha[seen])[:, None] * color[seen]).sum(axis=0) + passed[-1] * world
        left[row] = passed[-1]
    return radiance, left


def by_cosine(normal: np.ndarray, side: int) -> np.ndarray:
    """(side^2, 3): unit directions over a plane, as dense as the cosine, in strata."""
    u, v = (a.ravel() for a in np.meshgrid(*2 * [(np.arange(side) + 0.5) / side]))
    radius, turn = np.sqrt(u), 2 * np.pi * (v + 0.5 * (np.arange(side * side) % 2) / side)
    up = normal / np.linalg.norm(normal)
    first = np.cross(up, [0.0, 1.0, 0.0] if abs(up[0]) > 0.7 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    local = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - u)], axis=1)
    return local @ np.stack([first, np.cross(up, first), up])
