"""Makes passes of light as Cycles composes them:

Combined = (DiffDir + DiffInd) DiffCol + (GlossDir + GlossInd) GlossCol + (TransDir + TransInd) TransCol
           + VolumeDir + VolumeInd + Emit + Env

Each is made of pictures of terms of the light (passes/shading/terms.py), which are drawn as Combined is, with the same
samples, so that the sum is exact. Direct is what has come from a lamp, an emitter or the world without a bounce
between; Indirect is the rest. Where the film is transparent, Combined has no Env, which is the world all the same, as
in Cycles. Ambient Occlusion is a picture of its own: of the light that a white world would give to each surface.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from functools import cache

import numpy as np

from ..core.numeric.record import value_record
from ..core.scene.scene import Scene
from .passes.shading.terms import DIFFUSE, EMISSION, ENVIRONMENT, GLOSSY, OCCLUSION, TRANSMISSION, VOLUME, Term
from .plan.plan import Plan

Draw = Callable[[Term, bool], np.ndarray]  # a term, and whether without light that has bounced: (H, W, 3) float32
LEAST_COLOR = 2.5e-7  # below it there is only what rounding leaves of colours up to 1
OF_SURFACES = {"diffuse": DIFFUSE, "glossy": GLOSSY, "transmission": TRANSMISSION}


@value_record
class Light:
    """What kinds of light a picture has: what is not there is not drawn."""

    bounces: bool  # surfaces and media send each other light
    transmits: bool  # something is seen through glass
    media: bool  # something fills a volume
    emits: bool  # something that is drawn emits light
    trained: bool  # captured splats are blended in display values, so that what they show is no sum

    @classmethod
    def of(cls, plan: Plan, scene: Scene, bounces: int) -> Light:
        """The light of a scene's plan, which bounces so many times where it does."""
        translucent = plan.translucent
        media = scene.world.fog is not None or (translucent is not None and translucent.media)
        trained = translucent is not None and translucent.trained
        transmits = plan.panes and scene.materials.glass is not None
        glows = plan.variant.emission or "PS_HAS_GLOW" in plan.materials or scene.world.fog is not None
        emits = glows or (translucent is not None and (translucent.emission or translucent.captured))
        return cls((plan.indirect or plan.gathers_media) and bounces > 0, transmits, media, emits, trained)


def light_passes(
    asked: Set[str],
    light: Light,
    combined: np.ndarray,
    transparent: bool,
    draw: Draw,
    within: float = np.inf,
) -> dict[str, np.ndarray]:
    """Returns the passes of light that are asked for, (H, W, 3) float32 by key.

    combined: (H, W, 3 or more) float32. `transparent`: the film is. `draw` draws a term; each is drawn once. `within`:
    how far away what occludes ambient light may be.
    """
    zeros = np.zeros((*combined.shape[:2], 3), np.float32)

    @cache
    def term(name: str, direct: bool = False, color: bool = False, through: bool = False) -> np.ndarray:
        if name == EMISSION and not light.emits:
            return zeros
        return draw(Term(name, color, through or not light.transmits), direct)

    def parts(name: str) -> tuple[np.ndarray, np.ndarray]:
        """Direct and indirect radiance by way of surfaces that are seen."""
        whole = term(name)
        direct = term(name, direct=True) if light.bounces else whole
        return direct, whole - direct if light.bounces else zeros

    def transmitted() -> tuple[np.ndarray, np.ndarray]:
        """The same of what is seen through glass: all that is seen, less what is seen past it."""
        if not light.transmits:
            return zeros, zeros
        names = (EMISSION,) if transparent else (EMISSION, ENVIRONMENT)
        shown = sum((term(name, through=True) - term(name) for name in names), zeros)
        rest = combined[..., :3] - sum((term(name, through=True) for name in names), zeros)
        own = sum((term(name) for name in (DIFFUSE, GLOSSY, *((VOLUME,) if light.media else ()))), zeros)
        return shown, rest - own

    def color(name: str) -> np.ndarray:
        if name == TRANSMISSION and not light.transmits:
            return zeros
        found = term(name, color=True)
        return np.where(found > LEAST_COLOR, found, np.float32(0))

    found: dict[str, np.ndarray] = {}
    for stem, name in OF_SURFACES.items():
        if f"{stem}_color" in asked:
            found[f"{stem}_color"] = color(name)
        if {f"{stem}_direct", f"{stem}_indirect"} & asked:
            both = transmitted() if name == TRANSMISSION else parts(name)
            found |= {f"{stem}_direct": _over(both[0], color(name)), f"{stem}_indirect": _over(both[1], color(name))}
    if {"volume_direct", "volume_indirect"} & asked:
        direct, indirect = parts(VOLUME) if light.media else (zeros, zeros)
        found |= {"volume_direct": direct, "volume_indirect": indirect}
    if "environment" in asked:
        found["environment"] = term(ENVIRONMENT)
    if "ambient_occlusion" in asked:
        found["ambient_occlusion"] = draw(Term(OCCLUSION, through=not light.transmits, within=within), True)
    if "emission" in asked:
        found["emission"] = combined[..., :3] - term(ENVIRONMENT) if light.trained else term(EMISSION)
    return {key: np.array(picture) for key, picture in found.items() if key in asked}


def _over(light: np.ndarray, color: np.ndarray) -> np.ndarray:
    """The light over the colour, 0 where that is: Cycles' safe_divide."""
    return np.divide(light, color, out=np.zeros_like(light), where=color > 0)
