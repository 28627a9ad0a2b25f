"""What is drawn, as plain frozen dataclasses: no Blender, no GPU.

Transforms are named destination_from_source and are (4, 4) float64 for column vectors. Colours are
scene-linear. Lengths are Blender units in world space unless said otherwise.
"""

from __future__ import annotations

from dataclasses import field
from itertools import pairwise

import numpy as np

from ..numeric.record import record
from .captured import CapturedSplats
from .cloud import PointCloud
from .lights import Light
from .materials import MaterialTable
from .mesh import Mesh
from .strands import Strands
from .volume import Volume
from .world import Mist, World


@record
class Geometry:
    """What an instance refers to: a mesh (points or polygons), a cloud or a volume (both points), strands, or
    captured splats."""

    key: str  # content key
    name: str
    mesh: Mesh | None = None
    cloud: PointCloud | None = None
    volume: Volume | None = None
    strands: Strands | None = None
    captured: CapturedSplats | None = None
    primitive: str = "AUTO"  # one of PRIMITIVES
    spacing: float = 0.0  # distance between samples in object units; 0 chooses
    lattice: str = ""  # clouds of equal keys and attributes have the same points and half-axes; "": no other does
    extinction: float = 0.0  # of this geometry's points, per object unit; 0 takes it from the material
    lighting: str = "CAPTURED"  # of captured splats: one of LIGHTINGS
    pixel_radius: float = 0.0  # pixels: radius of a cloud's points in each view (splat/pixel_radii); 0: their own


@record
class Instances:
    """One row for each thing that is drawn."""

    geometry: np.ndarray  # (I,) int32, rows of Scene.geometries
    world_from_object: np.ndarray  # (I, 4, 4) float64
    previous: np.ndarray | None = None  # (I, 4, 4) float64: world_from_object a frame before; only for the Vector pass
    pass_index: np.ndarray | None = None  # (I,) int32
    holdout: np.ndarray | None = None  # (I,) bool: cuts a hole into alpha
    casts: np.ndarray | None = None  # (I,) bool: casts shadows; None: all do
    # (I,) bool: meshes that stand for captured surfaces: they hide what is behind them, are not seen, and catch shadows
    matte: np.ndarray | None = None
    object_hash: np.ndarray | None = None  # (I,) uint32: cryptomatte hash of the object's name
    names: tuple[str, ...] = ()  # object name for each row, for messages

    def __len__(self) -> int:
        return len(self.geometry)

    def of_each(self, geometries: int, which: np.ndarray | None = None) -> list[np.ndarray]:
        """Returns the rows, rising, of the instances of each of so many geometries; of `which`, (I,) bool, alone."""
        rows = np.arange(len(self)) if which is None else np.flatnonzero(which)
        rows = rows[np.argsort(self.geometry[rows], kind="stable")]
        ends = np.searchsorted(self.geometry[rows], np.arange(geometries + 1)).tolist()
        return [rows[low:high] for low, high in pairwise(ends)]


@record
class Scene:
    """Everything that a frame needs but the camera."""

    geometries: tuple[Geometry, ...]
    instances: Instances
    materials: MaterialTable
    lights: tuple[Light, ...] = ()
    world: World = field(default_factory=World)
    transparent: bool = False  # film: the world is not drawn, only shines
    mist: Mist = field(default_factory=Mist)
    warnings: tuple[str, ...] = ()
    validated: bool = False  # core/scene/validation.py has seen it
