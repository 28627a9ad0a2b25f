"""Pictures filtered over footprints in float64: the twin of shaders/lib/data/levels.glsl."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

MOST_TAPS = 8


@dataclass(frozen=True)
class Footprint:
    """Of N places: see the shader."""

    step: np.ndarray  # (N, 2), of UV
    taps: np.ndarray  # (N,) int
    level: np.ndarray  # (N,)
    width: np.ndarray  # (N, 2), of texels


def footprint(side_a: np.ndarray, side_b: np.ndarray, size: tuple[int, int]) -> Footprint:
    """Of parallelograms with these sides (N, 2) in UV, of a picture of (width, height) texels."""
    sides = np.stack([side_a, side_b], axis=2) * np.asarray(size, float)[:, None]  # texels from the unit square
    axes, extents, _ = np.linalg.svd(sides)
    longer = extents[:, 0]
    shorter = np.maximum(extents[:, 1], longer / MOST_TAPS)
    taps = np.clip(np.floor(longer / np.maximum(shorter, 1) + 0.5), 1, MOST_TAPS)
    span = longer / taps
    along, across = axes[:, :, 0] * span[:, None], axes[:, ::-1, 0] * (-1, 1) * shorter[:, None]
    level = 0.5 * np.log2(np.maximum(shorter, 1) * np.maximum(span, 1))
    return Footprint(along / size, taps.astype(int), level, np.clip(np.abs(along) + np.abs(across), 1e-3, 1))


def levels(texels: np.ndarray, extension: str) -> list[np.ndarray]:
    """All levels (h + 2, w + 2) of texels (H, W), each of half as many texels as the one before, by their areas, with
    what lies around it: as an infinite picture that goes on in this way would have it."""
    found = [np.pad(texels, 1, mode="edge" if extension == "EXTEND" else "constant")]
    while max(found[-1].shape) > 3:
        halves = [_with_ends(_boxes(n - 2, max((n - 2) // 2, 1))) for n in found[-1].shape]
        found.append(halves[0] @ found[-1] @ halves[1].T)
    return found


def _with_ends(boxes: np.ndarray) -> np.ndarray:
    """What is beyond the ends stays so."""
    found = np.zeros((boxes.shape[0] + 2, boxes.shape[1] + 2))
    found[1:-1, 1:-1] = boxes
    found[0, 0] = found[-1, -1] = 1
    return found


def _boxes(count: int, fewer: int) -> np.ndarray:
    """(fewer, count): shares that texels have in boxes of equal widths."""
    edges = np.arange(fewer + 1) * count / fewer
    low, high = edges[:-1, None], edges[1:, None]
    texel = np.arange(count)
    return np.clip(np.minimum(high, texel + 1) - np.maximum(low, texel), 0, None) * fewer / count


def _index(index: np.ndarray, size: int, extension: str) -> np.ndarray:
    """Where texels at indices of an axis of `size` are held, from 1 on; 0 and size + 1 hold what lies around."""
    if extension == "REPEAT":
        return 1 + index % size
    if extension == "MIRROR":
        index = index % (2 * size)
        return 1 + np.minimum(index, 2 * size - 1 - index)
    return 1 + np.clip(index, -1, size)


def _read(texels: np.ndarray, uv: np.ndarray, extension: str, width: np.ndarray | None = None) -> np.ndarray:
    """(N,): of a level, interpolated; `width`: of boxes over texels that are not interpolated."""
    size = texels.shape[1] - 2, texels.shape[0] - 2
    p = uv * size - 0.5
    low = np.floor(p).astype(int)
    f = p - low
    if width is not None:
        f = np.clip((f - 0.5) / width + 0.5, 0, 1)
    total = np.zeros(len(uv))
    for dx in (0, 1):
        for dy in (0, 1):
            x, y = (_index(low[:, k] + d, size[k], extension) for k, d in ((0, dx), (1, dy)))
            total += texels[y, x] * np.abs(1 - dx - f[:, 0]) * np.abs(1 - dy - f[:, 1])
    return total


def filtered(
    pyramid: list[np.ndarray],
    uv: np.ndarray,
    found: Footprint,
    extension: str = "REPEAT",
    closest: bool = False,
    finest: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """(N,): the mean over the footprints at `uv` (N, 2) of a picture with these levels; its texels hold light.

    finest: what the picture shows at places (N, 2), where that is not what its texels hold, interpolated.
    """
    top, total = len(pyramid) - 1, np.zeros(len(uv))
    for tap in range(MOST_TAPS):
        which = np.flatnonzero(tap < found.taps)
        at = uv[which] + (tap - 0.5 * (found.taps[which] - 1))[:, None] * found.step[which]
        level = np.minimum(found.level[which], top)
        read = np.stack([_read(texels, at, extension, found.width[which] if closest and k == 0 else None)
                         for k, texels in enumerate(pyramid)])  # fmt: skip
        if finest is not None:
            read[0] = finest(at)
        k = np.minimum(np.floor(level).astype(int), top)
        each, share = np.arange(len(which)), level - k
        total[which] += read[k, each] * (1 - share) + read[np.minimum(k + 1, top), each] * share
    return total / found.taps


def shown_normals(texels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(N, 3): x, y and 1 - z of unit normals that a repeated picture of normals (H, W, 3) shows at places (N, 2)."""
    padded = [np.pad(texels[..., i].astype(float), 1) for i in range(3)]
    n = np.stack([_read(plane, uv, "REPEAT") for plane in padded], axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return np.column_stack([n[:, :2], 1 - n[:, 2]])


def shown_slopes(heights: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(N, 4): slopes along u and v, and their squares, of repeated heights (H, W) at places (N, 2)."""
    size = heights.shape[::-1]
    p = uv * size - 0.5
    low = np.floor(p).astype(int)
    f = p - low
    x, y = (np.stack([low[:, k], low[:, k] + 1]) % size[k] for k in (0, 1))
    h = heights.astype(float)[y[:, None], x[None]]  # (2, 2, N) by row and column
    across, up = h[:, 1] - h[:, 0], h[1] - h[0]
    u = size[0] * (across[0] * (1 - f[:, 1]) + across[1] * f[:, 1])
    v = size[1] * (up[0] * (1 - f[:, 0]) + up[1] * f[:, 0])
    return np.column_stack([u, v, u * u, v * v])


def mean_of_texels(shown: Callable[[np.ndarray], np.ndarray], size: tuple[int, int], points: int) -> np.ndarray:
    """(H, W, C): the mean over each texel of a picture of (width, height) by so many points along each side."""
    x, y = ((np.arange(side * points) + 0.5) / (side * points) for side in size)
    uv = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
    return shown(uv).reshape(size[1], points, size[0], points, -1).mean(axis=(1, 3))
