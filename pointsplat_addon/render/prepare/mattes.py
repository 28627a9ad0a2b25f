"""Mattes: meshes that stand for surfaces of footage or of a capture, as Blender's shadow catchers. They hide what is
behind them, are not seen themselves, and catch shadows of what was added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.scene.scene import Scene
from .captured import casting_alone
from .prepare import Prepared


def with_mattes(scene: Scene, prepared: Prepared, technique: str) -> tuple[Prepared, bool, tuple[str, ...]]:
    """Returns a prepared view, whether some of its polygons are mattes, and warnings.

    Without the visibility buffer, and where something is out of focus, there are none.
    """
    matte = scene.instances.matte
    if matte is None or not matte[prepared.polygons].any():
        return prepared, False, ()
    if technique == "VISIBILITY" and prepared.out_of_focus is None:
        return prepared, True, ()
    without = replace(prepared, polygons=prepared.polygons[~matte[prepared.polygons]])
    return (
        without,
        False,
        ("Shadow catchers are left out: only the Visibility Buffer draws them, without depth of field",),
    )


def casting_on_mattes(scene: Scene) -> Scene:
    """Returns a scene whose shadows are those that fall on mattes: of what is no capture."""
    added = np.array([geometry.captured is None for geometry in scene.geometries], bool)
    return casting_alone(scene, added[scene.instances.geometry])
