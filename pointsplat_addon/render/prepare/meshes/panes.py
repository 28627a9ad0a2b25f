"""Chooses which translucent meshes are drawn as layers of triangles, and not as splats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....core.scene.scene import Geometry
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
    if any(g.captured is not None for g in geometries.values()) and not _among_captured(view, geometries, of_each):
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


def _among_captured(view: View, geometries: dict[int, Geometry], of_each: Sequence[np.ndarray]) -> bool:
    """Whether panes can be drawn among captured splats: not with shadow catchers, where these cut holes, or where
    something else that light passes is coloured."""
    instances = view.scene.instances
    if instances.matte is not None and instances.matte.any():
        return False
    for row, geometry in geometries.items():
        if geometry.captured is not None and instances.holdout is not None and instances.holdout[of_each[row]].any():
            return False
        if geometry.cloud is not None and any(
            matter is not None and matter.ndim == 2 for matter in (geometry.cloud.extinction, geometry.cloud.opacity)
        ):
            return False
    return True
