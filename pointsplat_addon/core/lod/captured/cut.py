"""The cut through nodes over captured splats that a view draws."""

from __future__ import annotations

import numpy as np

from ...numeric.linear import largest_singular_value
from ...numeric.record import record
from ...numeric.segments import ranges
from ...scene.camera import Camera
from .tree import CapturedTree

EDGE = 0.5  # of the tolerance: the projected edge of the largest cells that are drawn as nodes


@record
class CapturedCut:
    """What one instance draws."""

    nodes: np.ndarray  # (K,) int64, rising
    splats: np.ndarray  # (S,) int64, rising: rows of the splats that no node stands for

    def __len__(self) -> int:
        return len(self.nodes) + len(self.splats)


def cut_captured(tree: CapturedTree, view_from_splats: np.ndarray, camera: Camera, tolerance: float) -> CapturedCut:
    """The nodes whose cells' edges project to at most EDGE times `tolerance` pixels, and the splats outside of them.

    view_from_splats: (4, 4) float64 that holds the splats' origin. What is beside the picture is in the cut, too.
    """
    fx, fy, _, _ = camera.pixel_from_view()
    scale = float(largest_singular_value(view_from_splats[None, :3, :3])[0]) * max(abs(fx), abs(fy))
    nodes, splats = [], [tree.always]
    cell = np.arange(tree.start[1] - tree.start[0])
    toward = view_from_splats[2, :3].astype(np.float32)
    for level, edge in enumerate(tree.edge.tolist()):
        row = tree.start[level] + cell
        width = scale * edge
        if camera.perspective:
            depth = -(tree.nodes.position[row] @ toward + np.float32(view_from_splats[2, 3]))
            drawn = width <= EDGE * tolerance * np.maximum(depth, camera.near)
        else:
            drawn = np.full(len(cell), width <= EDGE * tolerance)
        nodes.append(row[drawn])
        cell = cell[~drawn]
        if len(cell) == 0:
            break
        first = tree.first_own[level]
        splats.append(tree.own[level][ranges(first[cell].astype(np.int64), first[cell + 1] - first[cell])])
        if level < len(tree.first_child):
            first = tree.first_child[level]
            cell = ranges(first[cell].astype(np.int64), first[cell + 1] - first[cell])
    return CapturedCut(np.sort(np.concatenate(nodes)), np.sort(np.concatenate(splats)).astype(np.int64))
