"""Lights' kinds and shapes: axes and beams of area lights, cones of spots, bounds of their irradiance."""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import row_frames
from ..scene.lights import Light

KINDS = ("SUN", "POINT", "SPOT", "RECTANGLE", "ELLIPSE")


def irradiance_bound(light: Light, distance: float) -> float:
    """Upper bound of a light's irradiance, W/m2 in the strongest channel, from `distance` to its centre on."""
    strength = float(np.abs(light.color).max())
    if strength == 0.0 or light.kind == "SUN":
        return strength
    if light.kind != "AREA":
        squared = distance**2 + light.radius**2 if light.soft else max(distance, light.radius) ** 2
        return strength / squared if squared > 0 else np.inf
    u, v = (float(np.linalg.norm(axis)) for axis in area_axes(light))
    away = max(distance - u - v, 0.0)
    seen = min(np.pi, 4 * u * v / away**2) if away > 0 else np.pi
    half = light.spread / 2
    return strength * seen * (float(np.tan(half) / beam_mean(half)) if is_narrowed(light) else 1.0)


def light_kind(light: Light) -> str:
    """The kind of a light as shaders know it, one of KINDS."""
    if light.kind != "AREA":
        return light.kind
    return "ELLIPSE" if light.ellipse else "RECTANGLE"


def blend_range(light: Light) -> float:
    """Range of cosines within which a spot's cone fades."""
    return max((1 - light.spot_cos) * light.spot_blend, 1e-6)


def is_narrowed(light: Light) -> bool:
    """Whether an area light's beam is narrower than a half-space."""
    return light.spread < np.pi * 0.9999


def beam_mean(half_spread: float) -> float:
    """Mean over the flux of a narrowed beam's unscaled profile; half_spread in radians."""
    return max(np.tan(half_spread) - half_spread if half_spread > 0.05 else half_spread**3 / 3, 1e-12)


def area_axes(light: Light) -> tuple[np.ndarray, np.ndarray]:
    """A light's axis_u and axis_v (3,); any orthonormal ones if it has none, where they do not matter."""
    if light.axis_u is not None and light.axis_v is not None:
        return light.axis_u, light.axis_v
    u, v = row_frames(light.direction[None])
    return u[0], v[0]
