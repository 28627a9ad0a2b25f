"""Direct light on opaque surfaces in float64: the twin of shaders/lib/light, without shadows.

Surfaces are Blender's Principled BSDF as in core.light.bsdf. Diffuse light is in closed form, specular light of lights
with a size in closed form for narrow lobes and by a small quadrature for wide ones, so that nothing is noisy.

References: Baum, Rushmeier and Winget 1989, equation 5 (polygon form factor); Snyder 1996 (sphere cut by the horizon);
Karis 2013 (split sum).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pointsplat_addon.core.light import environment
from pointsplat_addon.core.light.bsdf import (
    MIN_ALPHA,
    dielectric_reflectance,
    multiple_scattering_factor,
    relative_index,
    sample_reflectance_table,
)
from pointsplat_addon.core.light.light_shapes import area_axes, beam_mean, blend_range, is_narrowed
from pointsplat_addon.core.light.light_table import SMALL, SMALL_SINE
from pointsplat_addon.core.numeric.vectors import unit_rows
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.world import World
from tests.reference import environment_lookup
from tests.reference.reflectance import fresnel_dielectric

ELLIPSE_SIDES = 24
SPREAD_CELLS = 8  # to a side: an area light with a narrowed beam is summed over a grid
BLUR = 0.06  # of a light's angular radius squared, added to alpha^2: found to fit best between seven points
NARROW = (1.5, 4.0)  # angular radius of a light over the lobe's width, between which narrow-lobe shading sets in
AREA_NARROW = (1.0, 2.5)  # of area lights
BEYOND = 1.0  # widths of the lobe beyond the light, from where on half vectors are integrated
MOST_OF_LOBE = 1.25  # of what a lobe reflects at the mirrored ray, what it reflects in all
WIDER_SUM = 1.1  # of a GGX lobe's slopes and a Gaussian's, drawn as a mixture of both
TURNED_BY = 10.0  # of alpha squared: the less of wide lobes
HALF_SIDES = 12  # of the polygon that stands for an ellipse among half vectors
# A quadrature of degree 5 over the unit disk: cosine and sine of the azimuth, radius, weight.
DISK = (
    (1.0, 0.0, 0.0, 0.25),
    *((np.cos(i * np.pi / 3), np.sin(i * np.pi / 3), np.sqrt(2 / 3), 0.125) for i in range(6)),
)


@dataclass(frozen=True, eq=False)
class Surface:
    """Principled values of N points; every array may also be a scalar or (3,) that is broadcast."""

    base: np.ndarray  # (N, 3) scene-linear
    emission: np.ndarray  # (N, 3) radiance
    roughness: np.ndarray  # (N,)
    metallic: np.ndarray  # (N,)
    ior: np.ndarray  # (N,)
    specular: np.ndarray  # (N,) IOR level: 0.5 leaves F0 as the ior says
    spread: np.ndarray | float = 0.0  # (N,) variance of slopes of the normals, both directions together

    def broadcast(self, count: int) -> Surface:
        """The same with full-length float64 arrays."""
        return Surface(
            *(np.broadcast_to(np.asarray(a, float), (count, 3)) for a in (self.base, self.emission)),
            *(
                np.broadcast_to(np.asarray(a, float), (count,))
                for a in (self.roughness, self.metallic, self.ior, self.specular, self.spread)
            ),
        )


def shade(
    position: np.ndarray,
    normal: np.ndarray,
    to_eye: np.ndarray,
    surface: Surface,
    lights: Sequence[Light] = (),
    world: World | None = None,
    atlas: np.ndarray | None = None,
    plane: np.ndarray | None = None,
) -> np.ndarray:
    """Radiance (N, 3) float64 towards the eye, in world space.

    position, normal (unit), to_eye (unit): (N, 3). The normal is that of the side that is seen. `plane` (N, 3): the
    unit normals of the surfaces' planes, turned to the eye; (0, 0, 0), as all are if it is None: that of `normal`.
    `atlas` is environment.build_atlas(world.image), built here if it is needed and None.
    """
    position, normal, to_eye = (np.asarray(a, float) for a in (position, normal, to_eye))
    plane = np.zeros_like(normal) if plane is None else np.asarray(plane, float)
    reflecting = reflecting_normal(normal, plane, to_eye)
    material = _Material(surface.broadcast(len(position)), normal, reflecting, to_eye)

    result = material.surface.emission.copy()
    for light in lights:
        result += _shade_light(position, normal, material, light)
    if world is not None:
        result += _shade_world(normal, material, world, atlas)
    return result


def reflecting_normal(normal: np.ndarray, plane: np.ndarray, to_eye: np.ndarray) -> np.ndarray:
    """The normals (N, 3) of GGX lobes: turned towards the surface's plane until the mirrored eye lies above that, by as
    much as Cycles' `ensure_valid_specular_reflection` asks. Where there is no plane, on the side of the eye."""
    found = np.where(_dot(normal, to_eye)[:, None] < 0, -normal, normal)
    known = (plane**2).sum(axis=1) > 0.5
    found[known] = normal[known]
    mirrored = 2 * _dot(normal, to_eye)[:, None] * normal - to_eye
    eye_z = _dot(plane, to_eye)
    least = np.minimum(0.9 * eye_z, 0.01)
    below = known & (_dot(plane, mirrored) < least)
    across = normal - _dot(normal, plane)[:, None] * plane
    below &= np.linalg.norm(across, axis=1) > 1e-6
    across, plane, eye_z, least = unit_rows(across[below]), plane[below], eye_z[below], least[below]
    # 4 a z^4 - 2 b z^2 + c = 0, z the cosine between the lobe's normal and the plane's.
    eye_x = _dot(across, to_eye[below])
    a = np.maximum(eye_x**2 + eye_z**2, 1e-12)
    b, c = 2 * (a + eye_z * least), (least + eye_z) ** 2
    root = np.sqrt(np.maximum(b * b - 4 * a * c, 0))
    z2 = np.clip((b + np.where(eye_x < 0, root, -root)) / (4 * a), 0, 1)[:, None]
    found[below] = np.sqrt(1 - z2) * across + np.sqrt(z2) * plane
    return found


