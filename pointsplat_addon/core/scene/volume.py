"""Volumes as sparse voxels, and what fills them: media and transfer functions."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from ..numeric.record import record


@record
class Volume:
    """Active voxels of one evaluated volume object, sparse, in index space: an integer index is a voxel's centre."""

    key: str  # content key of the voxels
    name: str  # the object's name, for messages
    index: np.ndarray  # (N, 3) int32
    object_from_index: np.ndarray  # (4, 4) float64
    # Grids by name, (N,) or (N, 3) float32: density, temperature, color, ... Voxels that a grid lacks hold 0.
    grids: dict[str, np.ndarray] = field(default_factory=dict)
    material: int = 0  # row of Scene.materials
    transfer: Transfer | None = None  # instead of what the material says
    share: np.ndarray | None = None  # (N,) float32 in [0, 1], of each voxel, that the medium fills; None: all of it
    scale: float = 1.0  # of object units in the units of length that the medium's density counts in


@record
class Transfer:
    """A transfer function: a colour ramp over the values of one grid."""

    grid: str
    low: float  # the value at the ramp's left end
    high: float  # and at its right end
    ramp: np.ndarray  # (R, 4) float32: scene-linear colour, opacity in [0, 1], evenly spaced over [low, high]
    density: float = 1.0  # extinction per object unit where the ramp's opacity is 1


@record
class Medium:
    """What fills a volume: Blender's Principled Volume, Volume Absorption and Volume Scatter, per object unit.

    Scattering is density times color, absorption is density times (1 - color) times (1 - sqrt(absorption)).
    """

    density: float = 1.0
    density_grid: str = "density"  # empty: the density is the same everywhere
    color: np.ndarray = field(default_factory=lambda: np.full(3, 0.5))  # (3,) float64
    color_grid: str = ""
    absorption: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64
    anisotropy: float = 0.0  # Henyey-Greenstein's g
    emission: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, radiance per unit of length
    blackbody: float = 0.0  # intensity
    blackbody_tint: np.ndarray = field(default_factory=lambda: np.ones(3))
    temperature: float = 1000.0  # kelvin, times the grid where there is one
    temperature_grid: str = "temperature"
