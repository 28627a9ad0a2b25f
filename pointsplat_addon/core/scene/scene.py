"""What is drawn, as plain frozen dataclasses: no Blender, no GPU.

Transforms are named destination_from_source and are (4, 4) float64 for column vectors. Colours are
scene-linear. Lengths are Blender units in world space unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..numeric.record import record, value_record
from .captured import CapturedSplats
from .cloud import PointCloud
from .lights import Light
from .materials import MaterialTable
from .mesh import Mesh
from .strands import Strands
from .volume import Volume
from .world import Mist, World


class PageSplats(NamedTuple):
    """The splats of a page."""

    cloud: PointCloud  # of points without radii where these depend on what else is drawn; of nodes as balls
    shape: np.ndarray | None = None  # (N, 8) float32, core.lod.balls.tree.BallTree.shape: the splats are nodes


class PageLook(Protocol):
    """How the elements of a page become splats."""

    key: str  # content key of all that decides it

    def splats(self, elements: Mapping[str, np.ndarray], additive: bool) -> PageSplats | None:
        """Returns the splats of a page's elements, see formats/hierarchies/source.py; None: none of them is drawn.

        `additive`: points of other pages lie between these. Several threads may call it.
        """
        ...


@value_record
class PointSize:
    """What radius the points of a scan have, in object units."""

    radius: float = 0.0  # 0: half the distance between neighbours
    of_spacing: bool = False  # it counts in the distances between neighbours

    def of(self, spacing: np.ndarray) -> np.ndarray:
        """Returns the radii (N,) of points that lie `spacing` (N,) apart."""
        if self.radius <= 0:
            return 0.5 * spacing
        return self.radius * spacing if self.of_spacing else np.full_like(spacing, self.radius)


@record
class StreamedScan:
    """A scan in a file, without its points. Pages are in object units, relative to the directory's origin, which is the
    object's own."""

    scan: Any  # stream.scan.PagedScan
    look: PageLook
    size: PointSize = field(default_factory=PointSize)
    box_from_object: np.ndarray | None = None  # (B, 4, 4): clip boxes, cubes from -1 to 1; None: nothing is clipped
    inside: bool = True  # whether what lies in one of the boxes is drawn; else what lies in none
    stand_in: PointCloud | None = None  # what is drawn until the file is open, or where it cannot be read


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
    streamed: StreamedScan | None = None  # what a view reads of it becomes the cloud
    node_shape: np.ndarray | None = None  # (N, 8) float32, BallTree.shape: the cloud's points are nodes over balls
    primitive: str = "AUTO"  # one of PRIMITIVES
    spacing: float = 0.0  # distance between samples in object units; 0 chooses
    lattice: str = ""  # clouds of equal keys and attributes have the same points and half-axes; "": no other does
    extinction: float = 0.0  # of this geometry's points, per object unit; 0 takes it from the material
    lighting: str = "CAPTURED"  # of captured splats: one of LIGHTINGS
    pixel_radius: float = 0.0  # pixels: radius of a cloud's points in each view (splat/pixel_radii); 0: their own
    cells: np.ndarray | None = None  # (N, 3) int, of a cloud that was a volume: the lattice's cell of each point


@record
class Instances:
    """One row for each thing that is drawn."""

    geometry: np.ndarray  # (I,) int32, rows of Scene.geometries
    world_from_object: np.ndarray  # (I, 4, 4) float64
    previous: np.ndarray | None = None  # (I, 4, 4) float64: world_from_object a frame before; only for the Vector pass
    pass_index: np.ndarray | None = None  # (I,) int32
    holdout: np.ndarray | None = None  # (I,) bool: cuts a hole into alpha
    casts: np.ndarray | None = None  # (I,) bool: casts shadows; None: all do
    seen: np.ndarray | None = None  # (I,) bool: cameras see it; None: all
    scatters: np.ndarray | None = None  # (I,) bool: it hides and lights what indirect light falls on; None: all do
    mirrored: np.ndarray | None = None  # (I,) bool: rays from sharp mirrors meet it; None: all
    # (I,) bool: meshes that stand for surfaces of footage or captures: they hide what is behind them, are not seen, and
    # catch shadows
    matte: np.ndarray | None = None
    object_hash: np.ndarray | None = None  # (I,) uint32: cryptomatte hash of the object's name
    names: tuple[str, ...] = ()  # object name for each row, for messages
    objects: dict[str, np.ndarray] = field(default_factory=dict)  # values that materials read, by name, (I, C) float32

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
