"""What dense voxels scatter, against the closed form of a slab that is lit by a sun."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.volume import Medium, Volume
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing
from scripts.scenes.cameras import camera

STEPS, WIDE = 8, 48  # voxels through the slab, which is one thick, and along it
ALBEDO = 0.8


def slab(across: float) -> tuple[Geometry, Medium]:
    """A slab of voxels, each of an optical depth `across` its edges, and what fills it."""
    index = np.indices((WIDE, STEPS, WIDE)).reshape(3, -1).T.astype(np.int32)
    matrix = np.diag([1 / STEPS, 1 / STEPS, 1 / STEPS, 1.0])
    matrix[:3, 3] = (0.5 - WIDE / 2) / STEPS, (0.5 - STEPS / 2) / STEPS, (0.5 - WIDE / 2) / STEPS
    volume = Volume(f"dense slab {across}", "slab", index, matrix, {}, 0, share=np.ones(len(index), np.float32))
    return Geometry(volume.key, "slab", volume=volume), Medium(density=across * STEPS, color=np.full(3, ALBEDO))


def scattered(across: float, light: np.ndarray, eye_at: tuple[float, float, float]) -> tuple[float, float]:
    """What the middle of the picture shows, and the closed form. light: the direction in which the sun shines."""
    geometry, medium = slab(across)
    sun = Light("SUN", np.full(3, 2.0), np.zeros(3), light / np.linalg.norm(light))
    table = replace(build.materials(), media=(medium,))
    scene = build.scene((geometry, np.eye(4)), lights=[sun], world=World(), transparent=True, table=table)
    eye = camera(eye_at, resolution=(24, 24), parallel=0.6)
    settings = Settings(technique="VISIBILITY", adaptive_threshold=0.0, shadow_resolution=256)
    seen = drawing.opengl().render(scene, Request(eye, settings, frozenset({"combined"}), 16)).pixels["combined"]

    ahead = -np.asarray(eye_at) / np.linalg.norm(eye_at)
    to_eye, to_light = across * STEPS / abs(ahead[1]), across * STEPS / abs(sun.direction[1])
    # Both depths grow from the same side, or one grows while the other falls.
    same = ahead[1] * sun.direction[1] > 0
    rate = to_eye + to_light if same else to_eye - to_light
    share = -np.expm1(-rate) / rate if rate else 1.0
    share *= 1.0 if same else np.exp(-to_light)
    truth = ALBEDO * 2.0 / (4 * np.pi) * to_eye * share
    return float(seen[8:16, 8:16, 0].mean()), float(truth)


DEPTHS = (0.1, 0.4, 0.8, 1.2)  # across a voxel


@pytest.mark.parametrize("across", DEPTHS)
def test_a_slab_that_is_lit_from_the_eye_is_as_bright_as_its_closed_form(across):
    """The light of the voxels' middles alone left 0.2, 2.1, 7.6 and 15.7 % less."""
    seen, truth = scattered(across, np.array([0.0, 1.0, 0.0]), (0.0, -4.0, 0.01))
    assert abs(seen / truth - 1) < 0.003  # measured 0.00075, 0.00091, 0.00094, 0.0011


# By depth: the sun and the eye on one side, at angles of 33 and 19 degrees to it, and both at 45, 90 apart. The middles
# alone left 0.4, 4.8, 15.1, 27.3 and 0.9, 12.1, 31.8, 49.5 % less.
ASLANT = {0.1: (0.006, 0.012), 0.4: (0.04, 0.13), 0.8: (0.11, 0.32), 1.2: (0.18, 0.49)}


@pytest.mark.parametrize("across", DEPTHS)
def test_a_slab_that_is_lit_aslant_is_too_dark_where_voxels_are_deep(across):
    near, far = ASLANT[across]
    seen, truth = scattered(across, np.array([0.5, 1.0, -0.4]), (1.0, -4.0, 1.0))
    assert -near < seen / truth - 1 < 0.003  # measured -0.0025, -0.031, -0.092, -0.160
    seen, truth = scattered(across, np.array([1.0, 1.0, 0.0]), (3.0, -3.0, 0.5))
    assert -far < seen / truth - 1 < 0.003  # measured -0.0086, -0.115, -0.300, -0.465
