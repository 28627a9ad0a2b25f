"""Chooses which translucent meshes are drawn as layers of triangles, and not as splats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..separation import is_translucent
from ..view import View

MOST_TRIANGLES = 1 << 20  # of all panes: each layer draws all of them


def pane_rows(view: View, of_each: Sequence[np.ndarray]) -> frozenset[int]:
    """Returns the rows of geometries whose instances in the picture are panes: all translucent meshes or none.

    They are where the visibility buffer draws, and they are few. of_each: instances of each geometry.
    """
    scene = view.scene
    if view.settings.technique != "VISIBILITY" or view.blur is not None:
        return frozenset()
    rows = [row for row, where in enumerate(of_each) if len(where)]
    geometries = {row: scene.geometries[row] for row in rows}
    if any(g.captured is not None for g in geometries.values()):
        return frozenset()
    found = [row for row, geometry in geometries.items() if is_translucent(geometry, scene.materials)]
    triangles, instances = 0, scene.instances
    for row in found:
        for special in (instances.holdout, instances.matte):
            if special is not None and special[of_each[row]].any():
                return frozenset()
        if (mesh := geometries[row].mesh) is not None:
            triangles += len(mesh.triangles) * len(of_each[row])
    return frozenset(row for row in found if geometries[row].mesh is not None and triangles <= MOST_TRIANGLES)