def diffuse_color(
    normal: np.ndarray, to_eye: np.ndarray, surface: Surface, plane: np.ndarray | None = None
) -> np.ndarray:
    """The share (N, 3) float64 of even light that comes back by the diffuse lobe. Arguments: as of `shade`."""
    normal, to_eye = (np.asarray(a, float) for a in (normal, to_eye))
    plane = np.zeros_like(normal) if plane is None else np.asarray(plane, float)
    reflecting = reflecting_normal(normal, plane, to_eye)
    return _Material(surface.broadcast(len(normal)), normal, reflecting, to_eye).diffuse


class _Material:
    """What the BSDF needs of (N,) surfaces seen from one direction."""

    def __init__(self, surface: Surface, shading: np.ndarray, normal: np.ndarray, to_eye: np.ndarray) -> None:
        """shading: the normals of the diffuse lobe, from whose front light comes; normal: those of the GGX lobe."""
        self.surface, self.shading, self.normal, self.to_eye = surface, shading, normal, to_eye
        self.alpha = np.maximum(np.clip(surface.roughness, 0, 1) ** 2, MIN_ALPHA)
        self.widened = np.minimum(surface.spread, 1 - self.alpha**2)
        own2, both2 = self.alpha**2, self.alpha**2 + self.widened
        self.alpha = np.minimum(
            np.sqrt(both2 + WIDER_SUM * np.maximum(1 - TURNED_BY * own2, 0) * own2 * self.widened / both2), 1
        )
        self.cos_eye = np.clip(_dot(normal, to_eye), 1e-4, 1)
        metallic = np.clip(surface.metallic, 0, 1)[:, None]
        self.metal_f0 = np.clip(surface.base, 0, 1)

        self.eta = relative_index(surface.ior, surface.specular)
        albedo, s_metal, s_dielectric, mean = sample_reflectance_table(
            self.cos_eye, np.clip(surface.roughness, 0, 1)
        ).T[:, :, None]
        self.metal_scale = metallic * multiple_scattering_factor(self.metal_f0 + (1 - self.metal_f0) / 21, albedo, mean)
        reflected, dielectric_scale = dielectric_reflectance(albedo, s_dielectric, mean, self.eta[:, None])
        self.dielectric_scale = (1 - metallic) * dielectric_scale
        self.reflectance = (1 - metallic) * reflected + self.metal_scale * albedo * (
            self.metal_f0 * (1 - s_metal) + s_metal
        )
        self.reflectance *= (_dot(normal, to_eye) > 0)[:, None]
        self.diffuse = np.maximum(surface.base, 0) * (1 - metallic) * (1 - np.minimum(reflected, 1))

        self.mirror = 2 * _dot(normal, to_eye)[:, None] * normal - to_eye
        across = np.cross(normal, to_eye)
        length = np.linalg.norm(across, axis=1, keepdims=True)
        self.across = across / np.maximum(length, 1e-20) * (length > 1e-6)

    def width_along(self, direction: np.ndarray) -> np.ndarray:
        """Angle (N,) by which reflected rays turn along a unit direction (or (3,)) where the half vector's slope is
        alpha: half vectors turned across the plane of incidence move them by less.

        Per unit of length along `direction` at unit distance: a direction along the mirrored ray gives a large one.
        """
        direction = np.broadcast_to(direction, self.mirror.shape)
        seen = direction - _dot(direction, self.mirror)[:, None] * self.mirror
        size2 = np.maximum((seen**2).sum(1), 1e-6)
        across2 = _dot(seen, self.across) ** 2 / size2
        return 2 * self.alpha * np.sqrt((1 - across2 * (1 - self.cos_eye**2)) / size2)

    def half_weight(self, direction: np.ndarray) -> np.ndarray:
        """(N, 3) BSDF of the GGX lobe times n.l by share of its half vectors, for directions (N, 3) to the light."""
        half = unit_rows(direction + self.to_eye)
        cos_between, cl = np.clip(_dot(half, direction), 0, 1), np.maximum(_dot(self.normal, direction), 0)
        turned = cos_between / np.maximum(_dot(self.normal, half), 1e-6)
        a2 = self.alpha**2
        share, own = self.widened / a2, a2 - self.widened
        weight = (1 - share) * cl * _visibility(cl, self.cos_eye, own)
        weight += share * self._spread_weight(direction, half, share, own)
        return self._fresnel(cos_between) * (4 * turned * weight)[:, None]

    def _spread_weight(self, direction: np.ndarray, half: np.ndarray, share: np.ndarray, own: np.ndarray) -> np.ndarray:
        """n.l over masking, and the cosine to the mean normal, (N,): of those normals among the spread that mirror the
        eye to the light, the mean of slopes between the half vector's and 0; own: alpha squared."""
        along = _dot(self.normal, half)
        n = self.normal + share[:, None] * (half / np.maximum(along, 1e-6)[:, None] - self.normal)
        cosine = 1 / np.linalg.norm(n, axis=1)
        above, eye = _dot(n, direction) * cosine, np.maximum(_dot(n, self.to_eye) * cosine, 1e-4)
        lit = (along > 0) & (above > 0)
        above = np.where(lit, above, 1.0)
        return np.where(lit, cosine * above * _visibility(above, eye, own), 0.0)

    def _fresnel(self, cos_between: np.ndarray) -> np.ndarray:
        metal = self.metal_f0 + (1 - self.metal_f0) * ((1 - cos_between) ** 5)[:, None]
        dielectric = fresnel_dielectric(cos_between, self.eta)[:, None]
        return self.metal_scale * metal + self.dielectric_scale * dielectric

    def specular(self, direction: np.ndarray, alpha: np.ndarray | None = None) -> np.ndarray:
        """(N, 3) BSDF of the GGX lobe times n.l for unit directions to the light (N, 3), or of a wider lobe."""
        cos_light = _dot(self.normal, direction)
        half = unit_rows(direction + self.to_eye)
        cos_half, cos_between = _dot(self.normal, half), np.clip(_dot(half, direction), 0, 1)
        a2 = (self.alpha if alpha is None else alpha) ** 2
        # |n x h|^2 in place of 1 - (n.h)^2, which cancels in float32.
        sin2 = (np.cross(self.normal, half) ** 2).sum(1)
        density = a2 / (np.pi * (a2 * cos_half**2 + sin2) ** 2)
        # The spread of normals is a Gaussian of slopes, without the tails of GGX, and of those that are seen none masks
        # another: each has its share of the pixel.
        tan2 = sin2 / np.where(cos_half > 0, cos_half, 1e-5) ** 2
        gaussian = np.exp(-tan2 / a2) / (np.pi * a2 * np.maximum(cos_half, 1e-5) ** 4)
        share, own = self.widened / a2, a2 - self.widened
        cl = np.maximum(cos_light, 1e-6)
        lit = (cos_light > 0) & (_dot(self.shading, direction) > 0) & (_dot(self.normal, self.to_eye) > 0)
        lobe = (1 - share) * np.where(lit, density * _visibility(cl, self.cos_eye, own) * cl, 0)
        lobe += share * gaussian * self._spread_weight(direction, half, share, own)
        lobe = lobe[:, None]
        return lobe * self._fresnel(cos_between)


