"""Float64 twins of the lobes of lib/light/brdf.glsl and diffuse_lobes.glsl, lit from one direction.

Sources: Kutz, Hasan and Edmondson 2021 (F82 tint); Fujii 2012 (improved Oren-Nayar) and Portsmouth, Kutz and Hill 2025
(light that is scattered more than once, of which Blender takes the colour squared); Zeltner, Burley and Chiang 2022 by
MaterialX' fits (sheen); Walter et al. 2007 and Heitz 2014 (anisotropic GGX).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsplat_addon.core.light import bsdf

LEAST_COSINE = 0.005


@dataclass
class Look:
    """N surfaces. None: they have none of it."""

    base: np.ndarray  # (N, 3)
    roughness: np.ndarray  # (N,)
    metallic: np.ndarray  # (N,)
    eta: np.ndarray  # (N,)
    tint: np.ndarray | None = None  # (3,)
    diffuse_roughness: float | None = None
    sheen: np.ndarray | None = None  # (4,) colour, roughness
    toon: np.ndarray | None = None  # (2,) size, smoothness
    tangent: np.ndarray | None = None  # (N, 3)
    gloss: np.ndarray | None = None  # (4,) colour of the metallic share, negative: the base's; 1 where it has no edge


def lit(normal: np.ndarray, to_eye: np.ndarray, to_light: np.ndarray, look: Look) -> np.ndarray:
    """Radiance (N, 3) where a light from `to_light` (3,) gives surfaces that face it an irradiance of 1.

    normal, to_eye: (N, 3), on one side.
    """
    cos_eye, cos_light = _dot(normal, to_eye), normal @ to_light
    half = to_eye + to_light
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    table = bsdf.sample_reflectance_table(np.clip(cos_eye, 1e-4, 1), look.roughness)
    albedo, _, share, mean = (column[:, None] for column in table.T)
    tint = np.ones(3) if look.tint is None else look.tint
    f0 = np.square((look.eta - 1) / (look.eta + 1))[:, None]
    between = _dot(half, to_eye)[:, None]

    def tinted(fresnel: np.ndarray) -> np.ndarray:
        """A dielectric's reflectance, whose rise from f0 to 1 begins at the tinted f0."""
        rise = np.clip((fresnel - f0) / (1 - f0), 0, 1)
        return np.where(look.eta[:, None] == 1, 0, (1 - rise) * f0 * tint + rise)

    dielectric_mean = tinted(bsdf._mean_fresnel(look.eta)[:, None])
    dielectric_scale = bsdf.multiple_scattering_factor(dielectric_mean, albedo, mean)
    reflected = np.where(look.eta[:, None] == 1, 0, ((1 - share) * f0 * tint + share) * albedo * dielectric_scale)
    diffuse = look.base * (1 - np.minimum(reflected.max(axis=1, keepdims=True), 1)) * (1 - look.metallic[:, None])

    metal, edge = look.base, np.ones(3)
    if look.gloss is not None:
        metal = metal if look.gloss[0] < 0 else np.broadcast_to(look.gloss[:3], metal.shape)
        edge = metal if look.gloss[3] else edge
    seventh = 1 / 7
    dip = (metal + (1 - metal) * (1 - seventh) ** 5) * (1 - tint) / (seventh * (1 - seventh) ** 6)
    metal_fresnel = np.clip(metal + (edge - metal) * (1 - between) ** 5 - dip * between * (1 - between) ** 6, 0, 1)
    metal_scale = bsdf.multiple_scattering_factor(metal + (edge - metal) / 21 - dip / 126, albedo, mean)
    of_dielectric = tinted(fresnel_dielectric(between[:, 0], look.eta)[:, None]) * dielectric_scale
    fresnel = (1 - look.metallic[:, None]) * of_dielectric + look.metallic[:, None] * metal_fresnel * metal_scale
    glossy = ggx(normal, to_eye, to_light, half, look)[:, None] * fresnel * cos_light[:, None]

    shaped = np.full_like(diffuse, 1 / np.pi)
    if look.diffuse_roughness is not None:
        shaped = rough_diffuse(normal, to_eye, to_light, look.base, look.diffuse_roughness)
    if look.toon is not None:
        shaped = (toon(cos_light, *look.toon) / np.maximum(cos_light, LEAST_COSINE))[:, None]
    result = diffuse * shaped * cos_light[:, None] + glossy
    if look.sheen is not None:
        fibres, lobe = sheen(normal, to_eye, to_light, look.sheen)
        result = result * (1 - fibres.max(axis=1, keepdims=True)) + lobe
    return np.where(cos_light[:, None] > 0, result, 0)


