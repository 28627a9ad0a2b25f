"""PointCloud: rendering-oriented point attributes (Gunjee et al. 2007, section 3) as a structure of arrays."""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property

import numpy as np

from ..numeric.record import record
from ..numeric.segments import sorted_places
from ..numeric.vectors import column_ranges, each_block, moved_rows, take_rows

ATTRIBUTES: dict[str, tuple[tuple[int, ...] | None, type]] = {
    # name: (shape of one point's value, dtype). None: any trailing shape.
    "position": ((3,), np.float32),
    "normal": ((3,), np.float32),
    "axis": ((3,), np.float32),
    "radii": (None, np.float32),
    "color": ((3,), np.float32),
    "opacity": (None, np.float32),
    "surface": ((2,), np.float32),
    "emission": ((3,), np.float32),
    "shading_normal": ((3,), np.float32),
    "velocity": ((3,), np.float32),
    "extinction": (None, np.float32),
    "shaded": ((3,), np.float32),
    "material": ((), np.uint16),
    "value": ((), np.float32),
    "kernel": ((), np.uint8),
    "disconnected": ((), np.bool_),
    "share": ((), np.float32),
    "span": ((), np.float32),
    "facets": ((4, 3), np.int8),
}

FARTHEST = 1e18  # of lengths: their squares fit float32
LENGTHS = ("position", "normal", "axis", "radii", "shading_normal")
SCATTERED = 1 << 16  # points: fewer stay in the caches, whatever their order
CELLS = 32  # of the grid by which points are put in order, to each side
SPREAD_BITS = np.array([sum((cell >> bit & 1) << 3 * bit for bit in range(5)) for cell in range(CELLS)], np.uint16)
RUN, RUNS = 4096, 64  # length and number of the runs of points by which the order of very many is judged


@record
class PointCloud:
    """Splats of one object, in object units relative to `origin`. An absent attribute is None and costs nothing.

    A surface sample is a flat ellipse: `normal`, major half-axis direction `axis`, half-axes `radii`
    (major, minor). With `axis` None the ellipse is a disk of radius radii[:, 0]; with `normal` None the
    splat faces the viewer (a ball of that radius). Among disks, a splat whose normal is zero is a ball.
    """

    position: np.ndarray  # (N, 3) float32, relative to origin
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, object space
    normal: np.ndarray | None = None  # (N, 3) float32, unit, or zero
    axis: np.ndarray | None = None  # (N, 3) float32, unit, perpendicular to normal
    radii: np.ndarray | None = None  # (N, 1 | 2 | 3) float32, half-axes in object units
    color: np.ndarray | None = None  # (N, 3) float32, scene-linear base colour
    opacity: np.ndarray | None = None  # (N,) or (N, 3) float32, at the splat's centre
    surface: np.ndarray | None = None  # (N, 2) float32: roughness, metallic (where they vary within a material)
    emission: np.ndarray | None = None  # (N, 3) float32, scene-linear emitted radiance (where it varies)
    shading_normal: np.ndarray | None = None  # (N, 3) float32, unit where they are not the splat's own `normal`
    velocity: np.ndarray | None = None  # (N, 3) float32, object units a frame: how points move within their object
    extinction: np.ndarray | None = None  # (N,) or (N, 3) float32, per object unit
    # (N, 3) float32, 0 to 1: how much of what each channel hides shows the splat's light, where the rest is absorbed
    shaded: np.ndarray | None = None
    material: np.ndarray | None = None  # (N,) uint16, rows of the material table
    value: np.ndarray | None = None  # (N,) float32, physical scalar for transfer functions
    kernel: np.ndarray | None = (
        None  # (N,) uint8, row of core.kernel.PROFILES: shape of splats that light passes through
    )
    disconnected: np.ndarray | None = None  # (N,) bool: foliage: closes no surface with its neighbours
    share: np.ndarray | None = None  # (N,) float32, 0 to 1: how much of a splat's ellipse or ball there is; None: all
    span: np.ndarray | None = None  # (N,) float32: over a splat's size, that of the flat piece of surface it lies in
    # (N, 4, 3) int8, 127 times normals of which a splat shows one that faces the viewer, where it stands for a surface
    # that is turned to several sides: as long as the shares that these have in its area. Zeros: its own.
    facets: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Raise ValueError where an attribute's length, shape or dtype does not fit."""
        count = len(self.position)
        for name, (shape, dtype) in ATTRIBUTES.items():
            array = getattr(self, name)
            if array is None:
                continue
            if array.dtype != dtype:
                raise ValueError(f"PointCloud.{name} has dtype {array.dtype}, expected {np.dtype(dtype)}")
            if len(array) != count:
                raise ValueError(f"PointCloud.{name} has {len(array)} rows for {count} points")
            if shape is not None and array.shape[1:] != shape:
                raise ValueError(f"PointCloud.{name} has shape {array.shape}, expected (N, {shape})")

    def __len__(self) -> int:
        return len(self.position)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in self.arrays().values())

    @property
    def round_balls(self) -> bool:
        """Whether all splats are balls with a radius of their own."""
        return self.normal is None and self.radii is not None and self.radii.shape[1] == 1

    @cached_property
    def has_balls(self) -> bool:
        """Whether some splats are balls."""
        return self.normal is None or not self.normal.any(axis=1).all()

    def arrays(self) -> dict[str, np.ndarray]:
        """The attributes that are present, by name."""
        named = {name: getattr(self, name) for name in ATTRIBUTES}
        return {name: array for name, array in named.items() if array is not None}

    def material_rows(self) -> np.ndarray:
        """(R,) rows of the material table that the points name, rising; row 0 where they name none."""
        material = self.material
        if material is None or len(material) == 0:
            return np.zeros(0 if material is not None else 1, np.uint16)
        low, high = material.min(), material.max()
        return np.array([low]) if low == high else np.unique(material)

    def take(self, index: np.ndarray | slice) -> PointCloud:
        """The points that `index` selects, in its order."""
        if isinstance(index, slice):
            return replace(self, **{name: array[index] for name, array in self.arrays().items()})
        rows = np.flatnonzero(index) if index.dtype == bool else index
        return replace(self, **{name: take_rows(array, rows) for name, array in self.arrays().items()})


