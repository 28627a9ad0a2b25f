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
}


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
        return replace(self, **{name: array[index] for name, array in self.arrays().items()})


def finite(cloud: PointCloud) -> tuple[PointCloud, int]:
    """The cloud without points that hold a NaN or an infinity in any attribute, and how many were dropped."""
    good = np.ones(len(cloud), bool)
    for array in cloud.arrays().values():
        if array.dtype.kind == "f":
            good &= np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    dropped = len(cloud) - int(np.count_nonzero(good))
    return (cloud if dropped == 0 else cloud.take(good)), dropped