def fresnel_dielectric(cosine: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Unpolarised reflectance (N,), by Snell's law."""
    sine2 = (1 - cosine**2) / eta**2
    inside = np.sqrt(np.maximum(1 - sine2, 0))
    parallel = (eta * cosine - inside) / (eta * cosine + inside)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    return np.where(sine2 > 1, 1, 0.5 * (parallel**2 + across**2))


def ggx(normal: np.ndarray, to_eye: np.ndarray, to_light: np.ndarray, half: np.ndarray, look: Look) -> np.ndarray:
    """D G / (4 n.l n.v), (N,), with the height-correlated G of Heitz 2014."""
    alpha = np.maximum(look.roughness**2, bsdf.MIN_ALPHA)
    along, across, stretch = np.zeros_like(normal), np.zeros_like(normal), np.ones(len(normal))
    if look.tangent is not None:
        stretch = 1 / (1 - np.linalg.norm(look.tangent, axis=1))
        along = look.tangent - _dot(look.tangent, normal)[:, None] * normal
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = np.cross(normal, along)
    ax, ay = alpha * stretch, alpha / stretch

    def slopes2(v: np.ndarray) -> np.ndarray:
        """(N,): (x ax)^2 + (y ay)^2 of a direction's components."""
        if look.tangent is None:
            return alpha**2 * np.maximum(1 - _dot(v, normal) ** 2, 0)
        return (_dot(v, along) * ax) ** 2 + (_dot(v, across) * ay) ** 2

    up = _dot(half, normal)
    if look.tangent is None:
        spread = (1 - up**2) / alpha**2
    else:
        spread = (_dot(half, along) / ax) ** 2 + (_dot(half, across) / ay) ** 2
    density = 1 / (np.pi * ax * ay * (spread + up**2) ** 2)
    light = np.broadcast_to(to_light, normal.shape)
    masked = [0.5 * (np.sqrt(1 + slopes2(v) / _dot(v, normal) ** 2) - 1) for v in (to_eye, light)]
    return density / (1 + sum(masked)) / (4 * _dot(to_eye, normal) * _dot(light, normal))


def rough_diffuse(
    normal: np.ndarray, to_eye: np.ndarray, to_light: np.ndarray, color: np.ndarray, sigma: float
) -> np.ndarray:
    """BSDF (N, 3) over the colour, of roughness `sigma`."""
    cos_eye, cos_light = _dot(normal, to_eye), np.maximum(normal @ to_light, 0)
    s = to_eye @ to_light - cos_eye * cos_light
    t = np.where(s > 0, np.maximum(cos_eye, cos_light), 1)
    a = 1 / (np.pi + (np.pi / 2 - 2 / 3) * sigma)
    albedo_eye, albedo_light = (np.pi * a + sigma * a * extra_albedo(c) for c in (cos_eye, cos_light))
    mean = np.pi * a + sigma * a * (2 * np.pi - 5.6) / 3
    color = np.clip(color, 0, 1)
    again = color**2 / np.pi * mean / (1 - mean) / (1 - color * (1 - mean))
    return (a * (1 + sigma * s / t))[:, None] + again * ((1 - albedo_eye) * (1 - albedo_light))[:, None]


def extra_albedo(cosine: np.ndarray) -> np.ndarray:
    """Fujii's integral (N,) of s / t over the hemisphere of light."""
    angle = np.arccos(np.clip(cosine, -1, 1))
    sine, tangent = np.sin(angle), np.tan(angle)
    return sine * (angle - sine * cosine) + 2 / 3 * (tangent * (1 - sine**3) - sine)


def toon(cos_light: np.ndarray, size: float, smooth: float) -> np.ndarray:
    """BSDF times n.l (N,) of Blender's Toon BSDF."""
    angle, size, smooth = np.arccos(np.clip(cos_light, -1, 1)), size * np.pi / 2, smooth * np.pi / 2
    shown = np.clip(1 - (angle - size) / smooth, 0, 1)
    return shown / (2 * np.pi * (1 - np.cos(min(size + smooth, np.pi / 2))))


def sheen(
    normal: np.ndarray, to_eye: np.ndarray, to_light: np.ndarray, look: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What fibres reflect of uniform light, and BSDF times n.l, (N, 3) each. look: (4,), colour and roughness."""
    x, y = _dot(normal, to_eye), look[3]
    deviation = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
    middle = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y**2))) / (0.046391 + y)
    rest = y * (0.000654023 + (-0.0207818 + 0.119681 * y) * y) / (1.26264 + y * (-1.92021 + y))
    albedo = np.exp(-0.5 * ((x - middle) / deviation) ** 2) / (deviation * np.sqrt(2 * np.pi)) + rest
    a = (2.58126 * x + 0.813703 * y) * y / (1 + 0.310327 * x**2 + 2.60994 * x * y)
    b = np.sqrt(1 - x) * (y - 1) * y**3 / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y**2)
    along = to_eye - x[:, None] * normal
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    local = np.stack([along @ to_light, np.cross(normal, along) @ to_light, normal @ to_light], axis=1)
    inverse = np.zeros((len(x), 3, 3))
    inverse[:, 0, 0] = inverse[:, 1, 1] = a
    inverse[:, 0, 2], inverse[:, 2, 2] = b, 1
    bent = np.einsum("nij,nj->ni", inverse, local)
    length = np.linalg.norm(bent, axis=1)
    density = np.maximum(bent[:, 2] / length, 0) / np.pi * np.linalg.det(inverse) / length**3
    fibres = np.clip(albedo, 0, 1)[:, None] * look[:3]
    return fibres, fibres * density[:, None]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nc,nc->n", a, b)
