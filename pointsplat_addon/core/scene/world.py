"""The world: light from infinitely far, and mist."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..numeric.record import record


@record
class Fog:
    """A medium that fills all of the world, the same everywhere, per unit of length."""

    extinction: np.ndarray  # (3,) float64
    scattering: np.ndarray  # (3,) float64
    emission: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64 radiance
    anisotropy: float = 0.0  # Henyey-Greenstein's g


@record
class World:
    """Light from infinitely far: a colour, or an equirectangular picture."""

    color: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64 radiance; used when image is None
    image: np.ndarray | None = None  # (H, W, 3) float32 radiance, row 0 at the bottom (-Z), Blender's equirect layout
    world_rotation: np.ndarray = field(default_factory=lambda: np.eye(3))  # (3, 3) image_from_world
    fog: Fog | None = None
    mirrored: np.ndarray | None = None  # (H, W, 3) float32: what is seen in glossy surfaces instead of `image`
    seen: World | None = None  # what cameras see instead, without fog of its own; None: the same
    occlusion_distance: float = np.inf  # how far away things may be that count for the pass of ambient occlusion

    @property
    def behind(self) -> World:
        """What cameras see behind everything."""
        return self if self.seen is None else self.seen


@record
class Mist:
    start: float = 5.0
    depth: float = 25.0
    falloff: str = "QUADRATIC"  # QUADRATIC, LINEAR, INVERSE_QUADRATIC
