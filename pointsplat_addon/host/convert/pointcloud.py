"""An evaluated PointCloud object to splats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...core.cloud import PointCloud
from ...core.materials import MaterialGraph, Needs, SampleInputs, evaluate_samples, needs
from . import arrays
from .mesh import COLOR_TYPES, as_color

DEFAULT_RADIUS = 0.01  # Blender's, for points without a radius attribute
COLOR_NAMES = ("Color", "Col")  # what importers call it
Lookup = Callable[[str, Callable[[], PointCloud]], PointCloud]


@dataclass(frozen=True, eq=False)
class CloudMaterial:
    """What a cloud must know of its material."""

    row: int  # of the scene's table; 0 is no material, and then the colour attribute of importers gives the colour
    graph: MaterialGraph | None = None
    roughness: float = 0.5  # the constants, for when only the other one varies
    metallic: float = 0.0


def read_pointcloud(
    data: bpy.types.PointCloud, material: CloudMaterial, lookup: Lookup
) -> tuple[str, PointCloud] | None:
    """(content key, cloud) of a point cloud in object space, or None where it is empty."""
    if "position" not in data.attributes or len(data.points) == 0:
        return None
    count, graph = len(data.points), material.graph
    wanted = needs(graph) if graph else Needs()
    position = arrays.read(data.attributes["position"].data, "vector", 3, np.float32)
    radius = _read(data.attributes.get("radius"), "FLOAT")
    if radius is None:
        radius = np.full(count, DEFAULT_RADIUS, np.float32)
    normal = _read(data.attributes.get("normal"), "FLOAT_VECTOR")
    found = {a.name: a for a in _color_attributes(data, wanted, imported=material.row == 0)}
    colors = {name: as_color(attribute) for name, attribute in found.items()}
    named = {name: _read(data.attributes.get(name), "FLOAT2") for name in wanted.uv if name is not None}
    uv = {name: array for name, array in named.items() if array is not None}

    def build() -> PointCloud:
        linear = {name: arrays.scene_linear(array) for name, array in colors.items()}
        varying = {}
        if graph is not None:
            varying = _evaluate(graph, wanted, SampleInputs(uv, colors=linear, position=position, normal=normal))
        elif linear:
            varying = {"base_color": next(iter(linear.values()))[:, :3]}
        facing = varying.get("normal", normal)
        return PointCloud(
            position=position,
            normal=None if facing is None or normal is None else _unit(facing),
            radii=radius[:, None],
            color=_contiguous(varying.get("base_color")),
            opacity=_contiguous(varying.get("alpha")),
            surface=_surface(varying, material, count),
            emission=_contiguous(varying.get("emission")),
            material=np.full(count, material.row, np.uint16) if material.row else None,
        )

    parts = [position, radius, normal, material.row, material.roughness, material.metallic, graph and graph.digest]
    for name, array in (*colors.items(), *uv.items()):
        parts += [name, array]
    key = arrays.digest("pointcloud", *parts)
    return key, lookup(key, build)


def _read(attribute: Any, kind: str) -> np.ndarray | None:
    """A point attribute, or None where there is none of that name and type."""
    if attribute is None or attribute.data_type != kind:
        return None
    name, width = {"FLOAT": ("value", 1), "FLOAT2": ("vector", 2), "FLOAT_VECTOR": ("vector", 3)}[kind]
    return arrays.read(attribute.data, name, width, np.float32)


def _color_attributes(data: bpy.types.PointCloud, wanted: Needs, imported: bool) -> list[Any]:
    """Attributes that give colours: those that the material reads, or the one that importers make."""
    colors = [a for a in data.attributes if a.data_type in COLOR_TYPES]
    colors.sort(key=lambda a: COLOR_NAMES.index(a.name) if a.name in COLOR_NAMES else len(COLOR_NAMES))
    if imported:
        return colors[:1]
    readable = (*COLOR_TYPES, "FLOAT", "FLOAT_VECTOR")
    named = (data.attributes.get(name) for name in sorted(n for n in wanted.colors if n is not None))
    found = [a for a in named if a is not None and a.data_type in readable]
    # The first one is what a node without a name reads.
    return [*colors[:1], *found] if None in wanted.colors else found


def _evaluate(graph: MaterialGraph, wanted: Needs, inputs: SampleInputs) -> dict[str, np.ndarray]:
    position = inputs.position
    assert position is not None
    generated = None
    if wanted.generated:
        low, high = position.min(axis=0), position.max(axis=0)
        generated = (position - low) / np.where(high > low, high - low, 1)
    return evaluate_samples(
        graph,
        SampleInputs(inputs.uv, next(iter(inputs.uv), None), inputs.colors, None, position, generated, inputs.normal),
    )


def _surface(varying: dict[str, np.ndarray], material: CloudMaterial, count: int) -> np.ndarray | None:
    if "roughness" not in varying and "metallic" not in varying:
        return None
    surface = np.empty((count, 2), np.float32)
    surface[:, 0] = varying.get("roughness", material.roughness)
    surface[:, 1] = varying.get("metallic", material.metallic)
    return surface


def _contiguous(array: np.ndarray | None) -> np.ndarray | None:
    return None if array is None else np.ascontiguousarray(array, np.float32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised rows; a zero vector becomes +Z."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), [0, 0, 1]).astype(np.float32)
