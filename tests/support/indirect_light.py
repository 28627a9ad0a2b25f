"""The indirect light of scenes in tests, gathered at any places."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.indirect.bake import Baker
from pointsplat_addon.render.indirect.known_sites import Slices
from pointsplat_addon.render.indirect.light import IndirectLight, world_names
from pointsplat_addon.render.indirect.surfels import scene_density, scene_surfels
from scripts.scenes import drawing


class SceneLight:
    """What shines in a scene and the even world around it, without bounces."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        device, store = drawing.opengl().device, Store()
        density, self.origin = scene_density(scene, camera, store)
        self.surfels = scene_surfels(scene, density, self.origin, store, lambda: None)
        names = ("PS_HAS_WORLD",) if np.any(scene.world.color > 0) else ()
        baked = Baker(scene, self.surfels, names, 0).bake(device, {}, Slices(), lambda: None)
        self._light = IndirectLight(device, baked, scene.world, world_names(names))

    def at(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 3): irradiance over pi at places (N, 3), in world space, with normals (N, 3) or one for all."""
        normal = np.broadcast_to(normal, position.shape).astype(float)
        return self._light.gathered(position - self.origin, normal, {})[:, :3].astype(float)

    def release(self) -> None:
        self._light.release()
