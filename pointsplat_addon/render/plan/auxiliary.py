"""Makes the auxiliary picture, without depth of field, for passes that cannot be out of focus."""

from __future__ import annotations

from dataclasses import replace

from ...core.scene.scene import Scene
from ...core.scene.world import World
from ..passes.outputs import CRYPTO
from ..passes.shading.averages import averaged
from ..passes.shading.data import data
from .request import Request


def auxiliary_picture(
    scene: Scene, request: Request, presented: bool, at_once: int = 1
) -> tuple[Scene, Request] | None:
    """Returns the unlit scene and the request of the passes but Combined, by a camera without a lens.

    Returns None if no such pass is asked for. `presented`: the picture is shown in a viewport, which needs its depth to
    hide what Blender draws. `at_once`: samples that are drawn together, among them that of the pixels' centres.
    """
    others = request.passes - {"combined"}
    sampled = averaged(others) or others & set(CRYPTO)
    if not (presented or sampled or data(others)):
        return None
    settings = replace(request.settings, use_shadows=False, use_adaptive_sampling=False)
    camera = replace(request.camera, aperture=None)
    unlit = replace(scene, lights=(), world=World(), transparent=True)
    samples = request.samples if sampled else min(request.samples, at_once)
    return unlit, replace(request, camera=camera, settings=settings, passes=others, samples=samples)
