"""Tubes from parts with two open rims, cut into sections between the rims."""

from __future__ import annotations

import numpy as np

from ...numeric.segments import offsets, owners, ranges
from .graph import connected_by_edges, edge_steps, mesh_edges, path_lengths
from .result import NUDGE, PartStrands, no_strands
from .tubes import tubes_from_sections

THICK_RADIUS = 1 / 1000  # of the mesh's longest side: sleeves of greater radii are tubes only where they are round


def fit_sleeves(
    position: np.ndarray,
    triangles: np.ndarray,
    label: np.ndarray,
    names: np.ndarray,
    part: np.ndarray,
    other: np.ndarray,
) -> PartStrands:
    """Tubes from parts with two rims that are not yet fitted (`other` (C,) bool), cut at equal fractions of the path
    from one rim to the other."""
    count = len(names)
    owner = np.minimum(np.searchsorted(names, label), count - 1)
    used = np.zeros(len(position), bool)
    used[triangles] = True
    edges, number, _ = mesh_edges(triangles)
    rim = edges[number == 1]
    loop = connected_by_edges(rim, len(position))
    on_rim = np.zeros(len(position), bool)
    on_rim[rim] = True
    loops = np.unique(loop[on_rim])
    # A sphere with two holes has the Euler characteristic 0
    euler = np.bincount(owner[used], minlength=count) - np.bincount(owner[edges[:, 0]], minlength=count)
    euler += np.bincount(part, minlength=count)
    fits = other & (euler == 0) & (np.bincount(owner[loops], minlength=count) == 2)
    fits &= np.bincount(owner[edges[number > 2, 0]], minlength=count) == 0
    if not fits.any():
        return no_strands()
    begin = np.full(count, len(position))
    np.minimum.at(begin, owner[loops], loops)
    here = on_rim & fits[owner]
    near, far = (path_lengths(position, edges, here & ((loop == begin[owner]) == one)) for one in (True, False))
    whole = near + far
    share = np.where(fits[owner] & used & (whole > 0), near / np.where(whole > 0, whole, 1), 0.0)
    level = edge_steps(edges, here & (loop == begin[owner]))
    sections = np.zeros(count, np.int64)
    np.maximum.at(sections, owner[used], level[used])

    # Each triangle is cut by the sections between its least and its greatest share
    rows = np.flatnonzero(fits[part])
    value, whole = share[triangles[rows]], sections[part[rows]]
    low = np.ceil(value.min(axis=1) * whole - 0.5 - NUDGE).astype(np.int64)
    high = np.floor(value.max(axis=1) * whole - 0.5 - NUDGE).astype(np.int64)
    cuts = np.maximum(high - low + 1, 0)
    which, cut = owners(cuts), ranges(low, cuts)
    above = value[which] - ((cut + 0.5 + NUDGE) / whole[which])[:, None]
    corner = position[triangles[rows[which]]]
    ahead = np.roll(above, -1, axis=1)
    crossed = (above < 0) != (ahead < 0)
    t = above / np.where(crossed, above - ahead, 1)
    point = corner + t[..., None] * (np.roll(corner, -1, axis=1) - corner)
    ends = np.take_along_axis(point, np.argsort(~crossed, axis=1, kind="stable")[:, :2, None], axis=1)

    # The rims are the first and the last section
    start = offsets(np.where(fits, sections + 2, 0))
    own = rim[fits[owner[rim[:, 0]]]]
    last = loop[own[:, 0]] != begin[owner[own[:, 0]]]
    at = np.where(last, start[owner[own[:, 0]] + 1] - 1, start[owner[own[:, 0]]])
    section = np.concatenate([start[part[rows[which]]] + 1 + cut, at])
    ends = np.concatenate([ends, position[own]])
    none = np.zeros(0, np.int64)
    thick = THICK_RADIUS * np.ptp(position, axis=0).max()
    return tubes_from_sections(position, triangles, part, start, ends, section, fits, np.zeros((0, 3)), none, thick)
