"""The auxiliary picture without a lens, for passes that know no depth of field."""

from __future__ import annotations

from dataclasses import replace

from ...core.scene.scene import Scene
from ...core.scene.world import World
from ..passes.outputs import CRYPTO
from ..passes.shading.averages import averaged
from ..passes.shading.data import data
from .request import Request


def beside(scene: Scene, asked: Request, presented: bool) -> tuple[Scene, Request] | None:
    """The picture of the passes that know no blur, without light; None where none of them is asked for. `presented`:
    the picture is shown in a viewport, which hides what Blender draws by depths."""
    others = asked.passes - {"combined"}
    sampled = averaged(others) or others & set(CRYPTO)
    if not (presented or sampled or data(others)):
        return None
    settings = replace(asked.settings, use_shadows=False, use_adaptive_sampling=False)
    camera = replace(asked.camera, aperture=None)
    unlit = replace(scene, lights=(), world=World(), transparent=True)
    samples = asked.samples if sampled else 1
    return unlit, replace(asked, camera=camera, settings=settings, passes=others, samples=samples)
