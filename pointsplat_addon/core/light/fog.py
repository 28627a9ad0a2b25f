"""Fog that fills the world: what it leaves of light from infinitely far, and its texels for shaders/lib/fog/fog.glsl.

The same everywhere, it lets nothing through from infinitely far, as in Cycles: neither suns nor the world shine in it,
and pictures have no open pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..scene.scene import Scene
from ..scene.world import Fog

MOST_SPREAD = 0.99  # of |g|, as of other media
TEXELS = 3


def without_far_light(scene: Scene) -> Scene:
    """Returns a scene whose suns and world have what the fog of its world leaves of them, which is no light in
    channels that it absorbs or scatters. In the others cameras see the world that lights."""
    fog = scene.world.fog
    if fog is None:
        return scene
    clear = np.asarray(fog.extinction) <= 0
    lights = [replace(x, color=x.color * clear) if x.kind == "SUN" else x for x in scene.lights]
    image, mirrored = (
        None if picture is None or not clear.any() else picture * clear.astype(np.float32)
        for picture in (scene.world.image, scene.world.mirrored)
    )
    world = replace(
        scene.world,
        color=scene.world.color * clear,
        image=image,
        mirrored=mirrored,
        seen=None,
    )
    return replace(
        scene,
        lights=tuple(x for x in lights if x.kind != "SUN" or np.any(x.color)),
        world=world,
    )


def fog_texels(fog: Fog, near: float) -> np.ndarray:
    """Returns (TEXELS, 4) float32: the layout is that of shaders/lib/fog/fog.glsl. near: distance from the eye at
    which the fog begins."""
    texels = np.zeros((TEXELS, 4), np.float32)
    texels[0] = *fog.extinction, near
    texels[1] = *fog.scattering, np.clip(fog.anisotropy, -MOST_SPREAD, MOST_SPREAD)
    texels[2, :3] = fog.emission
    return texels
