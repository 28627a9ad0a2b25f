"""Normals of points from their neighbours: planes through the nearest ones (core/surface/neighbourhoods)."""

from __future__ import annotations

import numpy as np

from ....core.numeric.vectors import each_block, take_rows
from ....core.surface.neighbourhoods.ellipses import FITTING
from ....core.surface.neighbourhoods.estimate import LEAST_FITTING, LINE, neighbours_of
from ....core.surface.neighbourhoods.nearest import make_orders
from ....core.surface.neighbourhoods.planes import fit_planes

NEIGHBOURS, WINDOW = 16, 8  # fewer than shapes of surfaces take, for half the time
BLOCK = 1 << 12  # points at once: their candidates stay in the processor's cache
THICK = 0.5  # of `Planes.thickness`, from which on neighbours lie on no plane
MARGIN = 6.0  # distances between points within which neighbours are looked for beyond a chunk's border


def normals_of(position: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) float32 of points (N, 3) float32, turned upwards; zeros where neighbours lie on no plane."""
    orders = make_orders(position)
    normal = np.zeros((len(orders), 3), np.float32)

    def fit(block: slice) -> None:
        planes = fit_planes(*neighbours_of(orders, block, NEIGHBOURS, WINDOW))
        few = (planes.weight > FITTING).sum(axis=0) < LEAST_FITTING
        lone = few | (planes.breadth < LINE) | (planes.thickness > THICK)
        found = np.where(planes.normal[2] < 0, -planes.normal, planes.normal)
        found[:, lone] = 0
        normal[block] = found.T

    if len(orders) > 1:
        each_block(len(orders), fit, BLOCK)
    found = take_rows(normal, np.maximum(orders.place, 0)) if len(orders) else np.zeros((len(position), 3), np.float32)
    found[orders.place < 0] = 0
    return found
