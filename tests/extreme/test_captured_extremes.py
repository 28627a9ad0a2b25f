"""Captured splats at the ends of the ranges of numbers."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import one_splat, random_splats
from tests.reference import captured as reference

EYE = camera((0, -6, 0), resolution=(48, 36), field_of_view=50)


def drawn(splats, eye=EYE, matrix=None, name="extreme"):
    """The picture, (H, W, 4) float64, and the warnings."""
    things = (captured(name, splats), moved() if matrix is None else matrix)
    made = build.scene(things, lights=(), world=World(), transparent=True)
    result = drawing.opengl().render(made, Request(eye, Settings(use_shadows=False), frozenset({"combined"}), 1))
    return result.pixels["combined"].astype(np.float64), result.report["warnings"]


@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e-9, 1e9, 1e15, (1e9, 1e-9, 1.0), (1.0, 0.0, 0.0)])
def test_scales_of_all_sizes(scale):
    splats = one_splat((0, 0, 0), scale, 0.7, rotation=(0.8, 0.0, 0.6, 0.0))
    found, warnings = drawn(splats, name=f"scale {scale}")
    assert not warnings
    expected = reference.picture([(splats, moved())], EYE)
    assert expected[..., 3].max() > 0.2
    assert np.abs(found - expected).max() < 2e-3


def test_many_in_one_place():
    count = 20000
    splats = replace(random_splats(count, 0), position=np.zeros((count, 3), np.float32))
    found, _ = drawn(splats, name="one place")
    assert np.isfinite(found).all()
    assert reference.psnr(found, reference.picture([(splats, moved())], EYE)) > 70


def test_a_splat_around_the_camera_is_not_drawn_and_one_just_before_it_is():
    """Those whose centres lie before the near plane are left out, as published."""
    around, _ = drawn(one_splat((0, -6.05, 0), 1.0), name="around")
    assert around.max() == 0
    splats = one_splat((0.02, -5.85, 0.01), 1.0, 0.8)
    found, _ = drawn(splats, name="before")
    assert found.max() > 0.5
    assert np.abs(found - reference.picture([(splats, moved())], EYE)).max() < 1e-4


def test_no_splats():
    found, warnings = drawn(random_splats(0), name="none")
    assert found.max() == 0
    assert not warnings


@pytest.mark.parametrize("name", ["position", "scale", "rotation", "base", "opacity", "sh"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_left_out_and_counted(name, value):
    splats = random_splats(40, 3)
    broken = getattr(splats, name).copy()
    broken[[3, 17]] = value
    found, warnings = drawn(replace(splats, **{name: broken}), name=f"broken {name} {value}")
    rows = np.delete(np.arange(40), [3, 17])
    arrays = ("position", "scale", "rotation", "base", "opacity", "sh")
    kept = CapturedSplats(**{key: getattr(splats, key)[rows] for key in arrays})
    assert reference.psnr(found, reference.picture([(kept, moved())], EYE)) > 80
    assert len(warnings) == 1
    assert warnings[0].startswith(f"broken {name} {value}: 2 splats are left out")


def test_rotations_of_other_lengths_and_none():
    splats = random_splats(40, 0)
    longer = splats.rotation * np.linspace(0.1, 7, 40, dtype=np.float32)[:, None]
    found, warnings = drawn(replace(splats, rotation=longer), name="long rotations")
    assert not warnings
    assert reference.psnr(found, reference.picture([(splats, moved())], EYE)) > 80
    longer[5] = 0
    _, warnings = drawn(replace(splats, rotation=longer), name="no rotation")
    assert warnings[0].startswith("no rotation: 1 splats are left out")


def test_opacities_of_nothing_and_of_all():
    nothing, _ = drawn(one_splat((0, 0, 0), 1.0, 0.0), name="clear")
    assert nothing.max() == 0
    for opacity in (1.0, 5.0):
        found, _ = drawn(one_splat((0, 0, 0), 1e6, opacity), name=f"opaque {opacity}")
        assert np.abs(found[..., 3] - 0.99).max() < 1e-6


@pytest.mark.parametrize("scale", [(1, 0, 1), (1e-6, 1e-6, 1e-6), (1e6, 1e6, 1e6), (0, 0, 0)])
def test_transforms_without_an_inverse_and_of_all_sizes(scale):
    splats = random_splats(100, 15)
    found, _ = drawn(splats, matrix=moved((0, 0, 0), scale), name=f"transform {scale}")
    assert np.isfinite(found).all()
    if min(scale) > 0:
        assert reference.psnr(found, reference.picture([(splats, moved((0, 0, 0), scale))], EYE)) > 70


def test_far_from_the_origin():
    splats = replace(random_splats(300), origin=np.array([1e6, -2e6, 5e5]))
    found, _ = drawn(splats, matrix=moved(-splats.origin), name="far away")
    assert reference.psnr(found, reference.picture([(splats, moved(-splats.origin))], EYE)) > 80
