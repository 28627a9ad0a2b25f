"""PointCloud: rendering-oriented point attributes (Gunjee et al. 2007, section 3) as a structure of arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

ATTRIBUTES: dict[str, tuple[tuple[int, ...] | None, type]] = {
    # name: (shape of one point's value, dtype). None: any trailing shape.
    "position": ((3,), np.float32),
    "normal": ((3,), np.float32),
    "axis": ((3,), np.float32),
    "radii": (None, np.float32),
    "color": ((3,), np.float32),
    "opacity": ((), np.float32),
    "surface": ((2,), np.float32),
    "emission": ((3,), np.float32),
    "shading_normal": ((3,), np.float32),
    "extinction": (None, np.float32),
    "material": ((), np.uint16),
    "value": ((), np.float32),
    "kernel": ((), np.uint8),
    "disconnected": ((), np.bool_),
    "facets": ((4, 3), np.int8),
}

FARTHEST = 1e18  # of lengths: their squares fit float32
LENGTHS = ("position", "normal", "axis", "radii", "shading_normal")
SCATTERED = 1 << 16  # points: fewer stay in the caches, whatever their order


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Splats of one object, in object units relative to `origin`. An absent attribute is None and costs nothing.

    A surface sample is a flat ellipse: `normal`, major half-axis direction `axis`, half-axes `radii`
    (major, minor). With `axis` None the ellipse is a disk of radius radii[:, 0]; with `normal` None the
    splat faces the viewer (a ball of that radius).
    """

    position: np.ndarray  # (N, 3) float32, relative to origin
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, object space
    normal: np.ndarray | None = None  # (N, 3) float32, unit
    axis: np.ndarray | None = None  # (N, 3) float32, unit, perpendicular to normal
    radii: np.ndarray | None = None  # (N, 1 | 2 | 3) float32, half-axes in object units
    color: np.ndarray | None = None  # (N, 3) float32, scene-linear base colour
    opacity: np.ndarray | None = None  # (N,) float32, at the splat's centre
    surface: np.ndarray | None = None  # (N, 2) float32: roughness, metallic (where they vary within a material)
    emission: np.ndarray | None = None  # (N, 3) float32, scene-linear emitted radiance (where it varies)
    shading_normal: np.ndarray | None = None  # (N, 3) float32, unit where they are not the splat's own `normal`
    extinction: np.ndarray | None = None  # (N,) or (N, 3) float32, per object unit
    material: np.ndarray | None = None  # (N,) uint16, rows of the material table
    value: np.ndarray | None = None  # (N,) float32, physical scalar for transfer functions
    kernel: np.ndarray | None = (
        None  # (N,) uint8, row of core.kernel.PROFILES: shape of splats that light passes through
    )
    disconnected: np.ndarray | None = None  # (N,) bool: foliage: closes no surface with its neighbours
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

    def arrays(self) -> dict[str, np.ndarray]:
        """The attributes that are present, by name."""
        named = {name: getattr(self, name) for name in ATTRIBUTES}
        return {name: array for name, array in named.items() if array is not None}

    def take(self, index: np.ndarray | slice) -> PointCloud:
        """The points that `index` selects, in its order."""
        if isinstance(index, slice):
            return replace(self, **{name: array[index] for name, array in self.arrays().items()})
        rows = np.flatnonzero(index) if index.dtype == bool else index
        # Several times faster than indexing.
        return replace(self, **{name: np.take(array, rows, axis=0) for name, array in self.arrays().items()})


def coherent(cloud: PointCloud) -> PointCloud:
    """The points in an order in which those that follow one another lie close together: what neighbouring pixels show
    then lies side by side in memory.

    By cells of a grid of 32 to each side in Morton order, stably. A cloud that has such an order already, as most
    scans and files do, stays as it is, and so does one that fits the processor's caches.
    """
    if len(cloud) < SCATTERED:
        return cloud
    key = np.zeros(len(cloud), np.uint16)
    columns = cloud.position.T
    low = [float(column.min()) for column in columns]
    side = max(float(column.max()) for column in (c - np.float32(o) for c, o in zip(columns, low, strict=True)))
    for axis in range(3):
        cell = ((columns[axis] - np.float32(low[axis])) * np.float32(31.99 / max(side, 1e-30))).astype(np.uint16)
        for bit in range(5):
            key |= ((cell >> bit) & 1) << (3 * bit + axis)
    occupied = np.count_nonzero(np.bincount(key))
    if np.count_nonzero(key[1:] != key[:-1]) < max(len(key) // 4, 2 * occupied):
        return cloud
    return cloud.take(np.argsort(key, kind="stable"))
