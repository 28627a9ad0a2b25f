"""Evaluates materials at samples of meshes, points and strands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ..numeric.record import record
from ..scene.materials import MaterialTable
from .expression import Part, SampleInputs, evaluate
from .graph import MaterialGraph
from .nodes.math_functions import normalize_rows

CHANNELS: dict[str, tuple[int, float | None]] = {
    # channel: (components, largest value); all but normals and tangents start at 0
    "base_color": (3, None),
    "roughness": (1, 1.0),
    "metallic": (1, 1.0),
    "alpha": (1, 1.0),
    "emission": (3, None),
    "normal": (3, None),
    "transmission_color": (3, 1.0),
    "tangent": (3, None),
}
SURFACE_COLUMNS = ("roughness", "metallic")  # of Appearance.surface


@record
class Appearance:
    """The attributes of N samples that vary between them. None: the material table's constants hold everywhere."""

    color: np.ndarray | None = None  # (N, 3) float32
    surface: np.ndarray | None = None  # (N, 2) float32: roughness, metallic
    emission: np.ndarray | None = None  # (N, 3) float32
    normal: np.ndarray | None = None  # (N, 3) float32, unit, object space
    alpha: np.ndarray | None = None  # (N,) float32
    transmission_color: np.ndarray | None = None  # (N, 3) float32
    tangent: np.ndarray | None = None  # (N, 3) float32: MaterialGraph.tangent


@record
class SurfaceConstants:
    """The constants of M materials, for inputs that no graph varies: columns as in MaterialTable."""

    base_color: np.ndarray  # (M, 3) float32
    roughness: np.ndarray  # (M,) float32
    metallic: np.ndarray  # (M,) float32
    emission: np.ndarray  # (M, 3) float32
    alpha: np.ndarray  # (M,) float32
    transmission_color: np.ndarray | None = None  # (M, 3) float32; None: all 1


def evaluate_materials(
    rows: np.ndarray,
    graphs: Mapping[int, MaterialGraph],
    inputs: Callable[[MaterialGraph, Part], SampleInputs],
    constants: MaterialTable | SurfaceConstants,
    normal: np.ndarray | None,
) -> Appearance:
    """Evaluates at N samples the graph of each sample's material, and fills in constants where none varies.

    rows: (N,) integers, the material of each sample; graphs: by row. An attribute is given for all samples as soon as
    one of the graphs varies it. inputs: returns what a graph reads at some of the samples, a slice or their indices.
    normal: (N, 3) float32, the samples' own normals; None: the attribute `normal` is neither evaluated nor given.
    """
    if normal is None:
        graphs = {row: replace(graph, normal=None) for row, graph in graphs.items()}
    if len(rows) and len(graphs) == 1 and (rows == (row := next(iter(graphs)))).all():
        return _of_one_material(row, graphs[row], inputs(graphs[row], slice(None)), constants)
    channels = {name for graph in graphs.values() for name in graph.channels}
    out: dict[str, np.ndarray] = {}
    if "base_color" in channels:
        out["color"] = constants.base_color[rows]
    if channels & set(SURFACE_COLUMNS):
        out["surface"] = np.stack([getattr(constants, name)[rows] for name in SURFACE_COLUMNS], axis=1)
    if "emission" in channels:
        out["emission"] = constants.emission[rows]
    if "normal" in channels and normal is not None:
        out["normal"] = normal.copy()
    if "alpha" in channels:
        out["alpha"] = constants.alpha[rows]
    if "transmission_color" in channels:
        colors = constants.transmission_color
        out["transmission_color"] = np.ones((len(rows), 3), np.float32) if colors is None else colors[rows]

    if "tangent" in channels:
        out["tangent"] = np.zeros((len(rows), 3), np.float32)

    for row, graph in graphs.items():
        found = np.flatnonzero(rows == row)
        if len(found) == 0:
            continue
        for name, value in evaluate_samples(graph, inputs(graph, found)).items():
            if name in SURFACE_COLUMNS:
                out["surface"][found, SURFACE_COLUMNS.index(name)] = value
            else:
                out["color" if name == "base_color" else name][found] = value
    return Appearance(**out)


def _of_one_material(
    row: int, graph: MaterialGraph, inputs: SampleInputs, constants: MaterialTable | SurfaceConstants
) -> Appearance:
    """The appearance of samples that all have the graph of one row."""
    values = evaluate_samples(graph, inputs)
    surface = None
    if values.keys() & set(SURFACE_COLUMNS):
        count = len(next(iter(values.values())))
        surface = np.empty((count, len(SURFACE_COLUMNS)), np.float32)
        for column, name in zip(surface.T, SURFACE_COLUMNS, strict=True):
            column[:] = values.get(name, getattr(constants, name)[row])
    rest = (values.get(name) for name in ("emission", "normal", "alpha", "transmission_color", "tangent"))
    return Appearance(values.get("base_color"), surface, *rest)


def evaluate_samples(graph: MaterialGraph, inputs: SampleInputs) -> dict[str, np.ndarray]:
    """Each varying channel at N samples: (N, 3) or, for scalars, (N,) float32; finite, in its range, normals unit.

    Raises ValueError when `inputs` holds neither arrays nor a count.
    """
    out = {}
    for name, output in graph.channels.items():
        components, top = CHANNELS[name]
        value = evaluate(output, inputs)
        if not np.isfinite(value).all():
            value = np.nan_to_num(value, copy=False, posinf=0.0, neginf=0.0)
        if name == "normal":
            value = normalize_rows(value).astype(np.float32, copy=False)
            flat = ~value.any(axis=1)
            value[flat] = 0 if inputs.normal is None else inputs.normal[flat]
        elif name != "tangent":
            np.clip(value, 0, top, out=value)
        out[name] = value[:, 0] if components == 1 else value
    return out


def triangle_tangents(position: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent (T, 3) along growing u and bitangent sign (T,) of triangles, float32.

    `position` is (T, 3, 3), `uv` (T, 3, 2). From dP = T du + B dv on both edges (Lengyel 2001). Where the
    UVs are degenerate the tangent is the first edge. The sign is that of the UV triangle's area.
    """
    edge = (position[:, 1:] - position[:, :1]).astype(np.float64)
    duv = (uv[:, 1:] - uv[:, :1]).astype(np.float64)
    area = duv[:, 0, 0] * duv[:, 1, 1] - duv[:, 0, 1] * duv[:, 1, 0]
    tangent = edge[:, 0] * duv[:, 1, 1:] - edge[:, 1] * duv[:, 0, 1:]
    tangent = np.where(area[:, None] == 0, edge[:, 0], tangent * np.sign(area)[:, None])
    return normalize_rows(tangent).astype(np.float32), np.where(area < 0, -1, 1).astype(np.float32)
