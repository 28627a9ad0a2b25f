"""Splats whose data themselves are moved, turned and scaled: files have no transforms, as objects have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.numeric.harmonics import turning
from ....core.numeric.rotations import rotation_matrices
from ....core.numeric.vectors import each_block
from ....core.scene.captured import CapturedSplats
from ..reader import BLOCK, DEGREES

RIGID = 1e-5  # relative: how far half-axes of a similarity may differ; object matrices are float32


def transformed(splats: CapturedSplats, matrix: np.ndarray) -> tuple[CapturedSplats, bool]:
    """Returns splats under an affine transform (4, 4) float64, and whether that is exact.

    Gaussians always are. Colours are where the transform keeps angles; under others they are turned by the nearest
    rotation, for what was seen from one side is then no longer a sum of harmonics.
    """
    linear = np.asarray(matrix, np.float64)[:3, :3]
    u, stretch, v = np.linalg.svd(linear)
    turn = u @ v
    rigid = bool(stretch[0] - stretch[2] <= RIGID * stretch[0])
    origin = linear @ splats.origin + matrix[:3, 3]
    position = (splats.position @ linear.T.astype(np.float32)).astype(np.float32)
    if rigid:
        proper = turn * np.sign(np.linalg.det(turn))  # a Gaussian is its own mirror image
        rotation = product(quaternion(proper[None])[0], splats.rotation.astype(np.float64)).astype(np.float32)
        scale = (splats.scale * stretch.mean()).astype(np.float32)
    else:
        rotation, scale = _reshaped(splats, linear)
    sh = None if splats.sh is None else turned_harmonics(splats.sh, turn)
    moved = replace(splats, position=position, rotation=rotation, scale=scale, sh=sh, origin=origin)
    return moved, rigid or splats.sh is None


def _reshaped(splats: CapturedSplats, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and scales under a transform that is no similarity: the singular values of the axes it makes."""
    rotation, scale = np.empty_like(splats.rotation), np.empty_like(splats.scale)

    def work(rows: slice) -> None:
        turned = np.moveaxis(rotation_matrices(splats.rotation[rows].T.astype(np.float64)), 2, 0)
        axes = linear @ turned * splats.scale[rows, None, :]
        u, values, _ = np.linalg.svd(axes)
        u[np.linalg.det(u) < 0] *= -1
        rotation[rows], scale[rows] = quaternion(u), values

    each_block(len(splats), work, BLOCK)
    return rotation, scale


def turned_harmonics(sh: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Coefficients (N, K, 3) of functions that are turned, or mirrored, by an orthogonal matrix (3, 3)."""
    found = np.empty_like(sh)
    for degree in range(1, DEGREES[sh.shape[1]] + 1):
        own = slice(degree**2 - 1, (degree + 1) ** 2 - 1)
        found[:, own] = turning(turn, degree).astype(np.float32) @ sh[:, own]
    return found


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """Unit quaternions w, x, y, z (n, 4) of rotation matrices (n, 3, 3), by the largest component (Shepperd 1978)."""
    m = matrix
    trace = np.trace(m, axis1=1, axis2=2)
    diagonal = np.diagonal(m, axis1=1, axis2=2)
    fourfold = np.concatenate([trace[:, None], 2 * diagonal - trace[:, None]], axis=1) + 1  # 4 times squares
    skew = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1)
    products = np.empty((len(m), 4, 4))  # 4 times products of two components
    products[:, np.arange(4), np.arange(4)] = fourfold
    products[:, 0, 1:] = products[:, 1:, 0] = skew
    products[:, 1:, 1:] = np.where(np.eye(3, dtype=bool), products[:, 1:, 1:], m + m.transpose(0, 2, 1))
    row = products[np.arange(len(m)), fourfold.argmax(axis=1)]
    return row / np.linalg.norm(row, axis=1, keepdims=True)


def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Products (n, 4) of a quaternion (4,) and others (n, 4): turns by the others, then by the first."""
    w, x, y, z = first
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return second @ left.T
