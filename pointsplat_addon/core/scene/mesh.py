"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one evaluated mesh, in object space. Per-corner attributes are (T, 3, ...)."""

    key: str  # content key: equal keys mean equal arrays
    name: str  # the object's name, for messages
    position: np.ndarray  # (V, 3) float32
    triangles: np.ndarray  # (T, 3) int32, rows of position
    vertex_normal: np.ndarray | None = None  # (V, 3) float32; set when every corner of a vertex shares it
    corner_normal: np.ndarray | None = None  # (T, 3, 3) float32; set otherwise
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # map name to (T, 3, 2) float32
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # attribute name to (T, 3, 4) float32, scene-linear
    active_uv: str | None = None  # the map that a texture node without a UV Map node reads
    material: np.ndarray | None = None  # (T,) uint16, rows of Scene.materials; None: all `materials[0]`
    materials: tuple[int, ...] = (0,)  # the rows in use
    topology: str = ""  # content key of all but positions and normals: equal keys mean that samples can be kept

    @property
    def nbytes(self) -> int:
        arrays = [self.position, self.triangles, self.vertex_normal, self.corner_normal, self.material]
        arrays += [*self.uv.values(), *self.colors.values()]
        return sum(a.nbytes for a in arrays if a is not None)
