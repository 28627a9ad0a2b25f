"""Captured splats from far away, drawn by nodes, against the published formula of all of them in float64."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from tests.reference import captured as reference

COUNT = 40_000


def sphere(antialiased=False):
    """Disks of all sizes on the unit sphere, as training leaves them: neighbours have like colours."""
    rng = np.random.default_rng(4)
    normal = rng.normal(size=(COUNT, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # The shortest axis along the normal: half-way between z and it lies the axis of a half turn.
    half = normal + (0, 0, 1.0001)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    rotation = np.column_stack([np.zeros(COUNT), half])
    scale = 0.006 * np.exp(rng.normal(0, 0.5, (COUNT, 3))) * (1, 1, 0.1)
    base = 0.8 * np.sin(5 * normal) + rng.normal(0, 0.2, (COUNT, 3))
    sh = rng.normal(0, 0.05, (COUNT, 3, 3))
    arrays = (normal, scale, rotation, base, rng.uniform(0.2, 1, COUNT), sh)
    return CapturedSplats(*(array.astype(np.float32) for array in arrays), antialiased=antialiased)


def drawn(renderer, thing, eye, samples=1, others=(), **more):
    """Combined (H, W, 4) float64, and how many splats and nodes were drawn."""
    made = build.scene((thing, moved()), *others, lights=(), world=World(), transparent=True, **more)
    request = Request(eye, Settings(use_shadows=False), frozenset({"combined"}), samples)
    result = renderer.render(made, request)
    return result.pixels["combined"].astype(np.float64), result.report["points"]["cut"]


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(("side", "share", "decibels"), [(20, 0.4, 45), (10, 0.12, 35)])
def test_nodes_show_what_the_formula_shows_of_all_splats(side, share, decibels, antialiased):
    """The first view draws all, the second one nodes."""
    splats, renderer = sphere(antialiased), drawing.opengl()
    eye = camera((0, -3, 0.4), resolution=(side, side), field_of_view=45)
    thing = captured(f"far sphere {antialiased} {side}", splats)
    expected = reference.picture([(splats, moved())], eye)
    every, count = drawn(renderer, thing, eye)
    assert count == COUNT
    assert reference.psnr(every, expected) > 70
    found, count = drawn(renderer, thing, eye)
    assert count < share * COUNT
    print(side, antialiased, count / COUNT, reference.psnr(found, expected), np.abs(found - expected).max())
    assert reference.psnr(found, expected) > decibels
