"""Lights in world space, in radiometric quantities."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record


@record
class Light:
    """A light in world space, in radiometric quantities; host/convert turns Blender's power into them."""

    kind: str  # POINT, SUN, SPOT, AREA
    color: (
        np.ndarray
    )  # (3,) float64. POINT/SPOT: radiant intensity W/sr; SUN: irradiance W/m2; AREA: radiance W/(m2 sr)
    position: np.ndarray  # (3,) float64; ignored by SUN
    direction: np.ndarray  # (3,) float64, unit, where the light shines (its local -Z)
    radius: float = 0.0  # sphere radius (POINT, SPOT); SUN: half angle in radians
    spot_cos: float = -1.0  # SPOT: cosine of half the cone angle
    spot_blend: float = 0.0  # SPOT: Blender's blend in [0, 1]
    # AREA: (3,) half-extent vector of the first and second side. SPOT: rows X and Y of the inverse of its matrix,
    # divided by the length of row Z (unit local axes where the scale is uniform; None: a round cone)
    axis_u: np.ndarray | None = None
    axis_v: np.ndarray | None = None
    ellipse: bool = False  # AREA: disk or ellipse instead of a rectangle
    spread: float = float(np.pi)  # AREA: full angle of the beam in radians
    soft: bool = True  # POINT, SPOT: a disk that faces the receiver instead of a sphere (Blender's soft falloff)
    diffuse: float = 1.0  # factor on diffuse light
    specular: float = 1.0  # factor on specular light
    shadow: bool = True
    name: str = ""
