"""Lookups in an environment's atlas in float64: the twin of shaders/lib/light/environment.glsl."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.light.environment import ROUGHNESS, atlas_level, bilinear, uv_from_direction


def radiance(atlas: np.ndarray, direction: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """(N, 3) float64 prefiltered radiance from (N, 3) image-space directions at (N,) roughness."""
    step = ROUGHNESS[0]
    position = np.clip(np.asarray(roughness, float) / step, 0, len(ROUGHNESS))
    low = np.minimum(position.astype(np.int64), len(ROUGHNESS) - 1)
    uv = uv_from_direction(direction)
    result = np.zeros((len(uv), 3))
    for i in np.unique(low):
        rows = low == i
        t = (position[rows] - i)[:, None]
        near, far = (bilinear(atlas_level(atlas, k).astype(float), uv[rows]) for k in (i, i + 1))
        result[rows] = near * (1 - t) + far * t
    return result


def mean_radiance(atlas: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N, 3) float64 irradiance / pi on surfaces with (N, 3) image-space normals."""
    return bilinear(atlas_level(atlas, len(ROUGHNESS) + 1).astype(float), uv_from_direction(normal))
