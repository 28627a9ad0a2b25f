"""Draws cases with one renderer for the whole process, on an OpenGL context of its own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from pointsplat_addon.core.lod.cost import MAX_SAMPLES_RATIO, Costs
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Result
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.store import STORE

# Pictures of tests are small and of few samples: meshes are points in them where they are in large ones of many.
FREE_POINTS = replace(Costs(), prepared=1e-3, uploaded=1e-3)  # to prepare; what else they cost counts FEWER times
CHEAP_POINTS = replace(
    FREE_POINTS, point=FREE_POINTS.point / MAX_SAMPLES_RATIO, pixel=FREE_POINTS.pixel / MAX_SAMPLES_RATIO
)


@cache
def _renderer() -> Renderer:
    """One renderer for all tests of a process, since compiling shaders takes most of their time."""
    renderer = Renderer(OpenGLDevice(), STORE)
    renderer.costs = CHEAP_POINTS
    return renderer


def opengl() -> Renderer:
    """That one, with its context made current: other tests of the process may have made another."""
    renderer = _renderer()
    assert isinstance(renderer.device, OpenGLDevice)
    renderer.device.context.__enter__()
    return renderer


def render(case: Case, passes: frozenset[str] = ALL_PASSES, samples: int = 1) -> Result:
    return opengl().render(case.scene, case.request(passes, samples))
