"""What several kinds of uploads ask of instances and materials."""

from __future__ import annotations

import numpy as np

from ....core.scene.camera import Camera
from ....core.scene.scene import Scene
from ...prepare.point_sets import Layer


def origins(*layers: Layer) -> np.ndarray:
    """Returns the origins (I, 3) float64 of the clouds that instances show."""
    origin = np.zeros((len(layers[0].set_of_instance), 3))
    for layer in layers:
        for row, points in layer.point_sets.items():
            origin[layer.set_of_instance == row] = points.cloud.origin
    return origin


def constants_key(scene: Scene) -> bytes:
    """Returns the material constants, as bytes, that fill attributes which a geometry lacks."""
    table = scene.materials
    return b"".join(a.tobytes() for a in (table.base_color, table.roughness, table.metallic, table.emission))


def previous_clip_from_view(scene: Scene, camera: Camera, view_from_object: np.ndarray) -> np.ndarray:
    """Returns matrices (4 I, 4), four rows for each instance, to clip space a frame before from today's view space.

    view_from_object: (I, 4, 4) of today. Instances without an inverse move with the camera alone.
    """
    instances = scene.instances
    view = camera.view_from_world if camera.previous_view_from_world is None else camera.previous_view_from_world
    clip = camera.clip_from_view if camera.previous_clip_from_view is None else camera.previous_clip_from_view
    before = instances.world_from_object if instances.previous is None else instances.previous
    with np.errstate(all="ignore"):
        still = clip @ view @ np.linalg.inv(camera.view_from_world)
        rows = np.broadcast_to(still, (len(instances), 4, 4)).copy()
        good = np.abs(np.linalg.det(view_from_object[:, :3, :3])) > 1e-30
        good &= np.isfinite(view_from_object).all(axis=(1, 2))
        rows[good] = clip @ view @ before[good] @ np.linalg.inv(view_from_object[good])
    return np.nan_to_num(rows).reshape(-1, 4)
