"""Rounds spacings of samples to octaves and limits how many samples they give."""

from __future__ import annotations

import math

import numpy as np

from ..scene.mesh import Mesh
from .area_sampling import ONE_SAMPLE, most_samples
from .triangles import Measures, measure_triangles

MAX_SAMPLES = 1 << 23  # of one mesh, at a tolerance of a pixel: 0.8 GB, and 0.3 on the device
MOST_SAMPLES = 1 << 24  # of one mesh, where finer tolerances ask for more


def quantise_spacing(spacing: float) -> float:
    """The next power of two that is not coarser, so that cameras and frames share samples; inf stays inf.

    Raises ValueError where `spacing` is not positive.
    """
    if not spacing > 0:
        raise ValueError(f"spacing must be positive, not {spacing}")
    return spacing if math.isinf(spacing) else math.ldexp(0.5, math.frexp(spacing)[1])


def limit_spacing(
    mesh: Mesh,
    spacing: float,
    max_samples: int = MAX_SAMPLES,
    which: np.ndarray | None = None,
    measures: Measures | None = None,
) -> float:
    """`spacing`, or the finest octave above it at which AREA makes at most `max_samples` samples.

    Where the mesh has more triangles than that, the finest octave that gives each triangle one sample.
    """
    m = measure_triangles(mesh, which) if measures is None else measures
    if len(m.triangle) == 0 or most_samples(m, spacing) <= max_samples:
        return spacing
    one_each = m.longest / ONE_SAMPLE
    spacing = quantise_spacing(max(spacing, math.sqrt(m.area / max_samples) / 2))
    while most_samples(m, spacing) > max_samples and spacing < one_each:
        spacing *= 2
    return spacing
