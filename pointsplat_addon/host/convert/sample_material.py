"""What the samples of points and strands need to know of their material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...core.material.evaluation import SurfaceConstants
from ...core.material.graph import MaterialGraph, Needs, needs, of_one_object
from ...core.numeric.record import record
from ...core.scene.materials import MaterialTable
from ...core.scene.volume import Medium


def needs_of_materials(materials: tuple[SampleMaterial, ...]) -> Needs:
    """The attributes that the graphs of any of these materials read."""
    found = [needs(m.graph) for m in materials if m.graph]
    return Needs(
        uv=frozenset().union(*(n.uv for n in found)),
        colors=frozenset().union(*(n.colors for n in found)),
        generated=any(n.generated for n in found),
    )


@record
class SampleMaterial:
    """One row of the table of materials, as the conversion of points and strands needs it."""

    row: int  # of the table; 0: no material, and then attributes with the names that importers give have the colours
    graph: MaterialGraph | None = None
    roughness: float = 0.5  # the constants, used where only the other one varies
    metallic: float = 0.0
    emission: tuple[float, ...] = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    translucent: bool = False
    medium: Medium | None = None  # of a material with a volume and no surface
    extinction: float = 0.0  # the object's own, per object unit; 0 takes the material's
    base_color: tuple[float, ...] = (0.8, 0.8, 0.8)  # of strands, which may have several materials
    transmission_color: tuple[float, ...] = (1.0, 1.0, 1.0)

    @property
    def key(self) -> str:
        """What tells materials apart whose samples differ, but for the base colour."""
        volume = None if self.medium is None else [np.asarray(v).tolist() for v in vars(self.medium).values()]
        looks = self.roughness, self.metallic, self.emission, self.alpha, self.translucent, self.extinction
        looks += self.transmission_color
        return repr((self.row, self.graph and self.graph.digest, looks, volume))


def sample_material(
    table: MaterialTable, row: int, extinction: float = 0.0, values: Mapping[str, np.ndarray] | None = None
) -> SampleMaterial:
    """The material in a row of the table on an object.

    extinction: the object's own per object unit; 0 takes the material's. values: (C,) of the object, by the names of
    core.material.object_values.
    """
    graph = table.graphs[row] if row < len(table.graphs) else None
    if values and isinstance(graph, MaterialGraph) and needs(graph).objects:
        graph = of_one_object(graph, values)
    alpha = float(table.alpha[row])
    varies = isinstance(graph, MaterialGraph) and graph.alpha is not None
    return SampleMaterial(
        row,
        graph,  # pyright: ignore[reportArgumentType]
        float(table.roughness[row]),
        float(table.metallic[row]),
        tuple(table.emission[row].tolist()),
        alpha,
        table.translucent is not None and bool(table.translucent[row]),
        table.media[row] if row < len(table.media) and alpha == 0 and not varies else None,
        extinction,
        tuple(table.base_color[row].tolist()),
        (1.0, 1.0, 1.0) if table.transmission_color is None else tuple(table.transmission_color[row].tolist()),
    )


def surface_constants(materials: Sequence[SampleMaterial]) -> SurfaceConstants:
    """The constants of M materials in their order: columns (M,) or (M, 3) float32."""

    def column(name: str) -> np.ndarray:
        return np.array([getattr(m, name) for m in materials], np.float32)

    names = ("base_color", "roughness", "metallic", "emission", "alpha", "transmission_color")
    return SurfaceConstants(*map(column, names))


def generated_coordinates(position: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Positions (N, 3) as fractions of the box from low to high, (3,) each; a side of length 0 counts as 2 long."""
    flat = high <= low
    return (position - np.where(flat, low - 1, low)) / np.where(flat, 2, high - low)
