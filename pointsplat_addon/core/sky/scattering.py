"""The sky as sunlight that the air and its aerosols scatter and, with ozone, absorb (Nishita, Sirai, Tadamura &
Nakamae 1993, "Display of the Earth taking into account atmospheric scattering")."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .medium import Medium

CHUNK = 2048  # directions at a time


class Often(Protocol):
    """Light that has been scattered more than once: radiance (N, K), the same in all directions, at points (N, 3)."""

    def __call__(self, at: np.ndarray, sun: np.ndarray) -> np.ndarray: ...


def scattered(direction: np.ndarray, sun: np.ndarray, medium: Medium, often: Often | None = None) -> np.ndarray:
    """Radiance (N, K) W/m2/sr per nanometre that the sky has in unit directions (N, 3); rays end at the ground.

    sun: (3,) unit, towards it. often: the light that is scattered more than once; None: it is left out.
    """
    parts = [_scattered(direction[i : i + CHUNK], sun, medium, often) for i in range(0, len(direction), CHUNK)]
    return np.concatenate(parts) if parts else np.zeros((0, len(medium.irradiance)), np.float32)


def _scattered(direction: np.ndarray, sun: np.ndarray, medium: Medium, often: Often | None) -> np.ndarray:
    step = path_length(medium, medium.eye, direction) / medium.steps
    cosine = direction @ sun
    phases = np.stack([3 / (16 * np.pi) * (1 + cosine**2), medium.phase(cosine)], axis=1)
    extinction, scattering, irradiance = (
        x.astype(np.float32) for x in (medium.extinction, medium.scattering, medium.irradiance)
    )
    before = np.zeros((len(direction), len(irradiance)), np.float32)  # optical depth along the ray so far
    found = np.zeros_like(before)
    for k in range(medium.steps):
        at = medium.eye + ((k + 0.5) * step)[:, None] * direction
        here = medium.densities(np.linalg.norm(at, axis=1) - medium.ground) * step[:, None]
        depth = here.astype(np.float32) @ extinction
        if medium.exact_steps:
            dimmed = np.exp(-before) * np.divide(-np.expm1(-depth), depth, np.ones_like(depth), where=depth > 0)
        before += depth
        if not medium.exact_steps:
            dimmed = np.exp(-before)
        lit = np.flatnonzero(~hits_ground(medium, at, sun))
        reached = np.exp(-depth_to_end(medium, at[lit], sun)) * irradiance
        found[lit] += dimmed[lit] * ((here[lit, :2] * phases[lit]).astype(np.float32) @ scattering) * reached
        if often is not None:
            found += dimmed * (here[:, :2].astype(np.float32) @ scattering) * often(at, sun)
    return found


def sun_through(direction: np.ndarray, medium: Medium) -> np.ndarray:
    """The irradiance (N, K), W/m2 per nanometre, at the eye of suns in directions (N, 3)."""
    eye = np.broadcast_to(medium.eye, direction.shape)
    depth = densities_along(medium, eye, direction, 4 * medium.steps_to_sun) @ medium.of_disc
    return np.where(hits_ground(medium, eye, direction)[:, None], 0.0, np.exp(-depth) * medium.irradiance)


def depth_to_end(medium: Medium, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Optical depth (N, K) float32 from points (N, 3) to the end of the atmosphere in directions (3,) or (N, 3)."""
    along = densities_along(medium, at, np.broadcast_to(direction, at.shape), medium.steps_to_sun)
    return along.astype(np.float32) @ medium.extinction.astype(np.float32)


def densities_along(medium: Medium, at: np.ndarray, direction: np.ndarray, steps: int) -> np.ndarray:
    """Densities (N, 3) summed, in metres, from points (N, 3) to the end of the atmosphere in directions (N, 3)."""
    step = _distance_to(medium.top, at, direction) / steps
    total = np.zeros((len(at), 3))
    for k in range(steps):
        point = at + ((k + 0.5) * step)[:, None] * direction
        total += medium.densities(np.linalg.norm(point, axis=1) - medium.ground)
    return total * step[:, None]


def path_length(medium: Medium, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Metres (N,) along rays from points (3,) or (N, 3) to the ground or, where they miss it, the atmosphere's end."""
    b = (at * direction).sum(axis=-1)
    under = b * b - (at * at).sum(axis=-1) + medium.ground**2
    ground = -b - np.sqrt(np.maximum(under, 0.0))
    return np.where((b < 0) & (under >= 0), ground, _distance_to(medium.top, at, direction))


def hits_ground(medium: Medium, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether rays from points (N, 3) meet the ground, (N,)."""
    b = (at * direction).sum(axis=-1)
    return (b < 0) & (b * b - (at * at).sum(axis=-1) + medium.ground**2 >= 0)


def _distance_to(radius: float, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distance (N,) from within a sphere about the Earth's centre to it."""
    b = (at * direction).sum(axis=-1)
    return np.sqrt(np.maximum(b * b - (at * at).sum(axis=-1) + radius**2, 0)) - b