def coherent(cloud: PointCloud) -> PointCloud:
    """The points in an order in which those that follow one another lie close together: see `coherent_places`."""
    places = coherent_places(cloud.position)
    if places is None:
        return cloud
    return replace(cloud, **{name: moved_rows(array, places) for name, array in cloud.arrays().items()})


def coherent_places(position: np.ndarray) -> np.ndarray | None:
    """(N,) integers: where each of the points (N, 3) comes in an order in which those that follow one another lie close
    together; None: where it is.

    What neighbouring pixels show then lies side by side in memory.

    By cells of a grid of 32 to each side in Morton order, stably. Points that have such an order already, as those of
    most scans and files do, stay as they are, and so do those that fit the processor's caches, and those of which some
    are not finite.
    """
    count = len(position)
    if count < SCATTERED:
        return None
    corner, high = column_ranges(position)
    if not np.isfinite([corner, high]).all():
        return None
    side = float((high - corner).max())
    scale = np.float32((CELLS - 0.01) / max(side, 1e-30))

    def cells(points: np.ndarray) -> np.ndarray:
        """(n,) uint16 Morton codes of the cells of points (n, 3)."""
        code = np.zeros(len(points), np.uint16)
        for axis, column in enumerate(points.T):
            code |= SPREAD_BITS.take(((column - corner[axis]) * scale).astype(np.intp)) << np.uint16(axis)
        return code

    # Of very many points some runs tell whether neighbours follow one another.
    runs = [position[at : at + RUN] for at in np.linspace(0, count - RUN, RUNS).astype(int)]
    if count > 4 * RUNS * RUN and sum(_steps(cells(run)) for run in runs) < RUNS * RUN // 4:
        return None
    code = np.empty(count, np.uint16)

    def fill(block: slice) -> None:
        code[block] = cells(position[block])

    each_block(count, fill)
    occupied = np.count_nonzero(np.bincount(code))
    if _steps(code) < max(count // 4, 2 * occupied):
        return None
    return sorted_places(code)


def _steps(code: np.ndarray) -> int:
    """How often a cell's code (n,) is followed by another."""
    return int(np.count_nonzero(code[1:] != code[:-1]))
