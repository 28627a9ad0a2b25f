"""Light on strands that are seen across all their width, in float64: the twin of shaders/lib/strands/hair.glsl.

Hair is the model of Chiang et al. 2016 from afar: reflection R, transmission TT, internal reflection TRT and all
further bounces, each a longitudinal lobe (d'Eon et al. 2011) times an azimuthal one, of energies that are means over
the width. Light that strands scatter is not followed from one to the next. Instead each time that light is scattered
the share `escape` of it leaves the mass of hair, and the rest meets others, everywhere alike: of uniform light on hair
that scatters the share E comes back E escape / (1 - E (1 - escape)), and what meets others is a diffuse part. With
LEAST_ESCAPE that is about the colour which Chiang's parametrisation gives a mass of such hair; a single strand has an
escape of 1. What absorbs nothing scatters all.

What is reflected is so by Fresnel's law where the cylinder is met whose normal lies, about the tangent, halfway between
both directions; the energy of R, by which less is left for all else, is its mean over the width.

Any other material is a cylinder of it: Lambert's law in closed form (Kajiya and Kay 1989, with the part of the cylinder
that is both lit and seen), and R in place of its GGX lobe.

A light of which a strand sees more than a point is its middle, with lobes that are wider by its `spread`: the variance
of its directions along each axis, in radians^2, which is a quarter of the squared angular radius of a round one.

All vectors are unit and point away from the strand. An angle theta is one to the plane across the tangent, phi one
about it. What is scattered is per unit of irradiance on a plane that faces the light.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pointsplat_addon.core.material.hair_color import absorption_from_color
from tests.reference.reflectance import fresnel_dielectric

# Offsets from the middle of a strand, of its radius, that stand for its width: 1 - s^2 of the nodes of Gauss and Jacobi
# for the weight s on [0, 1], since Fresnel's law goes with the square root of what is left to the edge.
OFFSETS = (0.16932809, 0.65127062, 0.95491150)
WEIGHTS = (0.40186383, 0.45848221, 0.13965396)
# The deviation of phi over the width, at an index of 1.55: variance of TT, and the scale of a logistic for TRT. What
# passes once ends at 100 degrees from straight on, which a normal distribution is nearer to than a logistic.
TT_VARIANCE, TRT_SPREAD = 0.28, 0.14
WIDEST = 3.24  # variance of a normal distribution that is wrapped once around the circle
LEAST_ROUGHNESS = 0.08  # float32 holds no narrower lobe
LEAST_VARIANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Fibre:
    """Hair of N strands; every array may also be a scalar that is broadcast."""

    color: np.ndarray  # (N, 3): of a mass of such hair; core.material.hair_color has its absorption
    roughness: np.ndarray  # (N,) longitudinal
    radial: np.ndarray  # (N,) azimuthal roughness
    eta: np.ndarray | float  # (N,) index of refraction
    tilt: np.ndarray | float  # (N,) radians by which scales lean, with Cycles' sign
    coat: np.ndarray | float = 0.0  # (N,) by how much smoother R is
    lobes: np.ndarray | None = None  # (N, 3) factors of R, TT and TRT; None: 1
    escape: np.ndarray | float = 1.0  # (N,) share of scattered light that meets no other strand


def energies(fibre: Fibre, sine: np.ndarray) -> np.ndarray:
    """(5, N, 3) what R, TT, TRT, the rest and other strands scatter of uniform light, seen at (N,) sines of theta."""
    sine = np.asarray(sine, float)
    cosine = np.sqrt(np.maximum(1 - sine**2, 0))
    eta = np.broadcast_to(np.asarray(fibre.eta, float), sine.shape)
    sigma = absorption_from_color(np.asarray(fibre.color, float), np.asarray(fibre.radial)[..., None])
    # Bravais: rays across the tangent are bent as by another index.
    bent = np.sqrt(np.maximum(eta**2 - sine**2, 1e-9)) / np.maximum(cosine, 1e-4)
    inside = np.sqrt(np.maximum(1 - (sine / eta) ** 2, 1e-9))
    total = np.zeros((4, len(sine), 3))
    for h, weight in zip(OFFSETS, WEIGHTS, strict=True):
        reflected = fresnel_dielectric(cosine * np.sqrt(1 - h * h), eta)[:, None]
        path = 2 * np.sqrt(np.maximum(1 - (h / bent) ** 2, 0)) / inside
        passed = np.exp(-sigma * path[:, None])
        through = (1 - reflected) ** 2 * passed
        again = through * passed * reflected
        total += weight * np.stack(
            [
                np.broadcast_to(reflected, through.shape), through, again,
                again * passed * reflected / np.maximum(1 - passed * reflected, 1e-6),
            ]
        )  # fmt: skip
    if fibre.lobes is not None:
        total[:3] *= np.clip(np.moveaxis(np.asarray(fibre.lobes), -1, 0), 0, 1)[..., None]
    escape = np.broadcast_to(np.asarray(fibre.escape, float), sine.shape)[:, None]
    whole = leaving_share(total.sum(axis=0), escape)
    back = np.clip(whole - total[0] - total[2] - total[3] - escape * total[1], 0, (1 - escape) * total[1])
    total[1] *= escape
    return np.concatenate([total, back[None]])


def leaving_share(every: np.ndarray, escape: np.ndarray) -> np.ndarray:
    return every * escape / np.maximum(1 - every * (1 - escape), 1e-6)


def radiance_in_uniform_light(fibre: Fibre, sine: np.ndarray) -> np.ndarray:
    """(N, 3) radiance of hair in light of radiance 1 from all around, which others hold off."""
    alone = energies(replace(fibre, escape=1.0), sine).sum(axis=0)
    return leaving_share(alone, np.broadcast_to(np.asarray(fibre.escape, float), alone.shape[:1])[:, None])


def longitudinal_variance(roughness: np.ndarray) -> np.ndarray:
    """Variance of the longitudinal lobe of R (Chiang et al. 2016, equation 7)."""
    b = np.maximum(roughness, LEAST_ROUGHNESS)
    return (0.726 * b + 0.812 * b**2 + 3.7 * b**20) ** 2


def logistic_scale(radial: np.ndarray) -> np.ndarray:
    """Scale of the azimuthal logistic (Chiang et al. 2016, equation 8)."""
    b = np.maximum(radial, LEAST_ROUGHNESS)
    return np.sqrt(np.pi / 8) * (0.265 * b + 1.194 * b**2 + 5.372 * b**22)


def longitudinal(theta: np.ndarray, other: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(N,) d'Eon et al. 2011, equation 7; its integral times the cosine of theta is 1 for every other angle."""
    # Tilted past the tangent.
    other = _folded(other)
    a = np.cos(theta) * np.cos(other) / variance
    # i0(a) exp(-a), of large a too.
    scaled = np.where(
        a < 500, np.i0(np.minimum(a, 500)) * np.exp(-np.minimum(a, 500)), 1 / np.sqrt(2 * np.pi * a + 1e-30)
    )
    return scaled * np.exp(-2 * np.sin((theta + other) / 2) ** 2 / variance) / (variance * -np.expm1(-2 / variance))


