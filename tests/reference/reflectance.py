"""What a GGX surface reflects of uniform light, by quadrature in float64, and Fresnel's reflectance of a dielectric.

    python -m tests.reference.reflectance

writes the table that pointsplat_addon/core/light/bsdf.py reads.

References: Walter et al. 2007 (GGX); Heitz 2014 (height-correlated Smith), 2018 (visible normals).
"""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.light.bsdf import MIN_ALPHA, TABLE_FILE, TABLE_ROWS, WIDTH


def fresnel_dielectric(cosine: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Unpolarised reflectance of a dielectric of relative index eta at the cosine of the incident angle."""
    g2 = eta**2 - 1 + cosine**2
    g = np.sqrt(np.maximum(g2, 0))
    # eta = 1 at grazing incidence is 0 / 0; the floor makes it 0 reflectance's limit.
    a = (g - cosine) / np.maximum(g + cosine, 1e-9)
    b = ((g + cosine) * cosine - 1) / np.maximum((g - cosine) * cosine + 1, 1e-9)
    return np.where(g2 < 0, 1.0, np.where(eta == 1, 0.0, np.clip(0.5 * a**2 * (1 + b**2), 0, 1)))


def reflectance_table() -> np.ndarray:
    """(TABLE_ROWS, WIDTH, 4) float64: see core.light.bsdf.reflectance_table."""
    cosine = np.maximum(np.linspace(0, 1, WIDTH) ** 2, 1e-4)
    table = np.empty((TABLE_ROWS, WIDTH, 4))
    for row, roughness in zip(table, np.linspace(0, 1, TABLE_ROWS), strict=True):
        row[:, :3] = _albedo(np.maximum(roughness**2, MIN_ALPHA), cosine)
        flux = row[:, 0] * cosine
        row[:, 3] = ((flux[1:] + flux[:-1]) * np.diff(cosine)).sum()
    return table


def _albedo(alpha: float, cosine: np.ndarray) -> np.ndarray:
    """(M, 3) first three channels of the table for (M,) view cosines, by sampling visible normals (Heitz 2018)."""
    # One side of the plane of incidence stands for both.
    radius2 = (np.arange(48) + 0.5) / 48
    angle = (np.arange(32) + 0.5) / 32 * np.pi - np.pi / 2
    t1 = np.sqrt(radius2)[:, None] * np.cos(angle)
    disk2 = np.sqrt(radius2)[:, None] * np.sin(angle)
    view_x, view_z = np.sqrt(1 - cosine**2)[:, None, None], cosine[:, None, None]
    length = np.hypot(alpha * view_x, view_z)
    x, z = alpha * view_x / length, view_z / length
    s = 0.5 * (1 + z)
    t2 = (1 - s) * np.sqrt(1 - t1**2) + s * disk2
    t3 = np.sqrt(np.maximum(1 - t1**2 - t2**2, 0))
    half_x, half_z = alpha * (t3 * x - t2 * z), np.maximum(t2 * x + t3 * z, 1e-9)
    length = np.sqrt(half_x * half_x + (alpha * t1) ** 2 + half_z * half_z)

    between = np.clip((half_x * view_x + half_z * view_z) / length, 1e-6, 1)
    light_z = 2 * between * half_z / length - view_z

    def smith(c: np.ndarray) -> np.ndarray:
        return (np.sqrt(1 + alpha**2 * (1 / np.clip(c, 1e-6, 1) ** 2 - 1)) - 1) / 2

    masked = smith(cosine)[:, None, None]
    weight = np.where(light_z > 0, (1 + masked) / (1 + masked + smith(light_z)), 0)
    total = weight.mean((1, 2))
    f0 = 0.04
    exact = (fresnel_dielectric(between, np.array(1.5)) - f0) / (1 - f0)
    grazing = 1 - between
    squared = grazing * grazing
    shares = [(weight * part).mean((1, 2)) / total for part in (squared * squared * grazing, exact)]
    return np.stack([total, *shares], -1)


if __name__ == "__main__":
    np.save(TABLE_FILE, reflectance_table())
