"""Nothing depends on how large the world is, nor on where it lies: pictures at one scale and place against others.

Lengths times a power of two change no digit of a float32, so that the least difference is a threshold in units of
length or a product that left float32's range: no case has one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scripts.scenes.build import moved, points, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.clouds import sphere_cloud
from scripts.scenes.solid_cases import empty
from tests.support.extremes import TECHNIQUES, all_kinds, picture, scaled, shifted

# These have extents of their own; the last two are large, and many.
LEFT_OUT = ("not_finite", "scales", "far_away", "empty", "many_towers", "split_mesh")
NAMES = [name for name in CASES if name not in LEFT_OUT]
LARGE, SMALL = 2.0**30, 2.0**-30


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("name", NAMES)
def test_powers_of_two_change_no_picture(name, technique, within):
    case = CASES[name]()
    plain = picture(case, technique)
    for scale in (SMALL, LARGE):
        apart = np.abs(picture(scaled(case, scale), technique) - plain)
        # Measured 0 but for indirect light: 4.8e-7.
        within(
            f"{len(NAMES)} scenes, 3 techniques, times 2^-30 and 2^30",
            "largest difference of a pixel",
            apart.max(),
            1e-6,
        )


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("scale", [1e-9, 1e9])
@pytest.mark.parametrize("name", ["mixed", "lights", "instances", "inside", "strands", "environment", "parallel_balls"])
def test_other_extents_change_digits_only(name, scale, technique, within):
    """Splats and edges that end within rounding of a pixel's centre go either way."""
    case = CASES[name]()
    apart = np.abs(picture(scaled(case, scale), technique) - picture(case, technique)).max(axis=2)
    within("extents of 1e-9 and 1e9", "share of pixels off by 2 %", np.mean(apart > 0.02), 0.002)
    within("extents of 1e-9 and 1e9", "mean difference", apart.mean(), 1e-5)


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("size", [1.0, 0.01])
def test_a_world_at_1e8_is_the_same(technique, size, within):
    """A scene of 2 units, and one of 2 hundredths with detail of a thousandth; float64 resolves 1.5e-8 there."""
    case = all_kinds("far off")
    case = scaled(replace(case, settings=replace(case.settings, use_shadows=False)), size)
    at = np.array([1e8, -1e8, 1e8])
    apart = np.abs(picture(shifted(case, at), technique) - picture(case, technique)).max(axis=2)
    detail = f"a scene of {2 * size:g} units at 1e8"
    within(detail, "share of pixels off by 2 %", np.mean(apart > 0.02), 0.002)
    within(detail, "mean difference", apart.mean(), 2e-5)


@pytest.mark.parametrize("size", [1.0, 0.01])
def test_shadows_at_1e8_are_the_same(size, within):
    here = scaled(all_kinds("shadows far off"), size)
    at = np.array([1e8, -1e8, 1e8])
    apart = np.abs(picture(shifted(here, at)) - picture(here)).max(axis=2)
    case = f"shadows in a scene of {2 * size:g} units at 1e8"
    within(case, "share of pixels off by 2 %", np.mean(apart > 0.02), 0.002)
    within(case, "mean difference", apart.mean(), 1e-4)


@given(exponent=st.floats(-9, 9), place=st.tuples(*[st.floats(-1e8, 1e8)] * 3))
def test_any_scale_and_place_of_a_ball(exponent, place, within):
    """Of points with an origin of their own, and an instance's transform that takes most of it back."""
    size = 10.0**exponent
    lies = np.array(place) * size
    ball = replace(sphere_cloud(300), origin=lies / size)
    case = Case(scene((points("anywhere", sphere_cloud(300)), moved())), camera())
    there = Case(scene((points(f"anywhere {exponent} {place}", ball), moved(scale=size))), camera())
    eye = scaled(Case(empty().scene, camera()), size).camera
    there = replace(there, camera=replace(eye, view_from_world=eye.view_from_world @ moved(-lies)))
    apart = np.abs(picture(there) - picture(case)).max(axis=2)
    within("a ball of 1e-9 to 1e9 units, 1e8 times its size away", "mean difference", apart.mean(), 1e-5)