def _folded(theta: np.ndarray) -> np.ndarray:
    """The angle in [-pi / 2, pi / 2] of the same sine."""
    return np.copysign(np.pi / 2 - np.abs(np.pi / 2 - np.abs(theta)), theta)


def logistic(x: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(N,) the logistic about 0 on [-pi, pi], of integral 1."""
    e = np.exp(-np.abs(x) / scale)
    return e / (scale * (1 + e) ** 2) / np.tanh(np.pi / (2 * scale))


def wrapped_normal(x: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(N,) the normal distribution around the circle, at x in [0, pi] off its middle; both sides add up to 1."""
    return (np.exp(-x * x / (2 * variance)) + np.exp(-((2 * np.pi - x) ** 2) / (2 * variance))) / np.sqrt(
        2 * np.pi * variance
    )


def _wrapped(phi: np.ndarray) -> np.ndarray:
    return (phi + np.pi) % (2 * np.pi) - np.pi


def angles(tangent: np.ndarray, direction: np.ndarray, to_eye: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta of the direction and of the eye, and phi between them, |phi| <= pi."""
    sine, sine_eye = (np.clip(np.einsum("nc,nc->n", v, tangent), -1, 1) for v in (direction, to_eye))
    across, seen = direction - sine[:, None] * tangent, to_eye - sine_eye[:, None] * tangent
    sideways = np.einsum("nc,nc->n", np.cross(seen, across), tangent)
    return np.arcsin(sine), np.arcsin(sine_eye), np.arctan2(sideways, np.einsum("nc,nc->n", seen, across))


def scattered_radiance(
    tangent: np.ndarray, direction: np.ndarray, to_eye: np.ndarray, fibre: Fibre, spread: np.ndarray | float = 0.0
) -> np.ndarray:
    """(2, N, 3) radiance towards the eye of hair in light around one direction: what is reflected, and the rest."""
    theta, eye, phi = angles(tangent, direction, to_eye)
    energy = energies(fibre, np.sin(eye))
    wide = longitudinal_variance(fibre.roughness)
    # Of logistics; their variance is pi^2 / 3 of the squared scale.
    azimuth = np.sqrt(logistic_scale(fibre.radial) ** 2 + 3 / np.pi**2 * spread_about(theta, spread)[1])
    straight = np.minimum(np.pi**2 / 3 * azimuth**2 + TT_VARIANCE, WIDEST)
    tilt = np.asarray(fibre.tilt, float)
    smooth = longitudinal_variance(np.asarray(fibre.roughness) * (1 - np.asarray(fibre.coat)))
    reflected = longitudinal(theta, eye + 2 * tilt, smooth + spread) * np.cos(phi / 2) / 4
    tt = longitudinal(theta, eye - tilt, wide / 4 + spread) * wrapped_normal(np.pi - np.abs(phi), straight)
    inner = longitudinal(theta, eye - 4 * tilt, wide * 4 + spread)
    trt = inner * logistic(phi, np.hypot(azimuth, TRT_SPREAD))
    rest = tt[:, None] * energy[1] + trt[:, None] * energy[2] + inner[:, None] / (2 * np.pi) * energy[3]
    rest += (cylinder_cosine(theta, phi, spread) / np.pi)[:, None] * energy[4]
    mirror = fresnel_dielectric(mirror_cosine(eye, phi), np.asarray(fibre.eta, float))[:, None]
    if fibre.lobes is not None:
        mirror = mirror * np.clip(np.asarray(fibre.lobes)[..., :1], 0, 1)
    return np.stack([reflected[:, None] * np.broadcast_to(mirror, rest.shape), rest])


def mirror_cosine(eye: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """(N,) the cosine at which an eye at theta sees where light is reflected that comes from phi beside it."""
    return np.cos(eye) * np.cos(phi / 2)


def spread_about(theta: np.ndarray, spread: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """(N,) of directions around one at theta: the mean squared cosine of their theta, and the variance of their phi."""
    square = np.cos(theta) ** 2 * (1 - 2 * np.asarray(spread)) + spread
    return square, spread / np.maximum(square, 1e-6)


def cylinder_cosine(theta: np.ndarray, phi: np.ndarray, spread: np.ndarray | float = 0.0) -> np.ndarray:
    """(N,) the mean cosine, over the width that is seen, of a cylinder; the light's azimuth is phi off the eye's."""
    p = np.abs(phi)
    square, off = spread_about(theta, spread)
    # What varies with phi fades, its mean stays.
    lit = 4 / np.pi + ((np.pi - p) * np.cos(p) + np.sin(p) - 4 / np.pi) * np.exp(-off / 2)
    return np.sqrt(np.maximum(square, 0)) * lit / 4


def cylinder_reflectance(
    sine: np.ndarray, base: np.ndarray, metallic: np.ndarray, eta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) what a cylinder's surface reflects of uniform light, seen at sines of theta, and its diffuse colour."""
    cosine = np.sqrt(np.maximum(1 - sine**2, 0))
    surface, dielectric = np.zeros((len(sine), 3)), np.zeros(len(sine))
    for h, weight in zip(OFFSETS, WEIGHTS, strict=True):
        facing = cosine * np.sqrt(1 - h * h)
        dielectric += weight * fresnel_dielectric(facing, eta)
        surface += weight * mirror_reflectance(facing, base, metallic, eta)
    return surface, (1 - np.clip(metallic, 0, 1)[:, None]) * (1 - dielectric[:, None]) * np.maximum(base, 0)


def mirror_reflectance(cosine: np.ndarray, base: np.ndarray, metallic: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """(N, 3) what a surface reflects of light that meets it at (N,) cosines."""
    metallic, f0 = np.clip(metallic, 0, 1)[:, None], np.clip(base, 0, 1)
    dielectric = fresnel_dielectric(cosine, eta)[:, None]
    return (1 - metallic) * dielectric + metallic * (f0 + (1 - f0) * (1 - cosine[:, None]) ** 5)


def cylinder_radiance(
    tangent: np.ndarray, direction: np.ndarray, to_eye: np.ndarray,
    base: np.ndarray, roughness: np.ndarray, metallic: np.ndarray, eta: np.ndarray,
    spread: np.ndarray | float = 0.0,
) -> np.ndarray:  # fmt: skip
    """(2, N, 3) radiance towards the eye of a cylinder of a Principled surface: what it reflects, and what is diffuse.

    The lobe's deviation is that of GGX half vectors whose slopes have it, alpha / sqrt(2).
    """
    theta, eye, phi = angles(tangent, direction, to_eye)
    _, diffuse = cylinder_reflectance(np.sin(eye), base, metallic, eta)
    surface = mirror_reflectance(mirror_cosine(eye, phi), base, metallic, eta)
    wide = np.maximum(2 * np.clip(roughness, 0, 1) ** 4, LEAST_VARIANCE)
    reflected = longitudinal(theta, eye, wide + spread) * np.cos(phi / 2) / 4
    return np.stack([reflected[:, None] * surface, (cylinder_cosine(theta, phi, spread) / np.pi)[:, None] * diffuse])
