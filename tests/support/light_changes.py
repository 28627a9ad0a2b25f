"""Scenes that are changed in what their light depends on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.scene import Scene

CHANGES = "lights", "world", "materials", "place", "visibility"


def changed(scene: Scene, change: str) -> Scene:
    """Returns a scene after one of CHANGES. It has a light and at least three instances."""
    instances = scene.instances
    if change == "lights":
        return replace(scene, lights=(replace(scene.lights[0], color=scene.lights[0].color * 2),))
    if change == "world":
        return replace(scene, world=replace(scene.world, color=np.array([0.1, 0.2, 0.3])))
    if change == "materials":
        return replace(scene, materials=replace(scene.materials, base_color=0.5 * scene.materials.base_color))
    if change == "visibility":
        return replace(scene, instances=replace(instances, scatters=np.arange(len(instances)) != 2))
    assert change == "place"
    matrices = instances.world_from_object.copy()
    matrices[2, 0, 3] += 0.1
    return replace(scene, instances=replace(instances, world_from_object=matrices))
