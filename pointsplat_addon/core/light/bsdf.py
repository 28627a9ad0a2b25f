"""The Principled BSDF without coat, sheen, transmission and subsurface: Fresnel terms and its tabulated reflectance.

A GGX lobe with multiple scattering over a Lambert base that receives what the lobe does not reflect.

References: Walter et al. 2007 (GGX); Heitz 2014 (height-correlated Smith), 2018 (visible normals); Kulla and Conty 2017
(multiple scattering); Karis 2013 (split sum).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

WIDTH = 32  # of the reflectance table: view cosines
TABLE_ROWS = 32  # roughnesses
TABLE_FILE = Path(__file__).with_name("reflectance.npy")
MIN_ALPHA = 1e-3  # float32 on the GPU cannot hold a narrower lobe's peak


@cache
def reflectance_table() -> np.ndarray:
    """(TABLE_ROWS, WIDTH, 4) float64: what a GGX surface reflects of uniform light.

    Row i is roughness i / (TABLE_ROWS - 1), column j the view cosine (j / (WIDTH - 1))^2. Channels: albedo E with
    Fresnel 1; the share s of F90 in mean Fresnel F0 (1 - s) + s for Schlick; the same for a dielectric of
    index 1.5; the mean albedo over the hemisphere, which depends on the row only.

    It is read from a file: the integrals, in tests/reference/reflectance.py, would take as long as drawing a picture.
    """
    table = np.load(TABLE_FILE)
    table.setflags(write=False)
    return table


@cache
def largest_multiple_scattering() -> float:
    """Largest ratio of multiple to single scattering (Kulla and Conty 2017) of any material, a perfect mirror's."""
    return float(1 / reflectance_table()[..., 0].min())


def relative_index(ior: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """Index of refraction (N,) equivalent to Blender's IOR and specular level (N,), which scales F0."""
    f0 = ((ior - 1) / (ior + 1)) ** 2 * (2 * np.maximum(specular, 0))
    root = np.sqrt(np.minimum(f0, 0.99))
    eta = (1 + root) / (1 - root)
    return np.where(ior < 1, 1 / eta, eta)


def surface_row(roughness: float, eta: float) -> np.ndarray:
    """(WIDTH, 4) float64 row of the light table for one dielectric, by view cosine as in `reflectance_table`.

    Channels: reflectance of uniform light, multiple over single scattering, roughness, eta.
    """
    cosine = np.maximum(np.linspace(0, 1, WIDTH) ** 2, 1e-4)
    roughness = np.clip(roughness, 0, 1)
    albedo, _, share, mean = sample_reflectance_table(cosine, np.full(WIDTH, roughness)).T
    reflected, scale = dielectric_reflectance(albedo, share, mean, np.full(WIDTH, eta))
    return np.stack([reflected, scale, np.full(WIDTH, roughness), np.full(WIDTH, eta)], axis=1)


def sample_reflectance_table(cosine: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """Samples `reflectance_table` bilinearly, (N, 4), at view cosines (N,) and roughnesses (N,)."""
    table = reflectance_table()
    x, y = np.sqrt(cosine) * (WIDTH - 1), roughness * (TABLE_ROWS - 1)
    x0, y0 = np.minimum(x.astype(int), WIDTH - 2), np.minimum(y.astype(int), TABLE_ROWS - 2)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    low = table[y0, x0] * (1 - fx) + table[y0, x0 + 1] * fx
    high = table[y0 + 1, x0] * (1 - fx) + table[y0 + 1, x0 + 1] * fx
    return low * (1 - fy) + high * fy


def dielectric_reflectance(
    albedo: np.ndarray, share: np.ndarray, mean: np.ndarray, eta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A dielectric's reflectance of uniform light and its multiple over single scattering.

    albedo, share, mean: channels 0, 2 and 3 of `reflectance_table`; eta: relative index of refraction.
    """
    f0 = ((eta - 1) / (eta + 1)) ** 2
    scale = multiple_scattering_factor(_mean_fresnel(eta), albedo, mean)
    return np.where(eta == 1, 0.0, (f0 * (1 - share) + share) * albedo * scale), scale


def multiple_scattering_factor(mean_fresnel: np.ndarray, albedo: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Multiple over single scattering (Kulla and Conty 2017); albedo, mean: channels 0 and 3 of the table."""
    return 1 + (1 - albedo) / albedo * mean_fresnel * mean / (1 - mean_fresnel * (1 - mean))


def _mean_fresnel(eta: np.ndarray) -> np.ndarray:
    """Cosine-weighted mean reflectance of a dielectric over the hemisphere (fits of Kulla and Conty 2017)."""
    dense = (eta - 1) / (4.08567 + 1.00071 * eta)
    thin = 0.997118 + eta * (0.1014 - eta * (0.965241 + 0.130607 * eta))
    return np.clip(np.where(eta >= 1, dense, thin), 0, 1)


def f82_of_conductor(index: np.ndarray, extinction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a metal reflects at normal incidence, and its F82 tint (Kutz, Hasan and Edmondson 2021), (3,) float64 each.

    index, extinction: (3,), of its complex index of refraction.
    """
    n2, k2 = np.square(np.asarray(index, float)), np.square(np.asarray(extinction, float))

    def fresnel(cosine: float) -> np.ndarray:
        """Unpolarised, (3,)."""
        sine2 = 1 - cosine**2
        t0 = n2 - k2 - sine2
        both = np.sqrt(t0**2 + 4 * n2 * k2)
        a = np.sqrt(np.maximum(0.5 * (both + t0), 0))
        across = (both + cosine**2 - 2 * a * cosine) / (both + cosine**2 + 2 * a * cosine)
        t3, t4 = cosine**2 * both + sine2**2, 2 * a * cosine * sine2
        return 0.5 * across * (1 + (t3 - t4) / (t3 + t4))

    straight = fresnel(1.0)
    schlick = straight + (1 - straight) * (6 / 7) ** 5
    return straight, fresnel(1 / 7) / schlick
