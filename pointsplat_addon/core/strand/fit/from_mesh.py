"""Ribbons and tubes fitted to meshes of leaves and branches (Marroquim et al. 2008, section 5).

A part is a connected component of the mesh. A tube is a part made of rings of vertices, open, closed or with a tip at
its ends, or any sleeve between two open rims whose sections are round enough. A ribbon is one of two to four triangles
in a row, or a flat one of some more, by its widths across its longest axis. Flat parts with lobes about a hub are
several ribbons. Parts that fit none of these stay polygons."""

from __future__ import annotations

import numpy as np

from ...numeric.segments import offsets
from .blades import fit_blades
from .flat import find_flat_parts
from .graph import connected_parts
from .lobes import fit_lobes
from .result import FittedStrands, concatenate_strands
from .ribbons import fit_ribbons
from .rings import cap_triangles, fit_ring_tubes
from .sleeves import fit_sleeves


def fit_strands(position: np.ndarray, triangles: np.ndarray) -> FittedStrands:
    """Fits tubes and ribbons to the connected parts of a mesh with vertices (V, 3) and triangles (T, 3)."""
    position, triangles = np.asarray(position, np.float64), np.asarray(triangles, np.int64)
    label = connected_parts(triangles, len(position))
    names, part = np.unique(label[triangles[:, 0]], return_inverse=True)
    open_ = ~cap_triangles(position, triangles, part, len(names))
    tubes = fit_ring_tubes(position, triangles[open_], label, names, part[open_])
    other = np.ones(len(names), bool)
    other[tubes.part] = False
    sleeves = fit_sleeves(position, triangles, label, names, part, other)
    ribbons = fit_ribbons(position, triangles, part, len(names))
    other[np.concatenate([sleeves.part, ribbons.part])] = False
    flat = find_flat_parts(position, triangles, part, other)
    lobes = fit_lobes(flat)
    blades = fit_blades(flat, lobes.part)
    fits = [tubes, sleeves, ribbons, lobes, blades]
    found = concatenate_strands(fits)
    first = np.full(len(names), len(triangles))
    np.minimum.at(first, part, np.arange(len(triangles)))
    remaining = np.ones(len(names), bool)
    remaining[found.part] = False
    return FittedStrands(
        found.position,
        found.radius,
        found.normal,
        offsets(found.count.astype(np.int64)),
        np.repeat([False, False, True, True, True], [len(fit) for fit in fits]),
        first[found.part],
        remaining[part],
        len(names),
        int(remaining.sum()),
    )
