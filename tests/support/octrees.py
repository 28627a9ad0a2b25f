"""Points sorted into an octree as Entwine does: each node keeps some of its points and hands the others down."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.support.scan_files import write_ept

SIDE = 20_000  # hundredths, of the root's cube, whose low corner is 0
OFFSET = 10_000  # of the records that `write_ept` writes


def octree_nodes(position: np.ndarray, most: int) -> dict[str, np.ndarray]:
    """Nodes of at most `most` points, by name, of whole-numbered positions (N, 3) in [0, SIDE)."""
    random = np.random.default_rng(len(position))
    found: dict[str, np.ndarray] = {}
    waiting = [((0, 0, 0, 0), position)]
    while waiting:
        (level, *place), points = waiting.pop()
        points = points[random.permutation(len(points))]
        found["-".join(map(str, (level, *place)))], points = points[:most], points[most:]
        octant = points * 2 ** (level + 1) // SIDE
        for child in np.unique(octant, axis=0) if len(points) else ():
            waiting.append(((level + 1, *child.tolist()), points[(octant == child).all(axis=1)]))
    return found


def write_octree(folder: Path, position: np.ndarray, most: int, kind: str = "binary") -> dict[str, np.ndarray]:
    """Writes positions (N, 3), hundredths in [0, SIDE), as an Entwine folder; returns its nodes."""
    nodes = octree_nodes(position, most)
    shift = OFFSET if kind != "laszip" else 0  # the tiles of LAZ have no offset
    write_ept(folder, {name: points - shift for name, points in nodes.items()}, kind)
    return nodes
