"""Evaluates materials at samples of meshes, points and strands."""

from __future__ import annotations

import numpy as np

from .expression import SampleInputs, evaluate
from .graph import MaterialGraph
from .nodes.math_functions import normalize_rows

CHANNELS: dict[str, tuple[int, float | None]] = {
    # channel: (components, largest value); all but normals start at 0
    "base_color": (3, None),
    "roughness": (1, 1.0),
    "metallic": (1, 1.0),
    "alpha": (1, 1.0),
    "emission": (3, None),
    "normal": (3, None),
}


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
            value = normalize_rows(value)
            flat = ~value.any(axis=1)
            value[flat] = 0 if inputs.normal is None else inputs.normal[flat]
        else:
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