def _visibility(cos_light: np.ndarray, cos_eye: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Smith's height-correlated masking (N,) over 4 n.l n.v (Heitz 2014, equation 99); own: alpha squared."""
    return 0.5 / (cos_light * np.sqrt(own + (1 - own) * cos_eye**2) + cos_eye * np.sqrt(own + (1 - own) * cos_light**2))


def _shade_light(position: np.ndarray, normal: np.ndarray, material: _Material, light: Light) -> np.ndarray:
    """Reflected radiance (N, 3) of one light."""
    received = _area_light if light.kind == "AREA" else _round_light
    irradiance, specular = received(position, normal, material, light)
    diffuse = light.diffuse * irradiance[:, None] / np.pi * material.diffuse
    return light.color * (diffuse + light.specular * specular)


def _round_light(
    position: np.ndarray, normal: np.ndarray, material: _Material, light: Light
) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance (N,) and radiance (N, 3) of the GGX lobe for light.color = 1."""
    cone = cone_seen = np.ones(len(position))
    if light.kind == "SUN":
        to_light = np.broadcast_to(-light.direction, position.shape)
        sine2 = np.full(len(position), np.sin(min(light.radius, np.pi / 2)) ** 2)
        strength = np.ones(len(position))
    else:
        offset = light.position - position
        d2 = np.maximum((offset**2).sum(1), 1e-24)
        to_light = offset / np.sqrt(d2)[:, None]
        # A facing disk is seen as a cone, as a sphere is, only under a smaller angle.
        reach2 = d2 + light.radius**2 if light.soft else np.maximum(d2, light.radius**2)
        sine2, strength = light.radius**2 / reach2, 1 / reach2
        if light.kind == "SPOT":
            cone_seen, cone = _spot_factors(position, normal, to_light, light)
    cosine = cap_cosine(_dot(normal, to_light), sine2)
    spread = np.asarray(material.surface.spread)
    cosine = np.where(spread > 0, spread_cosine(_dot(normal, to_light), spread, sine2), cosine)
    if light.kind != "SUN" and not light.soft:
        # Inside the sphere light comes from everywhere.
        cosine = np.where(d2 < light.radius**2, 1.0, cosine)
    irradiance = strength * cone * cosine
    strength = strength * cone_seen

    sigma = np.arcsin(np.sqrt(sine2))
    side = unit_rows(material.mirror - _dot(material.mirror, to_light)[:, None] * to_light)
    other = np.cross(to_light, side)
    directions = []
    for cosine, sine, radius, _ in DISK:
        turn = (radius * sigma)[:, None]
        directions.append(np.cos(turn) * to_light + np.sin(turn) * (cosine * side + sine * other))

    angle = np.arctan2(np.linalg.norm(np.cross(to_light, material.mirror), axis=1), _dot(to_light, material.mirror))
    along = np.cross(other, material.mirror)
    share = _disk_share(angle, sigma, material.width_along(along), material.width_along(other))
    solid_angle = 4 * np.pi * np.sin(sigma / 2) ** 2
    narrow = material.reflectance * share[:, None]
    lobe = _lobe_over_light(material, directions, [w for *_, w in DISK], sigma, narrow, solid_angle)
    return irradiance, (strength * 2 / (1 + np.cos(sigma)))[:, None] * lobe


def _lobe_over_light(
    material: _Material,
    directions: Sequence[np.ndarray],
    weights: Sequence[np.ndarray | float],
    sigma: np.ndarray,
    narrow: np.ndarray,
    solid_angle: np.ndarray,
    centre: np.ndarray | float = 1.0,
    between: tuple[float, float] = NARROW,
) -> np.ndarray:
    """Mean (N, 3) of BSDF times n.l over a light of angular radius sigma.

    Wide lobes: summed over a few points, each blurred by its part of the light; over the first, weighing `centre`,
    where all of it is as one point. Narrow lobes: `narrow` (N, 3), the integral over the light.
    """
    alpha = np.minimum(np.sqrt(material.alpha**2 + BLUR * sigma**2), 1)
    wide = sum(
        np.reshape(weight, (-1, 1)) * material.specular(direction, alpha)
        for direction, weight in zip(directions, weights, strict=True)
    )
    small = (sigma < SMALL * material.alpha)[:, None]
    wide = np.where(small, np.reshape(centre, (-1, 1)) * material.specular(directions[0]), wide)
    narrow = narrow / np.maximum(solid_angle, 1e-20)[:, None]
    low, high = between
    t = np.clip((sigma / (np.sqrt(2) * material.alpha) - low) / (high - low), 0, 1)[:, None]
    t = t * t * (3 - 2 * t)
    return (1 - t) * wide + t * narrow


def _disk_share(angle: np.ndarray, sigma: np.ndarray, width: np.ndarray, width_across: np.ndarray) -> np.ndarray:
    """Share of a GGX lobe in a disk of radius sigma whose centre is `angle` away, as for a square of that height."""
    along = _marginal((sigma - angle) / width) + _marginal((sigma + angle) / width)
    return 0.5 * along * _marginal(sigma / (width_across * _flare((angle - sigma) / width)))


def _rectangle_share(a: np.ndarray, b: np.ndarray, width_a: np.ndarray, width_b: np.ndarray) -> np.ndarray:
    """Share of a GGX lobe centred on (a, b) in the square from -1 to 1."""
    excess_a, excess_b = (np.abs(a) - 1) / width_a, (np.abs(b) - 1) / width_b
    width_a, width_b = (
        np.where(excess_b > excess_a, width_a * _flare(excess_b), width_a),
        np.where(excess_b > excess_a, width_b, width_b * _flare(excess_a)),
    )
    share_a = _marginal((1 - a) / width_a) + _marginal((1 + a) / width_a)
    return 0.25 * share_a * (_marginal((1 - b) / width_b) + _marginal((1 + b) / width_b))


def _half_vector_share(offset: np.ndarray, material: _Material, light: Light) -> np.ndarray:
    """Share (N,) of a GGX lobe's half vectors that mirror the eye to an area light at `offset` (N, 3).

    Lambert's formula for its outline among them, their components along the normal times alpha (Heitz et al. 2016).
    """
    axis_u, axis_v = area_axes(light)
    sides = HALF_SIDES if light.ellipse else 8
    turn = 2 * np.pi * np.arange(sides) / sides
    at = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    at *= (
        np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))
        if light.ellipse
        else 1 / np.abs(at).max(1, keepdims=True)
    )
    outline = offset[:, None] + (at[:, :1] * axis_u + at[:, 1:] * axis_v)[None]
    half = outline / np.linalg.norm(outline, axis=2, keepdims=True) + material.to_eye[:, None]
    normal = material.normal[:, None]
    half -= (1 - material.alpha)[:, None, None] * (half * normal).sum(2, keepdims=True) * normal
    total = sum(_edge(half[:, i - 1], half[:, i], material.normal) for i in range(sides))
    return np.abs(total) / (2 * np.pi)


def _flare(x: np.ndarray) -> np.ndarray:
    """How much wider a GGX lobe is across where it is x alpha off in one direction: its tails fan out."""
    return np.sqrt(1 + np.maximum(x, 0) ** 2)


def _marginal(x: np.ndarray) -> np.ndarray:
    """Share of a GGX lobe's half vectors with a slope of at most x alpha to either side in one direction, odd in x."""
    return x / np.sqrt(1 + x**2)


def cap_cosine(cosine: np.ndarray, sine2: np.ndarray) -> np.ndarray:
    """Irradiance of a uniformly bright cone over that of the same cone overhead, cut by the horizon.

    cosine: of the angle between normal and the cone's axis; sine2: squared sine of its half angle (Snyder 1996).
    """
    sine2 = np.clip(sine2, 0, 1)
    sine = np.sqrt(sine2)
    partial = (np.abs(cosine) < sine) & (sine >= SMALL_SINE)
    c = np.where(partial, cosine, 0.0)
    s2 = np.where(partial, sine2, 0.5)
    sin_theta = np.sqrt(np.maximum(1 - c**2, 1e-12))
    x = np.sqrt(np.maximum(1 / s2 - 1, 0))
    y = np.clip(-x * c / sin_theta, -1, 1)
    chord = sin_theta * np.sqrt(1 - y**2)
    cut = (c * np.arccos(y) - x * chord + np.arctan2(chord, x) / s2) / np.pi
    return np.where(partial, np.maximum(cut, 0), np.maximum(cosine, 0))


def spread_cosine(cosine: np.ndarray, spread: np.ndarray, sine2: np.ndarray) -> np.ndarray:
    """Mean (N,) of max(n.l, 0) over normals of this spread about the mean, and over a cone of light: cosines of an even
    distribution, 1.6 deviations to each side, which has the mean positive part of a Gaussian about 0."""
    length2 = 1 / (1 + spread)
    middle = cosine * np.sqrt(length2)
    reach = 1.6 * np.sqrt(0.5 * spread * length2 * np.maximum(1 - cosine**2, 0) + 0.25 * sine2)
    across = (middle + reach) ** 2 / np.maximum(4 * reach, 1e-30)
    return np.where(np.abs(middle) < reach, across, np.maximum(middle, 0))


def _spot_factors(
    position: np.ndarray, normal: np.ndarray, to_light: np.ndarray, light: Light
) -> tuple[np.ndarray, np.ndarray]:
    """Means (N,) of Blender's cone over the disk of the light: plain, and weighted with n.l.

    By two rings of eight points, each of which stands for the patch around it, over which the cone is blurred.
    """
    axis_u, axis_v = area_axes(light)
    count = 16 if light.radius > 0 else 1
    patch = np.sqrt(np.pi / 16) if light.radius > 0 else 0.0
    distance = np.maximum(np.linalg.norm(position - light.position, axis=1), 1e-12)
    stretched = max(np.linalg.norm(axis_u), np.linalg.norm(axis_v))
    blurred = patch * light.radius * stretched / distance
    # Aligned with the cone, so that turning the scene changes nothing.
    aside = np.abs(to_light @ light.direction) < 0.999
    u = unit_rows(np.cross(np.where(aside[:, None], light.direction, axis_u), to_light))
    v = np.cross(to_light, u)
    plain, weighted, weights = np.zeros((3, len(position)))
    for i in range(count):
        azimuth = 2 * np.pi * (i + (0.5 if i >= 8 else 0)) / 8
        radius = light.radius * np.sqrt((0.25 if i < 8 else 0.75) * (1 - 4 / 12 * np.pi / 16))
        ray = position - light.position - radius * (np.cos(azimuth) * u + np.sin(azimuth) * v)
        local = np.stack([ray @ axis_u, ray @ axis_v, ray @ light.direction], -1)
        z = local[:, 2] / np.maximum(np.linalg.norm(local, axis=1), 1e-20)
        fading = blend_range(light)
        wide = np.sqrt(fading**2 + 20 / 12 * blurred**2 * np.maximum(1 - z * z, 0))
        t = np.clip((z - light.spot_cos - fading / 2) / wide + 0.5, 0, 1)
        cone = t * t * (3 - 2 * t)
        weight = np.maximum(-_dot(ray, normal), 0) / count
        plain += cone / count
        weighted += weight * cone
        weights += weight
    return plain, np.where(weights > 0, weighted / np.where(weights > 0, weights, 1), plain)


def _area_light(
    position: np.ndarray, normal: np.ndarray, material: _Material, light: Light
) -> tuple[np.ndarray, np.ndarray]:
    """The same for a rectangle or ellipse that shines to one side."""
    axis_u, axis_v = area_axes(light)
    half_u, half_v = np.linalg.norm(axis_u), np.linalg.norm(axis_v)
    unit_u, unit_v = axis_u / half_u, axis_v / half_v
    offset = light.position - position
    height = -offset @ light.direction
    front = height > 0
    height = np.maximum(height, 1e-9)

    if is_narrowed(light):
        irradiance = _narrow_irradiance(position, normal, light)
    else:
        irradiance = polygon_irradiance(_outline(light)[None] - position[:, None], normal)

    # Points on the light, weighted with the solid angle around them.
    directions, weights = [], []
    for s, t, weight in _points(light):
        to_point = offset + s * axis_u + t * axis_v
        distance = np.linalg.norm(to_point, axis=1)
        directions.append(to_point / distance[:, None])
        weights.append(weight * distance**-3)
    total = sum(weights)
    beams = [_light_beam(d, light) for d in directions]
    weights = [w / total * beam for w, beam in zip(weights, beams, strict=True)]

    # Where the mirrored ray meets the light's plane, and how wide the lobe is there, in half-sides.
    ray = height / np.maximum(material.mirror @ -light.direction, 1e-4)
    a = (ray * (material.mirror @ unit_u) - offset @ unit_u) / half_u
    b = (ray * (material.mirror @ unit_v) - offset @ unit_v) / half_v
    width_u = material.width_along(unit_u) * ray / half_u
    width_v = material.width_along(unit_v) * ray / half_v
    if light.ellipse:
        radius = np.hypot(a, b)
        x, y = np.where(radius > 0, a / np.maximum(radius, 1e-9), 1), b / np.maximum(radius, 1e-9)
        across = np.hypot(y * width_u, x * width_v)
        excess = (radius - 1) / np.hypot(x * width_u, y * width_v)
        share = _disk_share(radius, np.ones_like(radius), np.hypot(x * width_u, y * width_v), across)
    else:
        excess = np.maximum((np.abs(a) - 1) / width_u, (np.abs(b) - 1) / width_v)
        share = _rectangle_share(a, b, width_u, width_v)
    share *= _light_beam(material.mirror, light)
    at = np.stack([a, b], axis=1)
    at = at / np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1) if light.ellipse else np.clip(at, -1, 1)
    nearest = unit_rows(offset + at[:, :1] * axis_u + at[:, 1:] * axis_v)
    beyond = _half_vector_share(offset, material, light) * _light_beam(nearest, light)
    whole = np.minimum(material.reflectance / np.maximum(material.half_weight(material.mirror), 1e-9), MOST_OF_LOBE)
    t = np.clip(excess / BEYOND, 0, 1)[:, None]
    t = t * t * (3 - 2 * t)

    corners = [unit_rows(offset + s * axis_u + t * axis_v) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    solid_angle = _triangle(corners[0], corners[1], corners[2]) + _triangle(corners[0], corners[2], corners[3])
    solid_angle *= np.pi / 4 if light.ellipse else 1
    sigma = np.sqrt(solid_angle / np.pi)
    tails = beyond[:, None] * whole * material.half_weight(nearest)
    narrow = (1 - t) * material.reflectance * share[:, None] + t * tails
    lobe = _lobe_over_light(material, directions, weights, sigma, narrow, solid_angle, beams[0], AREA_NARROW)
    return np.where(front, irradiance, 0.0), np.where(front, solid_angle, 0.0)[:, None] * lobe


def _points(light: Light) -> list[tuple[float, float, float]]:
    """Quadrature of degree 5 (Radon 1948) over an area light, centre first: (along axis_u, along axis_v, weight)."""
    if light.ellipse:
        return [(c * r, s * r, w) for c, s, r, w in DISK]
    sides = [(0.0, t * np.sqrt(14 / 15), 5 / 63) for t in (-1, 1)]
    corners = [(s * np.sqrt(3 / 5), t * np.sqrt(1 / 3), 5 / 36) for s in (-1, 1) for t in (-1, 1)]
    return [(0.0, 0.0, 2 / 7), *sides, *corners]


def _light_beam(direction: np.ndarray, light: Light) -> np.ndarray:
    """The share of an area light's radiance that leaves it against unit directions towards it."""
    if not is_narrowed(light):
        return np.ones(len(direction))
    return _beam(direction @ -light.direction, light.spread / 2)


def polygon_irradiance(vertices: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Irradiance (N,) at the origin from convex polygons (N, S, 3) of radiance 1, cut by the horizon of (N, 3) normals.

    Lambert's formula, E = 1/2 sum of angle_i (v_i x v_i+1) / |v_i x v_i+1| . n, in either orientation.
    """
    total = np.zeros(len(vertices))
    leaving = entering = np.zeros((len(vertices), 3))
    for i in range(vertices.shape[1]):
        a, b = vertices[:, i - 1], vertices[:, i]
        above, below = _dot(a, normal), _dot(b, normal)
        gap = above - below
        t = np.where(gap == 0, 0.0, above / np.where(gap == 0, 1, gap))[:, None]
        crossing = a + np.clip(t, 0, 1) * (b - a)
        out, back = (above > 0) & (below <= 0), (above <= 0) & (below > 0)
        leaving = np.where(out[:, None], crossing, leaving)
        entering = np.where(back[:, None], crossing, entering)
        start, end = np.where(back[:, None], crossing, a), np.where(out[:, None], crossing, b)
        total += np.where((above > 0) | (below > 0), _edge(start, end, normal), 0.0)
    return np.abs(total + _edge(leaving, entering, normal)) / 2


def _narrow_irradiance(position: np.ndarray, normal: np.ndarray, light: Light) -> np.ndarray:
    """Irradiance of an area light whose beam is narrowed: a grid over the part that can shine here. Rows of an ellipse
    lie at even angles, and are as long as its chords."""
    axis_u, axis_v = area_axes(light)
    half = np.array([np.linalg.norm(axis_u), np.linalg.norm(axis_v)])
    unit = np.stack([axis_u, axis_v]) / half[:, None]
    offset = position - light.position
    height = np.maximum(offset @ light.direction, 1e-9)
    foot = offset @ unit.T
    reach = (height * np.tan(light.spread / 2))[:, None]
    low, high = np.maximum(foot - reach, -half), np.minimum(foot + reach, half)
    ends = np.stack([low[:, 1], high[:, 1]], axis=1)
    if light.ellipse:
        ends = np.arcsin(np.clip(ends / half[1], -1, 1))
    between = np.maximum(ends[:, 1] - ends[:, 0], 0) / SPREAD_CELLS

    total = np.zeros(len(position))
    for cell in range(SPREAD_CELLS**2):
        row = ends[:, 0] + between * (cell // SPREAD_CELLS + 0.5)
        chord = np.cos(row) if light.ellipse else np.ones_like(row)
        left, right = np.maximum(low[:, 0], -chord * half[0]), np.minimum(high[:, 0], chord * half[0])
        width = np.maximum(right - left, 0) / SPREAD_CELLS
        across = left + width * (cell % SPREAD_CELLS + 0.5)
        place = np.stack([across, half[1] * np.sin(row) if light.ellipse else row], axis=1)
        to_light = light.position + place @ unit - position
        d2 = (to_light**2).sum(1)
        d = np.sqrt(d2)
        cos_light = height / d
        cosine = np.maximum(_dot(to_light, normal) / d, 0)
        area = width * between * (half[1] * chord if light.ellipse else 1)
        total += area * _beam(cos_light, light.spread / 2) * cosine * cos_light / d2
    return total


def _beam(cosine: np.ndarray, half_spread: float) -> np.ndarray:
    """Blender's soft-box grid: the share of light at an angle from the light's normal, of mean 1 over the flux."""
    tangent = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 1e-6)
    return np.maximum(np.tan(half_spread) - tangent, 0) / beam_mean(half_spread)


def _shade_world(normal: np.ndarray, material: _Material, world: World, atlas: np.ndarray | None) -> np.ndarray:
    if world.image is None:
        return world.color * (material.diffuse + material.reflectance)
    if atlas is None:
        atlas = environment.build_atlas(world.image)
    # A rough lobe leans from the mirror direction towards the normal (Lagarde and de Rousiers 2014, 4.9.3).
    smooth = 1 - material.alpha
    lean = smooth * (np.sqrt(smooth) + material.alpha)
    direction = unit_rows(material.normal + lean[:, None] * (material.mirror - material.normal))
    image = world.world_rotation.T
    roughness = np.clip(material.surface.roughness, 0, 1)
    return material.diffuse * environment_lookup.mean_radiance(atlas, normal @ image) + (
        material.reflectance * environment_lookup.radiance(atlas, direction @ image, roughness)
    )


def _outline(light: Light) -> np.ndarray:
    """(S, 3) corners of an area light; an ellipse becomes a polygon of its area."""
    axis_u, axis_v = area_axes(light)
    if not light.ellipse:
        corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    else:
        angle = 2 * np.pi * np.arange(ELLIPSE_SIDES) / ELLIPSE_SIDES
        grow = np.sqrt(angle[1] / np.sin(angle[1]))
        corners = grow * np.stack([np.cos(angle), np.sin(angle)], -1)
    return light.position + corners @ np.stack([axis_u, axis_v])


def _edge(a: np.ndarray, b: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The angle between a and b times the normal component of their unit cross product."""
    cross = np.cross(a, b)
    length = np.linalg.norm(cross, axis=-1)
    return np.arctan2(length, _dot(a, b)) * _dot(cross, normal) / np.maximum(length, 1e-30)


def _triangle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Solid angle of spherical triangles of unit vectors (Van Oosterom and Strackee 1983)."""
    volume = np.abs(_dot(a, np.cross(b, c)))
    return 2 * np.arctan2(volume, 1 + _dot(a, b) + _dot(b, c) + _dot(c, a))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)
