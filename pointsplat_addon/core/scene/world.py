"""The world: light from infinitely far, and mist."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..numeric.record import record


@record
class World:
    """Light from infinitely far: a colour, or an equirectangular picture."""

    color: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64 radiance; used when image is None
    image: np.ndarray | None = None  # (H, W, 3) float32 radiance, row 0 at the bottom (-Z), Blender's equirect layout
    world_rotation: np.ndarray = field(default_factory=lambda: np.eye(3))  # (3, 3) image_from_world


@record
class Mist:
    start: float = 5.0
    depth: float = 25.0
    falloff: str = "QUADRATIC"  # QUADRATIC, LINEAR, INVERSE_QUADRATIC
