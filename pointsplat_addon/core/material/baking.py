"""Bakes materials into textures over the unit square of a UV map, where that loses nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .evaluation import evaluate_samples
from .expression import Expression, SampleInputs, evaluate, walk
from .graph import MaterialGraph, needs
from .nodes.input_nodes import UV, Constant, Coordinates
from .nodes.math_nodes import Mapping
from .nodes.normal_nodes import NormalMap
from .nodes.texture_nodes import ImageTexture

MAX_RESOLUTION = 4096  # texels along a side of a baked texture
PROCEDURAL_RESOLUTION = 1024  # where no image determines the resolution


def bake(graph: MaterialGraph, resolution: tuple[int, int]) -> dict[str, np.ndarray]:
    """Each varying channel at the texel centres of the unit square of its UV map, (H, W, C) float32.

    `resolution` is (width, height); row 0 has the smallest v. Normals are in tangent space (z outward).
    Meaningful for graphs that are `bakeable`.
    """
    width, height = resolution
    uv = np.empty((height, width, 2), np.float32)
    uv[..., 0] = (np.arange(width) + 0.5) / width
    uv[..., 1] = ((np.arange(height) + 0.5) / height)[:, None]
    uv = uv.reshape(-1, 2)
    axes = np.eye(3, dtype=np.float32)
    inputs = SampleInputs(
        uv={name or "": uv for name in needs(graph).uv},
        active_uv="",
        normal=np.broadcast_to(axes[2], (len(uv), 3)),
        tangent=np.broadcast_to(axes[0], (len(uv), 3)),
        grid=resolution,
    )
    return {name: a.reshape(height, width, -1) for name, a in evaluate_samples(graph, inputs).items()}


def bakeable(graph: MaterialGraph, unit_square: bool = False, active_uv: str | None = None) -> bool:
    """Whether `bake`, drawn with a repeating texture, shows the same as evaluating the graph at every sample.

    The graph must read exactly one UV map and nothing else, and have period 1 along u and v, so that its
    images repeat a whole number of times. unit_square: no UV of the mesh leaves [0, 1]; then any function of the map
    will do.
    """
    wanted = needs(graph)
    nodes = list(walk(*graph.channels.values()))
    object_normals = any(isinstance(n, NormalMap) and n.uv is None for n in nodes)
    maps = {active_uv if name is None else name for name in wanted.uv}
    if len(maps) != 1 or wanted.colors or wanted.position or wanted.generated or object_normals:
        return False
    if any(isinstance(n, Coordinates) for n in nodes):
        return False
    return unit_square or all(_periodic(output) for output in graph.channels.values())


def _periodic(node: Expression) -> bool:
    """Whether the value repeats with period 1 in u and v: every path to the UV map passes a repeating image."""
    if isinstance(node, UV):
        return False
    if isinstance(node, NormalMap):
        return _periodic(node.strength) and _periodic(node.color)  # its UV only names the tangent
    if isinstance(node, ImageTexture):
        matrix = _texture_from_uv(node.uv)
        if matrix is None:
            return _periodic(node.uv)
        # A mirrored image has period 2
        period = {"REPEAT": 1, "MIRROR": 2}.get(node.extension)
        return period is not None and bool(np.all(np.abs(matrix / period - np.round(matrix / period)) < 1e-4))
    return all(_periodic(a) for a in node.arguments)


def _texture_from_uv(node: Expression) -> np.ndarray | None:
    """The linear part (2, 2) of the chain of constant mappings that leads from the UV map to `node`, else None."""
    if isinstance(node, UV):
        return np.eye(2)
    if not isinstance(node, Mapping) or any(a.varies for a in node.arguments[1:]):
        return None
    inner = _texture_from_uv(node.vector)
    if inner is None or node.kind == "NORMAL":
        return None
    moved = [replace(node, vector=Constant(p)) for p in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    origin, *axes = [evaluate(m, SampleInputs(count=1))[0, :2].astype(float) for m in moved]
    return np.stack([axis - origin for axis in axes], axis=1) @ inner


def suggested_resolution(graph: MaterialGraph, largest: int = MAX_RESOLUTION) -> tuple[int, int]:
    """(width, height) at which `bake` keeps every texel of the graph's images, sides at most `largest`."""
    width = height = 0.0
    for node in walk(*graph.channels.values()):
        if isinstance(node, ImageTexture):
            rows, columns = node.image.texels.shape[:2]
            matrix = _texture_from_uv(node.uv)
            scale = np.eye(2) if matrix is None else np.abs(matrix)
            # Texels along u: those that one step of u crosses, on either axis of the image
            along = np.maximum(scale[0] * columns, scale[1] * rows)
            width, height = max(width, along[0]), max(height, along[1])
    if not width or not height:
        width = height = PROCEDURAL_RESOLUTION
    return min(max(1, math.ceil(width - 1e-3)), largest), min(max(1, math.ceil(height - 1e-3)), largest)
